"""Posterior intervals from draws, as every analysis gives them."""

import numpy as np

from swarmssm.tracks import Array

__all__ = ["QUANTILES", "known_mean", "quantiles"]

#: Ends and middle of the intervals.
QUANTILES = (0.05, 0.5, 0.95)


def quantiles(values: Array) -> Array:
    """Return :data:`QUANTILES` over the first dimension, ignoring NaN.

    Of n draws, the interval between ranks 0.05 (n + 1) and 0.95 (n + 1), which holds another draw
    with probability 0.9 where n is at least 19; with fewer, between the least and the greatest.

    Parameters
    ----------
    values
        ``(draw, ...)``, finite or NaN, at least one draw.

    Returns
    -------
    ``(quantile, ...)``; NaN where all draws are NaN.
    """
    # One sort for all columns: NaN come last in each.
    ordered = np.sort(values, axis=0)
    number = np.isfinite(ordered).sum(0)
    out = np.empty((len(QUANTILES), *values.shape[1:]))
    for row, share in enumerate(QUANTILES):
        place = np.clip(share * (number + 1.0) - 1.0, 0.0, np.maximum(number - 1.0, 0.0))
        below = np.floor(place).astype(np.int64)
        above = np.minimum(below + 1, np.maximum(number - 1, 0))
        low, high = (np.take_along_axis(ordered, at[None], 0)[0] for at in (below, above))
        out[row] = low + (high - low) * (place - below)
    out[:, number == 0] = np.nan
    return out


def known_mean(values: Array, axes: int | tuple[int, ...]) -> Array:
    """Return the mean over some dimensions of what is finite, NaN where nothing is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axes, dtype=np.float64)
    count = known.sum(axes)
    mean: Array = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    return mean
