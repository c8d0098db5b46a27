"""The frame from which a forecast or a free run goes on."""

import torch

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.inference.data import Prepared
from swarmssm.tracks.scaling import Scaler

__all__ = ["MAX_CARRY", "extrapolate_missing", "last_frames", "most_complete_frames"]

#: Frames for which an individual that is out of sight is carried on with its last velocity.
MAX_CARRY = 10


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


def most_complete_frames(mask: torch.Tensor) -> torch.Tensor:
    """Return each trial's last row in which most individuals were observed: ``(trial,)``."""
    last_frames(mask)
    counts = mask.sum(-1)
    rows = torch.arange(mask.shape[1])
    return torch.where(counts == counts.amax(-1, keepdim=True), rows, -1).amax(-1)


def extrapolate_missing(
    prepared: Prepared,
    scaler: Scaler,
    rule: GraphRule | None,
    trials: torch.Tensor,
    rows: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return frames with those that are just out of sight carried on.

    An individual that is not observed in the row, but was at most :data:`MAX_CARRY` frames before,
    is put where its last velocity has brought it. If the graph follows a rule it is then made anew;
    else an individual that was carried on has no edges.

    Parameters
    ----------
    prepared
        Tracks as a model sees them.
    scaler, rule
        Of the fit.
    trials, rows
        ``(origin,)``. Nothing after the row is used.

    Returns
    -------
    States in the tracks' own units ``(origin, individual, state)``, NaN where absent; adjacency;
    and who is there.
    """
    states = torch.from_numpy(prepared.states)
    half = states.shape[-1] // 2
    now = states[trials, rows].clone()
    present = prepared.known[trials, rows].clone()
    adjacency = prepared.adjacency[trials, rows]
    dt = 1.0 / float(prepared.tracks.attrs["fps"])
    carried = torch.zeros_like(present)
    for age in range(1, MAX_CARRY + 1):
        before = (rows - age).clamp(min=0)
        then = states[trials, before]
        found = prepared.known[trials, before] & ~present & (rows >= age).unsqueeze(-1)
        moved = then.clone()
        moved[..., :half] += age * dt * then[..., half:]
        now = torch.where(found.unsqueeze(-1), moved, now)
        present |= found
        carried |= found
    if rule is not None and bool(carried.any()):
        unknown = ~present.unsqueeze(-1)
        positions = now[..., :half].masked_fill(unknown, torch.nan)
        again = rule(positions, now[..., half:])
        # Trials in which nobody was carried keep the graph that the tracks tell.
        adjacency = torch.where(carried.any(-1)[:, None, None], again, adjacency)
    return now.masked_fill(~present.unsqueeze(-1), torch.nan), adjacency, present
