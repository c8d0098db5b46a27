"""From tracks to the tensors that models and guides work on, and back to labels."""

import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule, add_adjacency, default_rule, rule_of
from swarmssm.models import SwarmBatch
from swarmssm.tracks import Array, states_of, validate_tracks, with_trials
from swarmssm.tracks.kinematics import add_velocity
from swarmssm.tracks.scaling import Scaler, fit_scaler
from swarmssm.tracks.validation import checked_digest

__all__ = [
    "Preparation",
    "Prepared",
    "frames_of",
    "preparation_for",
    "prepare",
    "windows_of",
]


#: What was prepared: tracks by their identity, what they held then, and the results.
_PREPARED: dict[int, tuple[weakref.ref[xr.Dataset], Any, "dict[Preparation, Prepared]"]] = {}


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
    observes
        ``"states"``: the model is given positions and velocities; ``"positions"``: those alone.
    """

    scaler: Scaler
    velocity: str
    rule: GraphRule | None
    own_graph: bool
    observes: str = "states"


@dataclass(frozen=True)
class Prepared:
    """Tracks as a model sees them.

    Attributes
    ----------
    tracks
        With trials, velocities and adjacency.
    states
        ``(trial, time, individual, state)`` in the tracks' own units, NaN where unknown.
    known
        ``(trial, time, individual)`` of bool: position and velocity are known.
    observations, mask, adjacency
        As in :class:`swarmssm.models.SwarmBatch`, whole trials; the adjacency is of bool. What
        the model is given: where it observes positions alone, these are masked by themselves.
    """

    tracks: xr.Dataset
    states: Array
    known: torch.Tensor
    observations: torch.Tensor
    mask: torch.Tensor
    adjacency: torch.Tensor

    def batch(self) -> SwarmBatch:
        """Return whole trials as one batch."""
        return SwarmBatch.of(self.observations, self.mask, self.adjacency.to(torch.float32))


def preparation_for(
    tracks: xr.Dataset, *, scaler: str, graph: str, velocity: str, observes: str = "states"
) -> tuple[Preparation, xr.Dataset]:
    """Decide on the training part what will be done to all.

    Parameters
    ----------
    tracks
        The training part.
    scaler, graph, velocity
        See :class:`swarmssm.inference.settings.FitSettings`.
    observes
        See :class:`Preparation`.

    Returns
    -------
    The preparation, and the training part with its velocities.

    Raises
    ------
    InputError
        If the graph of the tracks is asked for and they have none, or nothing can be scaled.
    """
    tracks = _with_velocity(tracks, velocity)
    own_graph = graph in ("auto", "data") and "adjacency" in tracks
    rule = rule_of(tracks) if own_graph else rule_for(tracks, graph)
    fitted = fit_scaler(states_of(tracks), scaler)
    return Preparation(fitted, velocity, rule, own_graph, observes), tracks


def rule_for(tracks: xr.Dataset, graph: str) -> GraphRule | None:
    """Return the rule that makes the graph of tracks; ``None`` if they carry the one to take.

    Parameters
    ----------
    tracks
        The training part.
    graph
        See :class:`swarmssm.inference.settings.FitSettings`.

    Raises
    ------
    InputError
        If the graph of the tracks is asked for and they have none, or there is no such rule.
    """
    if graph in ("auto", "data") and "adjacency" in tracks:
        return None
    if graph == "data":
        raise InputError(
            "graph: the tracks carry no adjacency. Name a rule, for instance radius:2.5, "
            "k-nearest:6 or visual."
        )
    return default_rule(tracks) if graph == "auto" else GraphRule.parse(graph).fitted_to(tracks)


def prepare(tracks: xr.Dataset, preparation: Preparation) -> Prepared:
    """Add velocities and graph, scale, and turn into tensors.

    An individual counts as observed in a frame where its position and its velocity are known:
    with differences, not in the first frame after a gap.

    The same tracks are prepared once for all fits with an equal preparation, as long as they live
    and are not changed: nothing of the result may be written to.

    Raises
    ------
    InputError
        If the tracks are none, have another number of dimensions than those the model was fitted
        on, or no graph where only tracks can know it.
    """
    checked = validate_tracks(tracks)
    state = (checked_digest(checked), repr(tracks.attrs), tuple(tracks.variables))
    key = id(tracks)
    known, before, done = _PREPARED.get(key, (None, None, {}))
    if known is None or known() is not tracks or before != state:
        done = {}
        _PREPARED[key] = (weakref.ref(tracks, lambda _: _PREPARED.pop(key, None)), state, done)
    if preparation not in done:
        done[preparation] = _prepared(checked, preparation)
    return done[preparation]


def _prepared(tracks: xr.Dataset, preparation: Preparation) -> Prepared:
    """Prepare tracks that were checked."""
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
                'given with the data. Add it, or fit with a rule (graph="radius:2.5").'
            )
        tracks = add_adjacency(tracks, preparation.rule, overwrite=True)
    states = states_of(tracks)
    known = np.asarray(np.isfinite(states).all(axis=-1))
    # Positions are known where velocities are not, in the first frame of a run.
    scaled = np.nan_to_num(preparation.scaler.transform(states), nan=0.0)
    if preparation.observes == "positions":
        half = num_features // 2
        seen = np.asarray(np.isfinite(states[..., :half]).all(axis=-1))
        observed = np.where(seen[..., None], scaled[..., :half], 0.0)
    else:
        seen, observed = known, np.where(known[..., None], scaled, 0.0)
    mask = torch.from_numpy(seen)
    adjacency = torch.from_numpy(
        tracks["adjacency"].transpose("trial", "time", "individual", "neighbor").to_numpy() != 0
    )
    adjacency &= mask.unsqueeze(-1) & mask.unsqueeze(-2)
    return Prepared(
        # Not the very dataset that was given, which what is remembered would keep alive.
        tracks.copy(deep=False),
        states,
        torch.from_numpy(known),
        torch.from_numpy(observed).to(torch.float32),
        mask,
        adjacency,
    )


def _with_velocity(tracks: xr.Dataset, velocity: str) -> xr.Dataset:
    """Return the tracks with velocities as asked for."""
    if velocity == "auto":
        return tracks if "velocity" in tracks else add_velocity(tracks, "difference")
    return add_velocity(tracks, velocity)


def windows_of(prepared: Prepared, window: int | None, *, share_border: bool = True) -> SwarmBatch:
    """Cut whole trials into windows that cover the recording once.

    A window in which nobody is seen in two frames - consecutive ones, if borders are shared - is
    left out: there is no step to learn from. The last window of a trial is padded.

    Parameters
    ----------
    prepared
        Tracks as a model sees them.
    window
        Frames in a window, at least 2; ``None`` for whole trials.
    share_border
        Whether consecutive windows share their border frame, so that each *step* is in one of
        them; else each *frame* is.

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
    last, stride = (num_times - 1, length - 1) if share_border else (num_times, length)
    trials, starts = [], []
    for trial, mask in enumerate(prepared.mask):
        for start in range(0, last, max(stride, 1)):
            part = mask[start : start + length]
            both = part[1:] & part[:-1] if share_border else part.sum(0) > 1
            if both.any():
                trials.append(trial)
                starts.append(start)
    if not trials:
        frames = "two consecutive frames" if share_border else "two frames of a window"
        raise InputError(f"tracks: nobody is seen in {frames}; there is no step to learn.")
    return frames_of(prepared, torch.tensor(trials), torch.tensor(starts), length)


def frames_of(
    prepared: Prepared, trials: torch.Tensor, starts: torch.Tensor, length: int
) -> SwarmBatch:
    """Return windows of any trials and first rows; what lies outside a trial is not observed.

    Parameters
    ----------
    prepared
        Tracks as a model sees them.
    trials, starts
        ``(window,)``: trial and row of the first frame, which may be negative.
    length
        Frames in a window.

    Returns
    -------
    A batch that is its own population.
    """
    num_times = prepared.mask.shape[1]
    rows = starts.unsqueeze(-1) + torch.arange(length)
    inside = (rows >= 0) & (rows < num_times)
    at = (trials.unsqueeze(-1), rows.clamp(0, num_times - 1))
    mask = prepared.mask[at] & inside.unsqueeze(-1)
    adjacency = prepared.adjacency[at] & inside[..., None, None]
    observations = prepared.observations[at] * inside[..., None, None]
    return SwarmBatch.of(observations, mask, adjacency.to(torch.float32))
