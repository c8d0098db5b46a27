"""From the frame numbers and times of a file to a regular grid of frames per second."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.tracks.time_grid import MAX_JITTER, MAX_SPARSITY, Array, check_fps, rate_of
from swarmssm.tracks.validation import MAX_COORDINATE

__all__ = ["Clock", "Place", "clock_of", "row_name"]

#: Two statements of the frame rate that differ by less than this share agree.
RATE_TOLERANCE = 0.01
Place = Callable[[int], str]


@dataclass(frozen=True)
class Clock:
    """Where each row of a file lies on a regular grid.

    ``index`` has shape ``(row,)``, starts at 0 and increases; grid point i is at
    ``start + i / fps`` seconds, and is frame ``first_frame + i * frame_step`` of the recording if
    the file numbers its frames.
    """

    index: npt.NDArray[np.int64]
    fps: float
    start: float
    first_frame: int | None
    frame_step: int
    recorded: Array | None
    attrs: dict[str, Any]

    @property
    def origin(self) -> tuple[float, int | None, int]:
        """Time and frame number of the first grid point, and frames a step."""
        return self.start, self.first_frame, self.frame_step

    @property
    def length(self) -> int:
        """Number of points of the grid."""
        return int(self.index[-1]) + 1


def row_name(row: int) -> str:
    """Name a row of an array in a sentence."""
    return f"row {row}"


def clock_of(
    where: object,
    rows: int,
    *,
    fps: float | None = None,
    file_fps: float | None = None,
    frames: npt.ArrayLike | None = None,
    time: npt.ArrayLike | None = None,
    place: Place = row_name,
) -> Clock:
    """Put the rows of a file on a regular grid.

    ``fps`` counts the frames of the recording: where a file keeps only every k-th frame (frames 0,
    k, 2k, ...), its tracks have ``fps / k`` frames per second. A time that is late or early by less
    than a quarter of a step belongs to the nearest grid point. The rate comes from the caller, else
    from the file, else from its times; if the caller and the file disagree the caller is believed,
    and ``attrs["fps_in_file"]`` keeps what the file said.

    Parameters
    ----------
    where
        The file, for sentences.
    rows
        Number of rows.
    fps
        Frames per second as given by the caller.
    file_fps
        As stated in the file.
    frames, time
        Frame numbers and seconds of the rows, shape ``(row,)``, where the file has them.
    place
        Names a row in a sentence.

    Raises
    ------
    InputError
        If the rate is unknown, absurd or contradictory, if frames or times do not increase or
        leave the grid, or if there are fewer than two rows.
    """
    if rows < 2:
        have = "1 frame" if rows else "no frame"
        raise InputError(f"{where}: it has {have}; motion needs at least 2.")
    stated = None if file_fps is None else check_fps(file_fps, f"{where}")
    stamps = None if time is None else np.asarray(time, dtype=np.float64)
    if stamps is not None:
        _check_increasing(where, "time", stamps, place)
    if frames is not None:
        numbers = _whole(where, np.asarray(frames, dtype=np.float64), place)
        step = int(np.gcd.reduce(np.diff(numbers)))
        index = (numbers - numbers[0]) // step
    else:
        numbers, step = None, 1
        index = np.arange(rows) if stamps is None else _steps_of(where, stamps, place)
    if index[-1] + 1 > MAX_SPARSITY * max(rows, 100):
        raise InputError(
            f"{where}: {rows} rows span {index[-1] + 1} frames, so that nearly all would be "
            "missing. Mend the frame or time column."
        )
    measured = None if stamps is None else rate_of(stamps, index) * step
    known = stated if stated is not None else measured
    if fps is None and stated is not None and measured is not None and not _agree(stated, measured):
        raise InputError(
            f"{where}: it says {stated:g} frames per second, but its times say {measured:g}. "
            "Give the right one with fps=..."
        )
    if fps is not None:
        rate, source = check_fps(fps, "fps"), "argument"
    elif known is not None:
        rate, source = known, "file" if stated is not None else "time"
    else:
        raise InputError(f"{where}: the file does not tell its frames per second. Add fps=...")
    attrs: dict[str, Any] = {"fps_source": source}
    if fps is not None and known is not None and not _agree(rate, known):
        attrs["fps_in_file"] = known
    grid_rate = check_fps(rate / step, f"{where}")
    start = 0.0 if numbers is None else float(numbers[0]) / rate
    # A first time that is merely late or early within its step is no start of its own.
    if (
        stamps is not None
        and "fps_in_file" not in attrs
        and (numbers is None or abs(stamps[0] - start) * grid_rate >= 1)
    ):
        start = float(stamps[0])
    if stamps is not None and np.abs(stamps - start - index / grid_rate).max() < 0.01 / grid_rate:
        stamps = None
    first = None if numbers is None else int(numbers[0])
    return Clock(index.astype(np.int64), grid_rate, start, first, step, stamps, attrs)


def _agree(first: float, second: float) -> bool:
    return abs(first - second) <= RATE_TOLERANCE * max(first, second)


def _whole(where: object, values: Array, place: Place) -> npt.NDArray[np.int64]:
    """Return frame numbers as integers."""
    wrong = ~np.isfinite(values) | (values != np.round(values)) | (np.abs(values) > 2**53)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{where}: the frame in {place(row)} is {values[row]:g}; it must be a whole number."
        )
    _check_increasing(where, "frame", values, place)
    return values.astype(np.int64)


def _check_increasing(where: object, what: str, values: Array, place: Place) -> None:
    """Refuse values that are not finite or do not increase, naming the first place."""
    bad = ~np.isfinite(values)
    bad |= np.abs(values) > MAX_COORDINATE
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"{where}: the {what} in {place(row)} is {values[row]:g}; mend it or take the row away."
        )
    wrong = np.diff(values) <= 0
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        kind = "repeats" if values[row] == values[row - 1] else "falls below"
        raise InputError(
            f"{where}: the {what} in {place(row)} ({values[row]:.10g}) {kind} that of the row "
            f"before it ({values[row - 1]:.10g}); it must increase from row to row."
        )


def _steps_of(where: object, stamps: Array, place: Place) -> npt.NDArray[np.int64]:
    """Return the grid index of each time, where most neighbours are one step apart."""
    steps = np.diff(stamps)
    exact = steps / np.median(steps)
    if exact.max() > 2**31:
        row = int(np.argmax(exact)) + 1
        raise InputError(f"{where}: the time in {place(row)} leaps to {stamps[row]:g} s. Mend it.")
    counts = np.round(exact)
    off = np.abs(exact - counts) > MAX_JITTER
    off |= counts < 1
    if off.any():
        row = int(np.argmax(off)) + 1
        raise InputError(
            f"{where}: the time in {place(row)} comes {steps[row - 1]:g} s after the one before, "
            f"where {np.median(steps):g} s or a multiple is expected. Resample it evenly, or give "
            "frame numbers."
        )
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
