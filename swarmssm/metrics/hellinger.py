"""How far two distributions are apart."""

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.metrics.masked import Array

__all__ = ["hellinger_distance"]


def hellinger_distance(first: npt.ArrayLike, second: npt.ArrayLike) -> Array:
    r"""Return the Hellinger distance of histograms: 0 for the same, 1 if they share no bin.

    .. math:: H(p, q) = \Big(\tfrac12 \sum_k (\sqrt{p_k} - \sqrt{q_k})^2\Big)^{1/2}

    Parameters
    ----------
    first, second
        Shape ``(..., bin)``, not negative; each is divided by its own sum.

    Returns
    -------
    Shape ``(...)``, from 0 to 1; NaN where a histogram is empty or holds NaN.

    Raises
    ------
    InputError
        If there are different numbers of bins, or one is negative.
    """
    pair = [np.asarray(values, dtype=np.float64) for values in (first, second)]
    if pair[0].shape[-1:] != pair[1].shape[-1:] or not pair[0].ndim:
        raise InputError("histograms: both must have the same bins.")
    if any((values < 0).any() for values in pair):
        raise InputError("histograms: no bin may be negative.")
    shares = []
    for values in pair:
        total = values.sum(-1, keepdims=True)
        shares.append(np.divide(values, total, out=np.full_like(values, np.nan), where=total > 0))
    distance: Array = np.sqrt(0.5 * ((np.sqrt(shares[0]) - np.sqrt(shares[1])) ** 2).sum(-1))
    return distance
