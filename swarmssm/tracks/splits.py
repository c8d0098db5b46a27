"""Training, validation and test parts of tracks, without leakage between them."""

import itertools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks.dataset import observed, with_trials

__all__ = ["PARTS", "Segment", "Split", "split", "take"]

PARTS = ("train", "validation", "test")


@dataclass(frozen=True)
class Segment:
    """Consecutive frames ``start <= t < stop`` (row numbers) of one trial (its label)."""

    trial: str
    start: int
    stop: int


@dataclass(frozen=True)
class Split:
    """Which segments of the tracks train, validate and test a model. No frame is in two.

    Raises
    ------
    InputError
        If a frame is in two parts.
    """

    train: tuple[Segment, ...]
    validation: tuple[Segment, ...]
    test: tuple[Segment, ...]

    def __post_init__(self) -> None:
        """Refuse parts that share a frame."""
        for one, other in itertools.combinations(PARTS, 2):
            for a, b in itertools.product(self.part(one), self.part(other)):
                if a.trial == b.trial and max(a.start, b.start) < min(a.stop, b.stop):
                    raise InputError(
                        f"split: frame {max(a.start, b.start)} of trial {a.trial} is in {one} and "
                        f"in {other}. Give each frame to one part."
                    )

    def part(self, name: str) -> tuple[Segment, ...]:
        """Return the segments of ``"train"``, ``"validation"`` or ``"test"``."""
        if name not in PARTS:
            raise InputError(f"part: {name!r} is unknown; choose one of {', '.join(PARTS)}.")
        segments: tuple[Segment, ...] = getattr(self, name)
        return segments

    def to_dict(self) -> dict[str, list[list[Any]]]:
        """Return the split as plain lists, for JSON."""
        return {part: [[s.trial, s.start, s.stop] for s in self.part(part)] for part in PARTS}

    @classmethod
    def from_dict(cls, values: dict[str, list[list[Any]]]) -> "Split":
        """Undo :meth:`to_dict`.

        Raises
        ------
        InputError
            If ``values`` is not what :meth:`to_dict` gives.
        """
        try:
            parts = [[Segment(str(t), int(a), int(b)) for t, a, b in values[p]] for p in PARTS]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                "split: each of train, validation and test must be a list of [trial, start, stop]."
            ) from error
        return cls(*map(tuple, parts))


def split(
    tracks: xr.Dataset,
    by: str = "auto",
    fractions: Sequence[float] = (0.7, 0.15, 0.15),
    gap: int = 0,
) -> Split:
    """Divide tracks into training, validation and test parts.

    Parameters
    ----------
    tracks
        Tracks.
    by
        ``"trial"``: whole trials, in their order. ``"time"``: each trial's frames, from its first
        to its last with anybody in it, are cut into three consecutive blocks, the test block
        last. ``"auto"``: by trial when there are at least three of them.
    fractions
        Share of each part; positive for training, summing to 1.
    gap
        Frames left out between two blocks of one trial, so that what lasts for some frames (a
        turn, a smoothed velocity) does not reach from one part into the next.

    Raises
    ------
    InputError
        If the fractions are no shares, or a part asked for would have fewer than two frames.
    """
    try:
        shares = np.asarray(fractions, dtype=np.float64)
    except (TypeError, ValueError):
        shares = np.empty(0)
    if (
        shares.shape != (3,)
        or not np.isclose(shares.sum(), 1)
        or not ((shares >= 0).all() and shares[0] > 0)
    ):
        raise InputError(
            f"fractions: three shares that sum to 1 are needed, the first of them positive, not "
            f"{fractions}."
        )
    if gap < 0:
        raise InputError(f"gap: it must not be negative, and it is {gap}.")
    spans = _spans(tracks)
    if by == "auto":
        by = "trial" if len(spans) >= 3 else "time"
    if by == "trial":
        return _split_trials(spans, shares)
    if by == "time":
        return _split_time(spans, shares, gap)
    raise InputError(f"by: {by!r} is unknown; choose trial, time or auto.")


def _spans(tracks: xr.Dataset) -> list[Segment]:
    """Return each trial from its first to its last frame with anybody in it."""
    spans = []
    tracks = with_trials(tracks)
    present = observed(tracks).any("individual").transpose("trial", "time").to_numpy()
    for trial, row in zip(tracks["trial"].values, present, strict=True):
        frames = np.flatnonzero(row)
        if frames.size:
            spans.append(Segment(str(trial), int(frames[0]), int(frames[-1]) + 1))
    return spans


def _split_trials(spans: list[Segment], shares: npt.NDArray[np.float64]) -> Split:
    """Give whole trials to each part: at least one to each that has a share."""
    wanted = shares > 0
    if len(spans) < wanted.sum():
        raise InputError(
            f"by: {len(spans)} trials cannot be split into {wanted.sum()} parts; split by time."
        )
    counts = np.maximum(np.round(shares * len(spans)).astype(int), wanted)
    while counts.sum() > len(spans):
        counts[np.argmax(counts)] -= 1
    counts[0] += len(spans) - counts.sum()
    ends = np.cumsum(counts)
    parts = [tuple(spans[end - n : end]) for end, n in zip(ends, counts, strict=True)]
    for name, part in zip(PARTS, parts, strict=True):
        if part and max(span.stop - span.start for span in part) < 2:
            raise InputError(
                f"tracks: the {name} part would be trial {part[0].trial} alone, which has 1 frame. "
                "Leave that trial out, or split by time."
            )
    return Split(*parts)


