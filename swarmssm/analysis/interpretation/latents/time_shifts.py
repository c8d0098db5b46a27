"""What chance alone would give: quantities of a swarm, moved against each other in time.

Two recordings that have nothing to do with each other may still seem to go together for a while,
since each changes slowly. So that a null hypothesis keeps this slowness, targets are not shuffled:
those of the whole swarm are turned around in time by one random shift, and between trials they are
exchanged.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["Shifts", "filled", "p_values", "shifts_of"]

Rows = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Shifts:
    """Ways of moving one quantity of a recording against another.

    Attributes
    ----------
    source
        ``(shift, trial)``: the trial whose values each trial gets.
    offset
        ``(shift, trial)``: by how many frames they are turned around.
    lengths
        ``(trial,)``: frames of each trial.
    """

    source: Rows
    offset: Rows
    lengths: Rows

    def __len__(self) -> int:
        """Return their number."""
        return len(self.source)

    @property
    def least_p(self) -> float:
        """The smallest p-value that so many shifts can give."""
        return 1.0 / (1 + len(self))

    def moved(self, values: Array, shift: int) -> Array:
        """Return values ``(trial, time, ...)`` moved by one of the shifts."""
        out = np.empty_like(values)
        for trial, (source, offset) in enumerate(
            zip(self.source[shift], self.offset[shift], strict=True)
        ):
            length = max(1, int(self.lengths[source]))
            rows = (np.arange(values.shape[1]) + offset) % length
            out[trial] = values[source, rows]
        return out

    def batches(self, size: int) -> Iterator[range]:
        """Yield the places of all shifts, at most ``size`` at once."""
        for start in range(0, len(self), size):
            yield range(start, min(start + size, len(self)))


def shifts_of(lengths: Rows, count: int, least: int, seed: int = 0) -> Shifts:
    """Draw shifts of a recording.

    Parameters
    ----------
    lengths
        ``(trial,)``: frames of each trial, 0 for one that is empty.
    count
        How many; fewer where a single trial does not have so many different ones.
    least
        Frames by which a trial is shifted against itself at least, in either direction.
    seed
        Seed.

    Raises
    ------
    InputError
        If a trial is too short to be shifted.
    """
    generator = np.random.default_rng(seed)
    lengths = np.asarray(lengths)
    there = np.flatnonzero(lengths > 0)
    least = max(1, least)
    shortest = int(lengths[there].min()) if len(there) else 0
    if shortest <= 2 * least:
        raise InputError(
            f"tracks: a trial has only {shortest} frames, too few to shift "
            f"forces against latents by {least} frames or more. Give longer recordings."
        )
    if len(there) == 1:
        length = int(lengths[there[0]])
        possible = np.arange(least, length - least + 1)
        offset = np.zeros((min(count, len(possible)), len(lengths)), dtype=np.int64)
        offset[:, there[0]] = generator.choice(possible, len(offset), replace=False)
        source = np.tile(np.arange(len(lengths)), (len(offset), 1))
        return Shifts(source, offset, lengths)
    source = np.tile(np.arange(len(lengths)), (count, 1))
    offset = np.zeros_like(source)
    for shift in range(count):
        source[shift, there] = generator.permutation(there)
        for trial in there:
            length = int(lengths[source[shift, trial]])
            own = source[shift, trial] == trial
            start, stop = (least, length - least + 1) if own else (0, length)
            offset[shift, trial] = generator.integers(start, stop)
    return Shifts(source, offset, lengths)


def filled(values: Array) -> Array:
    """Return values ``(trial, time, individual, feature)`` without gaps, so that they can be moved.

    A gap takes the last value before it, or the first after it where there is none before; an
    individual that is never seen in a trial takes the mean of those that are.
    """
    out = values.copy()
    known = np.asarray(np.isfinite(out).all(-1))
    rows = np.arange(out.shape[1])[None, :, None]
    before = np.maximum.accumulate(np.where(known, rows, -1), axis=1)
    ahead = np.where(known, rows, out.shape[1])
    after = np.minimum.accumulate(ahead[:, ::-1], axis=1)[:, ::-1]
    place = np.where(before >= 0, before, np.where(after < out.shape[1], after, 0))
    out = np.take_along_axis(out, place[..., None], axis=1)
    never = np.asarray(~known.any(1))
    if never.any():
        seen = np.where(never[:, None, :, None], np.nan, out)
        count = np.isfinite(seen).sum(2, keepdims=True)
        mean = np.nansum(seen, 2, keepdims=True) / np.maximum(count, 1)
        out = np.where(never[:, None, :, None], mean, out)
    return out


def p_values(found: Array, null: Array) -> Array:
    """Return ``(1 + number of null >= found) / (1 + number)``, NaN where nothing was found.

    Parameters
    ----------
    found
        ``(...)``.
    null
        ``(shift, ...)``.
    """
    with np.errstate(invalid="ignore"):
        larger = (null >= found).sum(0)
    return np.where(np.isnan(found), np.nan, (1.0 + larger) / (1.0 + len(null)))
