"""From tracks to the tensors that models and guides work on, and back to labels."""

from dataclasses import dataclass

import numpy as np
import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule, add_adjacency, default_rule, rule_of
from swarmssm.kinematics import add_velocity
from swarmssm.models import SwarmBatch
from swarmssm.scaling import Scaler, fit_scaler
from swarmssm.tracks import Array, states_of, validate_tracks, with_trials

__all__ = ["Preparation", "Prepared", "preparation_for", "prepare", "windows_of"]


@dataclass(frozen=True)
class Preparation:
    """What is done to any tracks before a fitted model sees them.

    Attributes
    ----------
    scaler
        Fitted on the training part.
    velocity
        How velocities are made, see :class:`swarmssm.inference.settings.FitSettings`.
    rule
        How the graph of new states is made; ``None`` if only the tracks know theirs.
    own_graph
        Whether tracks that carry an adjacency keep it.
    """

    scaler: Scaler
    velocity: str
    rule: GraphRule | None
    own_graph: bool


@dataclass(frozen=True)
class Prepared:
    """Tracks as a model sees them.

    Attributes
    ----------
    tracks
        With trials, velocities and adjacency.
    states
        ``(trial, time, individual, state)`` in the tracks' own units, NaN where unknown.
    observations, mask, adjacency
        As in :class:`swarmssm.models.SwarmBatch`, whole trials; the adjacency is of bool.
    """

    tracks: xr.Dataset
    states: Array
    observations: torch.Tensor
    mask: torch.Tensor
    adjacency: torch.Tensor

    def batch(self) -> SwarmBatch:
        """Return whole trials as one batch."""
        return SwarmBatch.of(self.observations, self.mask, self.adjacency.to(torch.float32))


def preparation_for(
    tracks: xr.Dataset, *, scaler: str, graph: str, velocity: str
) -> tuple[Preparation, xr.Dataset]:
    """Decide on the training part what will be done to all.

    Parameters
    ----------
    tracks
        The training part.
    scaler, graph, velocity
        See :class:`swarmssm.inference.settings.FitSettings`.

    Returns
    -------
    The preparation, and the training part with its velocities.

    Raises
    ------
    InputError
        If the graph of the tracks is asked for and they have none, or nothing can be scaled.
    """
    has_graph = "adjacency" in tracks
    if graph == "data" and not has_graph:
        raise InputError(
            "graph: the tracks carry no adjacency. Name a rule, for instance radius:2.5, "
            "k-nearest:6 or visual."
        )
    tracks = _with_velocity(tracks, velocity)
    own_graph = graph in ("auto", "data") and has_graph
    if own_graph:
        rule = rule_of(tracks)
    elif graph == "auto":
        rule = default_rule(tracks)
    else:
        rule = GraphRule.parse(graph).fitted_to(tracks)
    fitted = fit_scaler(states_of(tracks), scaler)
    return Preparation(fitted, velocity, rule, own_graph), tracks


def prepare(tracks: xr.Dataset, preparation: Preparation) -> Prepared:
    """Add velocities and graph, scale, and turn into tensors.

    An individual counts as observed in a frame where its position and its velocity are known:
    with differences, not in the first frame after a gap.

    Raises
    ------
    InputError
        If the tracks are none, have another number of dimensions than those the model was fitted
        on, or no graph where only tracks can know it.
    """
    tracks = validate_tracks(tracks)
    num_features = 2 * tracks.sizes["space"]
    expected = len(preparation.scaler.offset)
    if num_features != expected:
        raise InputError(
            f"tracks: they have {tracks.sizes['space']} coordinates, and the model was fitted on "
            f"{expected // 2}."
        )
    tracks = with_trials(_with_velocity(tracks, preparation.velocity))
    if not (preparation.own_graph and "adjacency" in tracks):
        if preparation.rule is None:
            raise InputError(
                "tracks: they carry no adjacency, and the model was fitted on a graph that was "
                "given with the data. Add it, or fit with a rule (--graph)."
            )
        tracks = add_adjacency(tracks, preparation.rule, overwrite=True)
    states = states_of(tracks)
    known = np.asarray(np.isfinite(states).all(axis=-1))
    scaled = np.where(known[..., None], preparation.scaler.transform(states), 0.0)
    mask = torch.from_numpy(known)
    adjacency = torch.from_numpy(
        tracks["adjacency"].transpose("trial", "time", "individual", "neighbor").to_numpy() != 0
    )
    adjacency &= mask.unsqueeze(-1) & mask.unsqueeze(-2)
    return Prepared(tracks, states, torch.from_numpy(scaled).to(torch.float32), mask, adjacency)


def _with_velocity(tracks: xr.Dataset, velocity: str) -> xr.Dataset:
    """Return the tracks with velocities as asked for."""
    if velocity == "auto":
        return tracks if "velocity" in tracks else add_velocity(tracks, "difference")
    return add_velocity(tracks, velocity)


def windows_of(prepared: Prepared, window: int | None) -> SwarmBatch:
    """Cut whole trials into windows that hold each step of the recording once.

    Windows of a trial share their border frame; the last is padded. A window in which nobody is
    seen in two consecutive frames is left out: it has no term in the ELBO.

    Parameters
    ----------
    prepared
        Tracks as a model sees them.
    window
        Frames in a window, at least 2; ``None`` for whole trials.

    Returns
    -------
    A batch that is its own population.

    Raises
    ------
    InputError
        If no window is left, or a window would hold no step.
    """
    if window is not None and window < 2:
        raise InputError(f"window: it must be at least 2 frames, and it is {window}.")
    num_times = prepared.mask.shape[1]
    length = num_times if window is None else min(window, num_times)
    pieces: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []
    for observations, mask, adjacency in zip(
        prepared.observations, prepared.mask, prepared.adjacency, strict=True
    ):
        for start in range(0, num_times - 1, max(length - 1, 1)):
            part = slice(start, start + length)
            if not (mask[part][1:] & mask[part][:-1]).any():
                continue
            short = length - len(mask[part])
            pieces.append(
                (
                    torch.nn.functional.pad(observations[part], (0, 0, 0, 0, 0, short)),
                    torch.nn.functional.pad(mask[part], (0, 0, 0, short)),
                    torch.nn.functional.pad(
                        adjacency[part].to(torch.float32), (0, 0, 0, 0, 0, short)
                    ),
                )
            )
    if not pieces:
        raise InputError(
            "tracks: nobody is seen in two consecutive frames; there is no step to learn."
        )
    return SwarmBatch.of(*(torch.stack(column) for column in zip(*pieces, strict=True)))
