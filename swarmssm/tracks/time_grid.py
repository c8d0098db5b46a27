"""The regular grid of frames: the rate that time stamps tell, and the row that each belongs to."""

from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError

__all__ = [
    "MAX_FPS",
    "MAX_JITTER",
    "ROUNDING",
    "Array",
    "check_fps",
    "check_increasing",
    "grid_rows",
    "rate_of",
    "time_grid",
]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

MAX_FPS = 1e6
#: A time stamp may lie this far from the regular grid, in steps, and is then snapped to it.
MAX_JITTER = 0.25
#: A stamp nearer to the grid than this, in steps, is taken to lie on it.
ROUNDING = 1e-6
#: A recording may span this many times more frames than it has rows.
MAX_SPARSITY = 100
#: Frame numbers and rows beyond this are not exact in floating point.
MAX_FRAME = 2**53


def time_grid(
    num_times: int,
    fps: float | None = None,
    time: npt.ArrayLike | None = None,
    frames: npt.ArrayLike | None = None,
) -> tuple[Rows, Array, Rows | None, float]:
    """Put rows on a regular grid of frames.

    Parameters
    ----------
    num_times
        Number of rows.
    fps
        Frames per second; told by ``time`` if absent (:func:`rate_of`).
    time
        Seconds of each row, shape ``(row,)``.
    frames
        Whole frame numbers of each row, shape ``(row,)``. They define the grid where given.

    Returns
    -------
    Each row's place on the grid, the grid's times in seconds, its frame numbers (or None), and
    the frames per second.

    Raises
    ------
    InputError
        If ``time`` or ``frames`` do not increase, do not fit the rows or leave the grid.
    """
    stamps = None if time is None else _numbers(time, "time")
    marks = None if frames is None else _numbers(frames, "frames")
    for name, given in (("time", stamps), ("frames", marks)):
        if given is None:
            continue
        if given.size != num_times:
            raise InputError(f"{name}: {given.size} are given for {num_times} rows of position.")
        check_increasing(given, name)
    numbers = None
    if marks is not None:
        wrong = (marks != np.round(marks)) | (np.abs(marks) > MAX_FRAME)
        if wrong.any():
            place = int(np.argmax(wrong))
            raise InputError(
                f"frames: row {place} ({marks[place]:g}) is not a whole number. "
                "Give frame numbers, or seconds as time."
            )
        numbers = marks.astype(np.int64)
    places = None if numbers is None else numbers - numbers[:1]
    if fps is None:
        if stamps is None or num_times < 2:
            raise InputError("fps: frames per second are not known; give fps.")
        fps = rate_of(stamps, places)
    rate = check_fps(fps, "fps")
    start = 0.0
    if num_times == 0:
        rows = np.arange(0)
    elif numbers is not None:
        rows, start = numbers - numbers[0], float(numbers[0]) / rate
    elif stamps is not None:
        rows, start = grid_rows(stamps, rate, "time", "Give the right fps, or frame numbers.")
    else:
        rows = np.arange(num_times)
    length = int(rows[-1]) + 1 if num_times else 0
    if length > MAX_SPARSITY * max(num_times, 100):
        raise InputError(
            f"{'time' if numbers is None else 'frames'}: {num_times} rows span {length} frames at "
            f"{rate:g} frames per second; nearly all would be missing. Give the right fps."
        )
    grid = None if numbers is None else numbers[:1] + np.arange(length)
    return rows, start + np.arange(length) / rate, grid, rate


