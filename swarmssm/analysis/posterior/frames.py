"""Which frames are held out by all fits alike, and from which of them forecasts are made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.analysis.posterior.joining import joined
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.fitting import tracks_digest
from swarmssm.tracks import with_trials
from swarmssm.tracks.splits import PARTS, Segment

__all__ = [
    "ScoredFrames",
    "common_frames",
    "default_part",
    "frames_trained_on",
    "rolling_origins",
    "same_tracks",
]

Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ScoredFrames:
    """Frames on which several fits are compared.

    Attributes
    ----------
    part
        ``"test"``, ``"validation"``, ``"train"`` or ``"all"``; ``"common"`` where they are what
        parts of different splits have in common.
    segments
        The frames.
    trained_on
        For each fit, how many of them it was trained on.
    notes
        What a reader of the scores has to know.
    """

    part: str
    segments: tuple[Segment, ...]
    trained_on: dict[str, int]
    notes: tuple[str, ...]


def same_tracks(fit: Fit, tracks: xr.Dataset) -> bool:
    """Return whether these are the very tracks that a model was fitted on."""
    data = fit.provenance.get("data", {})
    return bool(data.get("sha256") == tracks_digest(tracks))


def default_part(fit: Fit) -> str:
    """Return the part of a fit's own tracks that tells most of what it has not seen."""
    return next((part for part in ("test", "validation") if fit.split.part(part)), "all")


def common_frames(
    fits: Mapping[str, Fit], tracks: xr.Dataset, part: str | None = None
) -> ScoredFrames:
    """Return the frames that may be scored for each of the fits.

    Parameters
    ----------
    fits
        Name -> fit.
    tracks
        Those that models were fitted on, or others, all of which are then held out.
    part
        As in :func:`swarmssm.analysis.scoring.evaluate`, of each fit. Where the fits were split in
        different ways, the frames are those that the parts have in common.

    Raises
    ------
    InputError
        If the part is unknown, a fit has none, or the fits have no two consecutive frames in
        common.
    """
    if part is not None and part not in (*PARTS, "all"):
        raise InputError(f"part: {part!r} is unknown; choose one of {', '.join(PARTS)} or all.")
    own = {name: same_tracks(fit, tracks) for name, fit in fits.items()}
    if part not in (None, "all") and not any(own.values()):
        raise InputError(
            f"part: these are not the tracks that the models were fitted on, and have no {part} "
            "part of theirs. Score all of them."
        )
    whole = tuple(
        Segment(str(trial), 0, int(tracks.sizes["time"]))
        for trial in with_trials(tracks)["trial"].values
    )
    parts: dict[str, tuple[Segment, ...]] = {}
    names: dict[str, str] = {}
    for name, fit in fits.items():
        chosen = "all" if not own[name] else part or default_part(fit)
        names[name] = chosen
        parts[name] = whole if chosen == "all" else fit.split.part(chosen)
        if not parts[name]:
            raise InputError(
                f"part: the {chosen} part of {name} is empty. Choose another, or fit with other "
                "fractions."
            )
    segments = whole
    for mine in parts.values():
        segments = _overlap(segments, mine)
    segments = tuple(s for s in segments if s.stop - s.start > 1)
    if not segments:
        raise InputError(
            "part: "
            + ", ".join(f"{names[name]} of {name}" for name in fits)
            + " have no two consecutive frames in common, so that the fits cannot be compared. "
            "Fit them with the same split, or score all frames (part all)."
        )
    trained = {
        name: frames_trained_on(fit, segments) if own[name] else 0 for name, fit in fits.items()
    }
    return ScoredFrames(
        _name(names, parts), segments, trained, tuple(_notes(names, own, parts, trained))
    )


def frames_trained_on(fit: Fit, segments: Sequence[Segment]) -> int:
    """Return how many frames of the tracks that a model was fitted on it was trained on."""
    return sum(s.stop - s.start for s in _overlap(segments, fit.split.train))


def rolling_origins(
    seen: Mask, count: int, startable: npt.NDArray[np.bool_] | None = None
) -> tuple[Rows, Rows]:
    """Return trial and row of up to ``count`` frames of each trial to forecast from.

    Frames with somebody in them, and somebody in a later one, spread evenly.

    Parameters
    ----------
    seen
        ``(trial, time, individual)``.
    count
        How many, of each trial.
    startable
        ``(trial, time)``: the frames that may be taken; all, if absent.
    """
    trials, rows = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    anybody: Mask = np.logical_or.reduce(seen, axis=-1)
    for trial, there in enumerate(anybody):
        last = int(np.flatnonzero(there)[-1]) if there.any() else 0
        allowed = there if startable is None else there & startable[trial]
        usable = np.flatnonzero(allowed[:last])
        if not usable.size:
            continue
        chosen = np.unique(np.linspace(0, usable.size - 1, min(count, usable.size)).round())
        rows.append(usable[chosen.astype(np.int64)])
        trials.append(np.full(rows[-1].size, trial))
    return np.concatenate(trials), np.concatenate(rows)


def _overlap(first: Sequence[Segment], second: Sequence[Segment]) -> tuple[Segment, ...]:
    """Return the frames that are in both."""
    found = []
    for a in first:
        for b in second:
            start, stop = max(a.start, b.start), min(a.stop, b.stop)
            if a.trial == b.trial and start < stop:
                found.append(Segment(a.trial, start, stop))
    return tuple(found)


def _name(names: Mapping[str, str], parts: Mapping[str, tuple[Segment, ...]]) -> str:
    """Return the name of the part, if it is one."""
    same = len(set(names.values())) == 1 and len({frozenset(mine) for mine in parts.values()}) == 1
    return next(iter(names.values())) if same else "common"


def _notes(
    names: Mapping[str, str],
    own: Mapping[str, bool],
    parts: Mapping[str, tuple[Segment, ...]],
    trained: Mapping[str, int],
) -> list[str]:
    """Return what a reader has to know of these frames."""
    notes = []
    foreign = [name for name, mine in own.items() if not mine]
    if foreign:
        verb = "were" if len(foreign) > 1 else "was"
        notes.append(f"{joined(foreign)} {verb} not fitted on these tracks.")
    if _name(names, parts) == "common":
        notes.append("The fits were split in different ways: scored is what all hold out.")
    notes += [
        f"{name} was trained on {number} of the scored frames: its scores flatter it."
        for name, number in trained.items()
        if number
    ]
    chosen = [name for name, kind in names.items() if kind == "validation"]
    if chosen:
        notes.append(
            f"The weights of {joined(chosen)} were chosen by the scored frames (validation part): "
            "scores on it flatter."
        )
    return notes
