"""What is scored: frames of tracks, with what a fit may know of them and what it may not."""

import functools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.posterior.frames import ScoredFrames, common_frames, same_tracks
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.data import Prepared
from swarmssm.tracks import Array, states_of, validate_tracks
from swarmssm.tracks.kinematics import estimate_noise, smooth_positions
from swarmssm.tracks.scaling import Scaler, fit_scaler
from swarmssm.tracks.splits import take

__all__ = ["ScoredTracks", "Subject", "subject_of"]

Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

#: Frames of history from which a velocity is smoothed for a forecast. The filter forgets faster.
SMOOTHED_HISTORY = 100


@dataclass(frozen=True)
class ScoredTracks:
    """Frames that are scored, whoever forecasts them.

    Attributes
    ----------
    tracks
        The scored part.
    states, mask
        The truth ``(trial, time, individual, state)`` in the tracks' own units, NaN where unknown;
        and which of it is scored, ``(trial, time, individual)``.
    training
        States of the training part, if there is one: of what the errors of a baseline are measured.
    scaler
        Brings states to the scale of the scores.
    """

    tracks: xr.Dataset
    states: Array
    mask: Mask
    training: Array | None
    scaler: Scaler

    @property
    def fps(self) -> float:
        """Frames per second."""
        return float(self.tracks.attrs["fps"])

    @property
    def num_space(self) -> int:
        """Number of spatial dimensions."""
        return int(self.tracks.sizes["space"])

    @functools.cached_property
    def length(self) -> float:
        """L of (4.1) of the scaled truth."""
        return metrics.step_length(self.scaler.transform(self.states))

    def ahead(self, trials: Rows, rows: Rows, steps: int) -> Array:
        """Return the truth after each start: ``(start, step, individual, state)``.

        NaN where nothing is known or the trial has ended.
        """
        padded = np.pad(self.states, ((0, 0), (0, steps), (0, 0), (0, 0)), constant_values=np.nan)
        following: Array = padded[trials[:, None], rows[:, None] + np.arange(1, steps + 1)]
        return following


@dataclass(frozen=True)
class Subject(ScoredTracks):
    """Scored tracks, and a fit that sees of each frame only what was known then.

    Attributes
    ----------
    fit
        The fit; if its velocities are smoothed, it takes those of ``tracks`` instead, each of which
        is smoothed from the frames up to its own.
    part
        Name of the part, see :class:`swarmssm.analysis.posterior.frames.ScoredFrames`.
    inputs
        The tracks as the model sees them.
    adjacency
        True graphs ``(trial, time, individual, individual)`` of bool.
    notes
        What a reader of the scores has to know.
    """

    fit: Fit
    part: str
    inputs: Prepared
    adjacency: Mask
    notes: tuple[str, ...]


def subject_of(
    fit: Fit,
    tracks: xr.Dataset,
    part: str | None = None,
    *,
    frames: ScoredFrames | None = None,
) -> Subject:
    """Take the part to score, and make sure that no frame of it knows of a later one.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or others.
    part
        ``"train"``, ``"validation"``, ``"test"`` or ``"all"``. Absent: the test part of the
        tracks the model was fitted on (without one, the validation part, else everything), and
        all of any others.
    frames
        Frames to score in place of a part.

    Raises
    ------
    InputError
        If the part is unknown, empty, or one is asked for of other tracks; or nothing moves.
    """
    tracks = validate_tracks(tracks)
    own = same_tracks(fit, tracks)
    notes: list[str] = []
    if frames is None:
        frames = common_frames({fit.settings.model: fit}, tracks, part)
        notes += frames.notes
    part, scored = frames.part, take(tracks, frames.segments)
    training = take(tracks, fit.split.train) if own else None
    truth = fit.prepare(scored)
    known = truth.known.numpy()
    if not (known[:, 1:] & known[:, :-1]).any():
        raise InputError(
            f"tracks: in the scored part ({part}) nobody is observed in two consecutive frames "
            "with a velocity; there is no step to score."
        )
    scaler = fit.preparation.scaler
    if scaler.kind != "minmax":
        # One scale for all fits of the same tracks, whatever each was trained with.
        source = truth if training is None else fit.prepare(training)
        scaler = fit_scaler(source.states)
        where = "the training part" if own else "the scored frames"
        notes.append(f"Scores are in units of the range of {where}, as (3.49) scales.")
    inputs = truth
    if fit.preparation.velocity == "kalman":
        scored = _smoothed_causally(scored, training)
        fit = replace(fit, preparation=replace(fit.preparation, velocity="auto"))
        inputs = fit.prepare(scored)
    subject = Subject(
        tracks=scored,
        states=np.where(known[..., None], truth.states, np.nan),
        mask=known,
        training=None if training is None else fit.prepare(training).states,
        scaler=scaler,
        fit=fit,
        part=part,
        inputs=inputs,
        adjacency=truth.adjacency.numpy(),
        notes=tuple(notes),
    )
    if subject.length == 0.0:
        raise InputError("tracks: nothing moves in the scored part; there is nothing to score.")
    return subject


def _smoothed_causally(tracks: xr.Dataset, training: xr.Dataset | None) -> xr.Dataset:
    """Return the tracks with velocities each filtered from the frames up to its own alone."""
    fps = tracks.attrs["fps"]
    position = _positions(tracks)
    space = position.shape[-1]
    if training is not None:
        process, observation = estimate_noise(_positions(training), fps)
        states = smooth_positions(
            position, fps, process_noise=process, observation_noise=observation, causal=True
        )
        velocity = states[..., space:]
    else:
        # Without a training part to learn the noise from, each history has an estimate of its own.
        velocity = np.full(position.shape, np.nan)
        for row in range(1, position.shape[1]):
            history = position[:, max(0, row + 1 - SMOOTHED_HISTORY) : row + 1]
            velocity[:, row] = smooth_positions(history, fps, causal=True)[:, -1, :, space:]
    dims = ("trial", "time", "space", "individual")
    return tracks.assign(velocity=(dims, np.swapaxes(velocity, -1, -2)))


def _positions(tracks: xr.Dataset) -> Array:
    """Return positions ``(trial, time, individual, space)``."""
    return states_of(tracks)[..., : tracks.sizes["space"]]