def rate_of(stamps: Array, rows: Rows | None = None) -> float:
    """Return the frame rate that time stamps tell, in frames per second.

    It is the least-squares slope of the rows on the stamps, which the rounding of the stamps (to a
    millisecond, or to single precision) hardly moves, unlike the rate of a typical step. The
    roundest rate, or period, within three standard errors of it is returned.

    Parameters
    ----------
    stamps
        Seconds, shape ``(row,)``, increasing, at least two.
    rows
        Each stamp's place on the grid. If absent, the most common step is taken to be one frame.
    """
    grain = 4.0 * float(np.spacing(np.abs(stamps).max()))
    stamps = stamps - stamps[0]
    steps = np.diff(stamps)
    typical = float(np.partition(steps, (steps.size - 1) // 2)[(steps.size - 1) // 2])
    if typical * MAX_FPS < 0.5 or stamps[-1] > typical * MAX_FRAME:
        return 1.0 / typical  # far from any recording: for the caller to refuse
    if rows is None:
        step = float(steps[np.abs(steps / typical - 1.0) < MAX_JITTER].mean())
        counts = np.maximum(1.0, np.round(steps / step))
        rows = np.concatenate([[0.0], np.cumsum(counts)]).astype(np.int64)
    places = rows - rows.mean()
    centred = stamps - stamps.mean()
    slope = float((places @ places) / (places @ centred))

    def misfit(rate: float) -> float:
        """Return the mean squared distance from the grid, in steps."""
        return float(np.var(centred * rate - places))

    allowed = misfit(slope) * (1.0 + 9.0 / stamps.size) + (1e-9 + grain * slope) ** 2
    for digits in range(1, 16):
        for rate in (float(f"{slope:.{digits}g}"), 1.0 / float(f"{1.0 / slope:.{digits}g}")):
            if misfit(rate) <= allowed:
                return rate
    return slope


def grid_rows(stamps: Array, fps: float, what: str, mend: str) -> tuple[Rows, float]:
    """Return the place of each stamp on the grid ``1 / fps``, and the time of the first.

    The grid starts at the first stamp or, where the stamps jitter, at the place that fits most of
    them: the first one jitters like the others.

    Raises
    ------
    InputError
        If a stamp lies further than a quarter of a step from the grid, or two on one place of it.
    """
    exact = (stamps - stamps[0]) * fps
    if exact[-1] > MAX_FRAME:
        raise InputError(f"{what}: the rows span {exact[-1]:g} frames at fps = {fps:g}. {mend}")
    shift = float(np.median(exact - np.round(exact)))
    if np.abs(exact - np.round(exact)).max() <= ROUNDING:
        shift = 0.0
    rows = np.round(exact - shift)
    off = np.abs(exact - shift - rows) > MAX_JITTER
    off[1:] |= np.diff(rows) < 1
    if off.any():
        place = int(np.argmax(off))
        raise InputError(
            f"{what}: row {place} ({stamps[place]:.10g} s) does not lie on a grid of {fps:g} "
            f"frames per second. {mend}"
        )
    return (rows - rows[0]).astype(np.int64), float(stamps[0] + shift / fps)


def check_fps(fps: object, where: str) -> float:
    """Return a frame rate as a number.

    Raises
    ------
    InputError
        If it is not one, not positive or above :data:`MAX_FPS`.
    """
    try:
        # Files of other programs store a number as an array of length one.
        rate = float(np.asarray(fps, dtype=np.float64).reshape(()))
    except (TypeError, ValueError):
        rate = np.nan
    if not 0 < rate <= MAX_FPS:
        raise InputError(
            f"{where}: frames per second must lie between 0 and {MAX_FPS:g}, not {fps}."
        )
    return rate


def check_increasing(values: npt.NDArray[Any], what: str) -> None:
    """Refuse values that are not finite or not strictly increasing, naming the first place.

    Raises
    ------
    InputError
        At the first such value.
    """
    if not np.isfinite(values).all():
        raise InputError(
            f"{what}: row {int(np.argmin(np.isfinite(values)))} is not a finite number."
        )
    wrong = np.diff(values) <= 0
    if wrong.any():
        place = int(np.argmax(wrong)) + 1
        kind = "repeats" if values[place] == values[place - 1] else "falls below"
        raise InputError(
            f"{what}: row {place} ({values[place]:.10g}) {kind} the row before it "
            f"({values[place - 1]:.10g}); it must increase."
        )


def _numbers(values: npt.ArrayLike, name: str) -> Array:
    """Return one number a row."""
    try:
        return np.asarray(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: it must be a number for each row.") from error
