"""What is scored: a part of tracks, with what a forecaster may know of it and what it may not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm import metrics
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.data import Prepared
from swarmssm.inference.fitting import tracks_digest
from swarmssm.tracks import Array, states_of, validate_tracks, with_trials
from swarmssm.tracks.kinematics import estimate_noise, smooth_positions
from swarmssm.tracks.scaling import Scaler, fit_scaler
from swarmssm.tracks.splits import PARTS, Segment, take

__all__ = ["Subject", "default_part", "same_tracks", "subject_of"]

Mask = npt.NDArray[np.bool_]

#: Frames of history from which a velocity is smoothed for a forecast. The filter forgets faster.
SMOOTHED_HISTORY = 100


@dataclass(frozen=True)
class Subject:
    """Tracks to score on, and a fit that sees of each frame only what was known then.

    Attributes
    ----------
    fit
        The fit; if its velocities are smoothed, it takes those of ``tracks`` instead.
    tracks
        The scored part. With smoothed velocities, each is smoothed from the frames up to its own.
    part
        Name of the part, ``"all"``, or ``"chosen"`` if segments were asked for.
    inputs
        The tracks as the model sees them.
    states, adjacency, mask
        The truth: ``(trial, time, individual, state)`` in the tracks' own units, NaN where
        unknown; ``(trial, time, individual, individual)`` and ``(trial, time, individual)`` of
        bool.
    training
        States of the training part, if the tracks are those the model was fitted on.
    scaler
        Brings states to the scale of the scores.
    length
        L of (4.1) of the scaled truth.
    notes
        What a reader of the scores has to know.
    """

    fit: Fit
    tracks: xr.Dataset
    part: str
    inputs: Prepared
    states: Array
    training: Array | None
    adjacency: Mask
    mask: Mask
    scaler: Scaler
    length: float
    notes: tuple[str, ...]

    @property
    def fps(self) -> float:
        """Frames per second."""
        return float(self.tracks.attrs["fps"])

    @property
    def num_space(self) -> int:
        """Number of spatial dimensions."""
        return int(self.tracks.sizes["space"])

    def ahead(
        self, trials: npt.NDArray[np.int64], rows: npt.NDArray[np.int64], steps: int
    ) -> Array:
        """Return what came after each start: ``(start, step, individual, state)``.

        NaN where nothing is known or the trial has ended.
        """
        padded = np.pad(self.states, ((0, 0), (0, steps), (0, 0), (0, 0)), constant_values=np.nan)
        following: Array = padded[trials[:, None], rows[:, None] + np.arange(1, steps + 1)]
        return following


def same_tracks(fit: Fit, tracks: xr.Dataset) -> bool:
    """Return whether these are the very tracks that a model was fitted on."""
    data = fit.provenance.get("data", {})
    return bool(data.get("sha256") == tracks_digest(tracks))


def subject_of(
    fit: Fit,
    tracks: xr.Dataset,
    part: str | None = None,
    *,
    segments: Sequence[Segment] | None = None,
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
    segments
        Frames to score in place of a part.

    Raises
    ------
    InputError
        If the part is unknown, empty, or one is asked for of other tracks; or nothing moves.
    """
    tracks = validate_tracks(tracks)
    own = same_tracks(fit, tracks)
    notes: list[str] = []
    if segments is None:
        part, notes = _part_to_score(fit, part, own=own)
        scored = with_trials(tracks) if part == "all" else fit.part(tracks, part)
    else:
        part = "chosen"
        scored = take(tracks, segments)
    training = take(tracks, fit.split.train) if own else None
    truth = fit.prepare(scored)
    known = truth.known.numpy()
    if not (known[:, 1:] & known[:, :-1]).any():
        raise InputError(
            f"tracks: in the scored part ({part}) nobody is seen in two consecutive frames with "
            "a velocity; there is no step to score."
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
    states = np.where(known[..., None], truth.states, np.nan)
    length = metrics.step_length(scaler.transform(states))
    if length == 0.0:
        raise InputError("tracks: nothing moves in the scored part; there is nothing to score.")
    learned = None if training is None else fit.prepare(training).states
    return Subject(
        fit,
        scored,
        part,
        inputs,
        states,
        learned,
        truth.adjacency.numpy(),
        known,
        scaler,
        length,
        tuple(notes),
    )


def _part_to_score(fit: Fit, part: str | None, *, own: bool) -> tuple[str, list[str]]:
    """Return the name of the part to score, and what a reader has to know of it."""
    notes = []
    if part is None:
        part = default_part(fit) if own else "all"
        if not own:
            notes.append(
                "These are not the tracks that the model was fitted on: all frames are scored."
            )
        elif part != "test":
            notes.append(f"The fit has no test part: {_words(part)} is scored.")
    elif part not in (*PARTS, "all"):
        raise InputError(f"part: {part!r} is unknown; choose one of {', '.join(PARTS)} or all.")
    elif part != "all" and not own:
        raise InputError(
            f"part: these are not the tracks that the model was fitted on, and have no {part} "
            "part of its. Score all of them."
        )
    if own and part in ("train", "all"):
        notes.append("The scored frames include those that the model was trained on.")
    if own and part == "validation":
        notes.append("The weights were chosen by the validation part: scores on it flatter.")
    return part, notes


def default_part(fit: Fit) -> str:
    """Return the part of a fit's own tracks that says most of what it has not seen."""
    return next((part for part in ("test", "validation") if fit.split.part(part)), "all")


def _words(part: str) -> str:
    """Return a part as it stands in a sentence."""
    return "all of the tracks" if part == "all" else f"the {part} part"


def _smoothed_causally(tracks: xr.Dataset, training: xr.Dataset | None) -> xr.Dataset:
    """Return the tracks with velocities each smoothed from the frames up to its own alone."""
    fps = tracks.attrs["fps"]
    # Without a training part to learn the noise from, each history tells its own.
    noise = (None, None) if training is None else estimate_noise(_positions(training), fps)
    position = _positions(tracks)
    velocity = np.full(position.shape, np.nan)
    for row in range(1, position.shape[1]):
        history = position[:, max(0, row + 1 - SMOOTHED_HISTORY) : row + 1]
        smoothed = smooth_positions(
            history, fps, process_noise=noise[0], observation_noise=noise[1]
        )
        velocity[:, row] = smoothed[:, -1, :, position.shape[-1] :]
    dims = ("trial", "time", "space", "individual")
    return tracks.assign(velocity=(dims, np.swapaxes(velocity, -1, -2)))


def _positions(tracks: xr.Dataset) -> Array:
    """Return positions ``(trial, time, individual, space)``."""
    return states_of(tracks)[..., : tracks.sizes["space"]]
