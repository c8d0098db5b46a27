"""Posterior intervals from draws, as every analysis gives them."""

import numpy as np

from swarmssm.tracks import Array

__all__ = ["QUANTILES", "quantiles"]

#: Ends and middle of the intervals.
QUANTILES = (0.05, 0.5, 0.95)


def quantiles(values: Array) -> Array:
    """Return :data:`QUANTILES` over the first dimension, NaN left out.

    Of n draws, the interval between ranks 0.05 (n + 1) and 0.95 (n + 1), which holds another draw
    with probability 0.9 where n is at least 19; with fewer, between the least and the greatest.

    Parameters
    ----------
    values
        ``(draw, ...)``.

    Returns
    -------
    ``(quantile, ...)``; NaN where no draw is known.
    """
    known = np.isfinite(values).any(0)
    out = np.full((len(QUANTILES), *values.shape[1:]), np.nan)
    some = values[:, known]
    if some.size:
        whole = bool(np.isfinite(some).all())
        function = np.quantile if whole else np.nanquantile
        out[:, known] = function(some, QUANTILES, axis=0, method="weibull")
    return out
