"""Proper scores of forecasts that are given as draws or as a normal: CRPS, energy score, intervals.

Scores of draws are the *fair* ones: their expectation does not depend on how many draws there are,
so that a forecast of 20 draws compares with one of 1000, and with the closed form of a normal. They
are those of the package scoringrules, to which tests hold them, without the seconds that it takes
to compile at import.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy

__all__ = [
    "ensemble_crps",
    "ensemble_energy_score",
    "ensemble_intervals",
    "gaussian_crps",
    "gaussian_energy_score",
    "gaussian_intervals",
]

Array = npt.NDArray[np.float64]

#: Nodes of the quadrature behind the energy score of a normal; its error is then below 1e-8.
NODES = 96


def ensemble_crps(truth: Array, draws: Array) -> Array:
    r"""Return the continuous ranked probability score of draws.

    .. math:: \frac1M \sum_i |x_i - y| - \frac{1}{2 M (M - 1)} \sum_{i, j} |x_i - x_j|

    The fair estimator, by probability-weighted moments: the same number at the cost of a sort.

    Parameters
    ----------
    truth
        ``(...)``; NaN where unknown.
    draws
        ``(draw, ...)``, at least two.

    Returns
    -------
    ``(...)``, in the unit of the truth, lower is better; infinite where a draw is, NaN where truth
    or a draw is.

    References
    ----------
    C. A. T. Ferro (2014), Fair scores for ensemble forecasts, Q. J. R. Meteorol. Soc. 140.
    """
    _check_draws(draws)
    there = ~np.isnan(truth)
    out = np.full(draws.shape[1:], np.nan)
    out[there & np.isinf(draws).any(0)] = np.inf
    known = there & np.isfinite(draws).all(0)
    # About the truth, so that places far from the origin lose no digits.
    apart = np.moveaxis(draws[:, known] - np.broadcast_to(truth, draws.shape[1:])[known], 0, -1)
    with np.errstate(over="ignore", invalid="ignore"):
        count = len(draws)
        ranks = (2.0 * np.arange(count) - count + 1.0) / (count * (count - 1.0))
        scores = np.abs(apart).mean(-1) - np.sort(apart, axis=-1) @ ranks
    out[known] = _broken_down(scores)
    return out


def gaussian_crps(truth: Array, mean: Array, sd: Array) -> Array:
    """Return the continuous ranked probability score of a normal forecast, in closed form.

    Parameters
    ----------
    truth, mean, sd
        ``(...)``, broadcast against each other; NaN where unknown. Where ``sd`` is 0 the score is
        the distance of the mean from the truth.

    Returns
    -------
    ``(...)``, in the unit of the truth, lower is better; infinite where ``mean`` is.

    References
    ----------
    T. Gneiting, A. E. Raftery, A. H. Westveld and T. Goldman (2005), Calibrated probabilistic
    forecasting using ensemble model output statistics, Mon. Weather Rev. 133.
    """
    error, spread = np.broadcast_arrays(truth - mean, sd)
    out = np.array(np.abs(error))
    inside = np.isfinite(error) & (spread > 0)
    units, sd = error[inside] / spread[inside], spread[inside]
    density = np.exp(-0.5 * units**2) / math.sqrt(2.0 * math.pi)
    erf = scipy.special.erf(units / math.sqrt(2.0))
    out[inside] = sd * (units * erf + 2.0 * density - 1.0 / math.sqrt(math.pi))
    out[np.isnan(spread)] = np.nan
    return out


def ensemble_energy_score(truth: Array, draws: Array) -> Array:
    r"""Return the energy score of draws of a vector.

    .. math:: \frac1M \sum_i \|x_i - y\| - \frac{1}{2 M (M - 1)} \sum_{i, j} \|x_i - x_j\|

    The fair estimator; with one coordinate it is the CRPS.

    Parameters
    ----------
    truth
        ``(..., space)``; NaN where unknown.
    draws
        ``(draw, ..., space)``, at least two.

    Returns
    -------
    ``(...)``, in the unit of the truth, lower is better; infinite where a draw is, NaN where truth
    or a draw is.

    References
    ----------
    T. Gneiting and A. E. Raftery (2007), Strictly proper scoring rules, prediction, and
    estimation, JASA 102.
    """
    _check_draws(draws)
    count = len(draws)
    there = ~np.isnan(truth).any(-1)
    out = np.full(draws.shape[1:-1], np.nan)
    out[there & np.isinf(draws).any((0, -1))] = np.inf
    known = there & np.isfinite(draws).all((0, -1))
    apart = np.moveaxis(draws[:, known] - np.broadcast_to(truth, draws.shape[1:])[known], 0, 1)
    with np.errstate(over="ignore", invalid="ignore"):
        near = np.sqrt((apart**2).sum(-1)).mean(-1)
        spread = np.array([scipy.spatial.distance.pdist(points).sum() for points in apart])
        out[known] = _broken_down(near - spread / (count * (count - 1)))
    return out


def gaussian_energy_score(truth: Array, mean: Array, covariance: Array) -> Array:
    r"""Return the energy score of a normal forecast of a vector.

    .. math:: E\|X - y\| - \tfrac12 E\|X - X'\|, \qquad
        E\|Z\| = \frac{1}{\sqrt\pi} \int_0^\infty \frac{1 - E e^{-r^2 \|Z\|^2}}{r^2}\, dr

    The expectation under the integral is that of a weighted sum of non-central chi squares, which
    is elementary; the integral is by quadrature, good to eight digits.

    Parameters
    ----------
    truth, mean
        ``(..., space)``; NaN where unknown.
    covariance
        ``(..., space, space)``, broadcast against them.

    Returns
    -------
    ``(...)``, in the unit of the truth, lower is better; infinite where ``mean`` is, NaN where
    anything is unknown.
    """
    error = truth - mean
    matrix = np.broadcast_to(covariance, (*error.shape, error.shape[-1]))
    there = ~np.isnan(error).any(-1) & ~np.isnan(matrix).any((-1, -2))
    known = there & np.isfinite(error).all(-1) & np.isfinite(matrix).all((-1, -2))
    out = np.where(there, np.inf, np.nan)
    variances, axes = np.linalg.eigh(matrix[known])
    variances = variances.clip(min=0.0)
    along = (error[known][:, None, :] @ axes)[:, 0]
    spread = _expected_length(np.zeros_like(along), variances)
    out[known] = _expected_length(along, variances) - math.sqrt(0.5) * spread
    return out


def _expected_length(mean: Array, variances: Array) -> Array:
    """Return the expected length of normal vectors ``(vector, axis)`` with independent axes."""
    size = np.sqrt((mean**2 + variances).sum(-1))
    out = np.zeros(len(mean))
    some = size > 0
    scaled, variance = mean[some] / size[some, None], variances[some] / size[some, None] ** 2
    # r = tan(angle) makes the integrand smooth at both ends.
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    angle = 0.25 * np.pi * (nodes + 1.0)
    squared = np.tan(angle)[:, None, None] ** 2
    wider = 1.0 + 2.0 * squared * variance
    logarithm = -(squared * scaled**2 / wider + 0.5 * np.log(wider)).sum(-1)
    integrand = -np.expm1(logarithm) / np.sin(angle)[:, None] ** 2
    out[some] = size[some] * (0.25 * np.pi * weights @ integrand) / math.sqrt(np.pi)
    return out


def ensemble_intervals(draws: Array, levels: Sequence[float]) -> tuple[Array, Array]:
    """Return the ends of central intervals of draws.

    Of n draws, between ranks q (n + 1), which holds another draw with the probability that the
    level says, as long as n is at least ``2 / (1 - level) - 1``; with fewer, between the least and
    the greatest.

    Parameters
    ----------
    draws
        ``(draw, ...)``.
    levels
        Probabilities between 0 and 1.

    Returns
    -------
    Lower and upper ends ``(level, ...)``; where a draw is infinite, minus and plus infinity, where
    one is NaN, NaN.
    """
    share = np.asarray(levels, dtype=np.float64)
    broken = np.isinf(draws).any(0)
    values = np.where(np.isfinite(draws), draws, 0.0)
    tails = np.concatenate([0.5 * (1.0 - share), 0.5 * (1.0 + share)])
    ends = np.quantile(values, tails, axis=0, method="weibull")
    lower, upper = np.split(ends, 2)
    lower[:, broken], upper[:, broken] = -np.inf, np.inf
    unknown = np.isnan(draws).any(0)
    lower[:, unknown], upper[:, unknown] = np.nan, np.nan
    return lower, upper


def gaussian_intervals(mean: Array, sd: Array, levels: Sequence[float]) -> tuple[Array, Array]:
    """Return the ends of central intervals of a normal: lower and upper ``(level, ...)``."""
    mean, sd = np.broadcast_arrays(mean, sd)
    widths = scipy.stats.norm.ppf(0.5 * (1.0 + np.asarray(levels, dtype=np.float64)))
    half = widths.reshape(-1, *(1,) * mean.ndim) * sd
    return mean - half, mean + half


def _check_draws(draws: Array) -> None:
    """Refuse a single draw, whose spread is unknown."""
    if len(draws) < 2:
        raise ValueError(f"a fair score needs at least two draws, not {len(draws)}")


def _broken_down(scores: Array) -> Array:
    """Return scores, infinite where draws are so far off that the numbers overflow."""
    return np.where(np.isnan(scores), np.inf, scores)