def _split_time(spans: list[Segment], shares: npt.NDArray[np.float64], gap: int) -> Split:
    """Cut each trial into consecutive blocks."""
    parts: tuple[list[Segment], ...] = ([], [], [])
    for span in spans:
        length = span.stop - span.start
        cuts = span.start + np.round(np.cumsum([0.0, *shares]) * length).astype(int)
        for index, part in enumerate(parts):
            if not shares[index]:
                continue
            start, stop = int(cuts[index]), int(cuts[index + 1])
            if start > span.start:
                start += gap
            if stop - start < 2:
                raise InputError(
                    f"tracks: trial {span.trial} has {length} frames, too few to split by time "
                    f"into shares {tuple(shares.tolist())} with a gap of {gap}."
                )
            part.append(Segment(span.trial, start, stop))
    return Split(*(tuple(part) for part in parts))


def take(tracks: xr.Dataset, segments: Sequence[Segment]) -> xr.Dataset:
    """Return the given segments as tracks of their own, each one a trial.

    Segments of differing length are padded: floats with NaN, anything else with 0. Where they
    start at different times, time is counted from each segment's start and ``frame`` is left out.
    The coordinate ``start_time (trial)`` says when each started, also in a part of a part. A
    variable of time without trials, such as a signal that all trials share, gets trials.

    Parameters
    ----------
    tracks
        Tracks. Nothing is computed here: a missing velocity stays missing, so that what is
        derived from the part later on knows of the part alone. A velocity that is there is kept
        as it is, whatever it was derived from.
    segments
        At least one.

    Raises
    ------
    InputError
        If there is no segment or one stands there twice, or one names a trial or frames that the
        tracks do not have.
    """
    if not segments:
        raise InputError("segments: at least one is needed.")
    if len(set(segments)) < len(segments):
        raise InputError("segments: one of them stands there twice.")
    source = with_trials(tracks)
    size = source.sizes["time"]
    known = [str(trial) for trial in source["trial"].values]
    for segment in segments:
        if segment.trial not in known:
            raise InputError(f"tracks: there is no trial {segment.trial}.")
        if not 0 <= segment.start < segment.stop <= size:
            raise InputError(
                f"tracks: trial {segment.trial} has {size} frames, and frames {segment.start} to "
                f"{segment.stop} are asked for."
            )
    places = [known.index(segment.trial) for segment in segments]
    longest = max(segments, key=lambda segment: segment.stop - segment.start)
    rows = slice(longest.start, longest.stop)
    time = source["time"].to_numpy()
    starts = time[[segment.start for segment in segments]]
    if "start_time" in source.coords:
        earlier = np.broadcast_to(source["start_time"].to_numpy(), len(known))
        starts = earlier[places] + (starts - time[0])
    together = len(set(starts.tolist())) == 1 and len({s.start for s in segments}) == 1
    labels = [segment.trial for segment in segments]
    if len(set(labels)) < len(labels):
        labels = [f"{s.trial}[{s.start}:{s.stop}]" for s in segments]
    data: dict[Hashable, xr.Variable] = {}
    coords: dict[Hashable, xr.Variable] = {}
    for name, variable in source.variables.items():
        if name in ("time", "trial", "start_time"):
            continue
        if name == "frame" and not together:
            continue
        if "time" in variable.dims and (name in source.data_vars or not together):
            variable = _cut(variable, segments, places)
        elif "time" in variable.dims:
            variable = variable.isel(time=rows)
        elif "trial" in variable.dims:
            variable = variable.isel(trial=places)
        (data if name in source.data_vars else coords)[name] = variable
    clock = (
        time[rows] if together else np.arange(longest.stop - longest.start) / tracks.attrs["fps"]
    )
    coords["time"] = xr.Variable("time", clock, dict(source["time"].attrs))
    coords["trial"] = xr.Variable("trial", labels)
    coords["start_time"] = xr.Variable("trial", starts, {"units": "s"})
    return xr.Dataset(data, coords, dict(tracks.attrs))


def _cut(variable: xr.Variable, segments: Sequence[Segment], places: Sequence[int]) -> xr.Variable:
    """Return the segments of a variable of time, one a trial, padded to the longest."""
    dims = ("trial", "time", *(dim for dim in variable.dims if dim not in ("trial", "time")))
    values = variable.transpose(*(dim for dim in dims if dim in variable.dims)).to_numpy()
    if "trial" not in variable.dims:
        values = np.broadcast_to(values, (max(places) + 1, *values.shape))
    longest = max(segment.stop - segment.start for segment in segments)
    out = np.zeros((len(segments), longest, *values.shape[2:]), values.dtype)
    if values.dtype.kind in "fc":
        out.fill(np.nan)
    for target, place, segment in zip(out, places, segments, strict=True):
        target[: segment.stop - segment.start] = values[place, segment.start : segment.stop]
    return xr.Variable(dims, out, dict(variable.attrs))
