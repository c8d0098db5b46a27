"""The frame from which a forecast or a free run goes on."""

from dataclasses import dataclass

import torch

from swarmssm.errors import InputError
from swarmssm.inference.data import Preparation, Prepared

__all__ = ["MAX_CARRY", "Start", "fullest_frames", "last_frames", "start_at"]

#: Frames for which an individual that is out of sight is carried on with its last velocity.
MAX_CARRY = 10


@dataclass(frozen=True)
class Start:
    """One frame of each trial, as a model sees it.

    Attributes
    ----------
    states
        ``(trial, individual, state)``, scaled; 0 where absent.
    adjacency
        ``(trial, individual, individual)`` of 0.0 and 1.0.
    present
        ``(trial, individual)`` of bool.
    unscaled
        The states in the tracks' own units, NaN where absent.
    """

    states: torch.Tensor
    adjacency: torch.Tensor
    present: torch.Tensor
    unscaled: torch.Tensor


def last_frames(mask: torch.Tensor) -> torch.Tensor:
    """Return each trial's last row in which anybody was observed: ``(trial,)``.

    Raises
    ------
    InputError
        If in a trial there is none.
    """
    anybody = mask.any(-1)
    if not bool(anybody.any(-1).all()):
        raise InputError("tracks: in one trial nobody is seen in two consecutive frames.")
    rows = torch.arange(mask.shape[1])
    return torch.where(anybody, rows, -1).amax(-1)


def fullest_frames(mask: torch.Tensor) -> torch.Tensor:
    """Return each trial's last row in which most individuals were observed: ``(trial,)``."""
    last_frames(mask)
    counts = mask.sum(-1)
    rows = torch.arange(mask.shape[1])
    return torch.where(counts == counts.amax(-1, keepdim=True), rows, -1).amax(-1)


def start_at(prepared: Prepared, preparation: Preparation, rows: torch.Tensor) -> Start:
    """Return one frame of each trial, with those that are just out of sight carried on.

    An individual that is not observed in the row, but was at most :data:`MAX_CARRY` frames before,
    is put where its last velocity has brought it. If the graph follows a rule it is then made anew;
    else an individual that was carried on has no edges.

    Parameters
    ----------
    prepared
        Tracks as a model sees them.
    preparation
        Scaler and rule.
    rows
        Row of each trial, ``(trial,)``. Nothing after it is used.
    """
    trials = torch.arange(len(rows))
    states = torch.from_numpy(prepared.states)
    half = states.shape[-1] // 2
    now = states[trials, rows].clone()
    present = prepared.mask[trials, rows].clone()
    adjacency = prepared.adjacency[trials, rows]
    dt = 1.0 / float(prepared.tracks.attrs["fps"])
    carried = torch.zeros_like(present)
    for age in range(1, MAX_CARRY + 1):
        before = (rows - age).clamp(min=0)
        then = states[trials, before]
        found = prepared.mask[trials, before] & ~present & (rows >= age).unsqueeze(-1)
        moved = then.clone()
        moved[..., :half] += age * dt * then[..., half:]
        now = torch.where(found.unsqueeze(-1), moved, now)
        present |= found
        carried |= found
    if preparation.rule is not None and bool(carried.any()):
        unknown = ~present.unsqueeze(-1)
        positions = now[..., :half].masked_fill(unknown, torch.nan)
        again = preparation.rule(positions, now[..., half:])
        # Trials in which nobody was carried keep the graph that the tracks tell.
        adjacency = torch.where(carried.any(-1)[:, None, None], again, adjacency)
    absent = ~present.unsqueeze(-1)
    scaled = preparation.scaler.transform_tensor(now).masked_fill(absent, 0.0)
    own = now.masked_fill(absent, torch.nan)
    return Start(scaled.to(torch.float32), adjacency.to(torch.float32), present, own)
