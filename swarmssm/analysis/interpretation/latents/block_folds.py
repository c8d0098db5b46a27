"""Parts of a recording to fit on and to test on: whole trials, or blocks of time with gaps.

Frames resemble the frames beside them. What is tested on a frame whose neighbours it was fitted on
scores what it remembers, so frames are never left out one by one.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.model_selection import GroupKFold

from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["Cells", "Folds", "block_folds", "decorrelation"]

Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.int64]
#: From this many trials on whole trials are left out.
LEAST_TRIALS = 3


@dataclass(frozen=True)
class Folds:
    """Which frames train and which test each fold.

    Attributes
    ----------
    train, test
        ``(fold, trial, time)`` of bool.
    by
        ``"trial"`` or ``"time"``.
    gap
        Frames on either side of a tested block of time that neither train nor test.
    """

    train: Mask
    test: Mask
    by: str
    gap: int

    def __len__(self) -> int:
        """Return the number of folds."""
        return len(self.train)


def block_folds(known: Mask, folds: int = 5, gap: int = 0) -> Folds:
    """Divide a recording for cross-validation: by trials if there are three or more, else by time.

    Parameters
    ----------
    known
        ``(trial, time)`` of bool: frames there are.
    folds
        How many, at least 3; at most as many as there are trials.
    gap
        Frames left out of training on either side of a tested block of time.

    Returns
    -------
    Folds in which each known frame is tested once.

    Raises
    ------
    InputError
        If there are fewer than three folds, or so few frames that a block has none or leaves none.
    """
    if folds < 3:
        raise InputError(f"folds: there must be at least 3, not {folds}.")
    trials = np.flatnonzero(known.any(1))
    if len(trials) >= LEAST_TRIALS:
        folds = min(folds, len(trials))
        test = np.zeros((folds, *known.shape), dtype=bool)
        # Frames weigh trials, so that folds are of about one size.
        groups = np.repeat(trials, known[trials].sum(1))
        splitter = GroupKFold(folds)
        for fold, (_, tested) in enumerate(splitter.split(groups, groups=groups)):
            test[fold, np.unique(groups[tested])] = True
        test &= known
        return Folds(known & ~test, test, "trial", 0)
    test = np.zeros((folds, *known.shape), dtype=bool)
    near = test.copy()
    for trial in trials:
        frames = np.flatnonzero(known[trial])
        for fold, block in enumerate(np.array_split(frames, folds)):
            if len(block):
                test[fold, trial, block] = True
                near[fold, trial, max(0, block[0] - gap) : block[-1] + gap + 1] = True
    train = known & ~near
    if not (test.any((1, 2)).all() and train.any((1, 2)).all()):
        raise InputError(
            f"tracks: {int(known.sum())} frames are too few for {folds} blocks with gaps of {gap} "
            "frames. Give more frames."
        )
    return Folds(train, test, "time", gap)


def decorrelation(values: Array, level: float = np.exp(-1.0)) -> int:
    """Return after how many frames values have forgotten themselves.

    Parameters
    ----------
    values
        ``(trial, time, individual, feature)``, NaN where unknown.
    level
        Autocorrelation, averaged over features, that counts as forgotten.

    Returns
    -------
    First lag with an autocorrelation below the level, at most half the number of frames.
    """
    flat = np.moveaxis(values, 1, 0).reshape(values.shape[1], -1, values.shape[-1])
    with np.errstate(invalid="ignore"):
        centred = flat - np.nanmean(flat, (0, 1), keepdims=True)
    known = np.isfinite(centred)
    centred = np.where(known, centred, 0.0)
    power = np.square(centred).sum((0, 1)) / np.maximum(known.sum((0, 1)), 1)
    moving = power > 0
    longest = max(1, len(flat) // 2)
    for lag in range(1, longest):
        count = (known[lag:] & known[:-lag]).sum((0, 1))
        product = (centred[lag:] * centred[:-lag]).sum((0, 1))
        ratio = product[moving] / np.maximum(count[moving], 1) / power[moving]
        if len(ratio) == 0 or ratio.mean() < level:
            return lag
    return longest


@dataclass(frozen=True)
class Cells:
    """Samples parted so that all of a cell train and test the same folds.

    Attributes
    ----------
    order
        ``(sample,)``: samples in the order of their cells.
    bounds
        ``(cell + 1,)``: where each cell begins in that order.
    train, test
        ``(fold, cell)`` of bool.
    """

    order: Rows
    bounds: Rows
    train: Mask
    test: Mask

    @classmethod
    def of(cls, frames: Rows, folds: Folds) -> "Cells":
        """Part samples.

        Parameters
        ----------
        frames
            ``(sample,)``: place of each sample's frame among the flattened ``(trial, time)``.
        folds
            Which frames train and test.
        """
        number = len(folds)
        use = np.concatenate([folds.train.reshape(number, -1), folds.test.reshape(number, -1)])
        kinds, cell = np.unique(use, axis=1, return_inverse=True)
        cell = cell.reshape(-1)[frames]
        order = np.argsort(cell, kind="stable")
        bounds = np.searchsorted(cell[order], np.arange(kinds.shape[1] + 1))
        return cls(order, bounds, kinds[:number], kinds[number:])

    @property
    def count(self) -> Array:
        """Number of samples of each cell."""
        return np.diff(self.bounds).astype(np.float64)

    @property
    def slices(self) -> list[slice]:
        """Where each cell lies among ordered samples."""
        return [slice(a, b) for a, b in zip(self.bounds[:-1], self.bounds[1:], strict=True)]
