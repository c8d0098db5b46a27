r"""Uniformity of ranks: simultaneous bands of an empirical distribution function.

Ranks of a truth among L draws of its posterior are uniform on 0, ..., L if the posterior is right.
Of N such ranks let :math:`N_k` be how many are below k. Under uniformity
:math:`N_k \sim \mathrm{Binomial}(N, k / (L + 1))` for each k, and the :math:`N_k` are a Markov
chain; the band of Säilynoja, Bürkner and Vehtari (2022, Statistics and Computing 32:32) is made of
the intervals of these binomials, all of one level, which is such that *all* of the function is
inside with the probability asked for.
"""

import functools

import numpy as np
import numpy.typing as npt
from scipy import special, stats

from swarmssm.errors import InputError

__all__ = ["ecdf_band", "histogram_interval", "inside_probability", "uniformity_p_value"]

Counts = npt.NDArray[np.int64]
#: Points of a function at most: between them it cannot move far.
POINTS = 200
HALVINGS = 20


def ecdf_band(
    number: int, draws: int, level: float = 0.95
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return a simultaneous band for the distribution function of ranks.

    Parameters
    ----------
    number
        N, of ranks.
    draws
        L, so that ranks are 0 to L.
    level
        Probability that the function of uniform ranks is inside at all points.

    Returns
    -------
    Points :math:`k / (L + 1)`, and the lowest and highest share of ranks below k there that is
    still inside. At most 200 points.

    Raises
    ------
    InputError
        If a number is not positive, or the level is none.
    """
    _check(number, draws, level)
    low, high = _band(number, draws, level)
    return _points(draws), low / number, high / number


def uniformity_p_value(ranks: npt.ArrayLike, draws: int) -> float:
    """Return the probability of ranks at least as uneven as these if the posterior is right.

    How uneven: by the least probable of the points of the function. The ranks are inside
    :func:`ecdf_band` of level 0.95 if this is above 0.05, and outside if it is below.

    Parameters
    ----------
    ranks
        ``(data set,)``, from 0 to ``draws``.
    draws
        L.

    Raises
    ------
    InputError
        If there are no ranks, or some are out of range.
    """
    values = np.asarray(ranks)
    _check(len(values), draws, 0.5)
    if values.min() < 0 or values.max() > draws:
        raise InputError(f"ranks: they must be from 0 to {draws}.")
    counts = _below(values, draws)
    points = _points(draws)
    number = len(values)
    tails = np.minimum(
        stats.binom.cdf(counts, number, points), stats.binom.sf(counts - 1, number, points)
    )
    # Just inside is what has tails as small as these: the band that excludes them is narrower.
    own = 2.0 * float(tails.min())
    if own >= 1.0:
        return 1.0
    low, high = _intervals(number, draws, own * (1.0 + 1e-9))
    return 1.0 - inside_probability(number, points, low, high)


def histogram_interval(number: int, share: float, level: float = 0.95) -> tuple[float, float]:
    """Return the central interval of the count in one bin that has a share of all ranks."""
    tail = 0.5 * (1.0 - level)
    return (
        float(stats.binom.ppf(tail, number, share)),
        float(stats.binom.ppf(1.0 - tail, number, share)),
    )


def inside_probability(
    number: int, points: npt.NDArray[np.float64], low: Counts, high: Counts
) -> float:
    """Return the probability that a function of uniform numbers stays within bounds.

    Exact: the counts below one point after the other are a Markov chain, whose steps are binomial.

    Parameters
    ----------
    number
        Of uniform numbers.
    points
        Increasing, within 0 and 1.
    low, high
        Least and greatest count below each point.
    """
    # Logarithms of factorials, once: scipy's binom.pmf takes nine times as long.
    factorial = special.gammaln(np.arange(number + 2, dtype=np.float64) + 1.0)
    before, values, weights = 0.0, np.zeros(1, dtype=np.int64), np.ones(1)
    for point, least, most in zip(points, low, high, strict=True):
        following = np.arange(least, most + 1)
        share = (point - before) / (1.0 - before)
        steps = following[None, :] - values[:, None]
        left = (number - following)[None, :]
        up = np.maximum(steps, 0)
        moves = np.exp(
            factorial[number - values][:, None]
            - factorial[up]
            - factorial[left]
            + up * np.log(share)
            + left * np.log1p(-share)
        )
        weights = weights @ np.where(steps >= 0, moves, 0.0)
        before, values = point, following
    return float(min(weights.sum(), 1.0))


@functools.lru_cache(maxsize=64)
def _band(number: int, draws: int, level: float) -> tuple[Counts, Counts]:
    """Return least and greatest counts: the narrowest intervals that hold all often enough."""
    points = _points(draws)
    # Few points are independent enough to need the first of these, and none need the second.
    least, most = np.log((1.0 - level) / (2.0 * len(points))), np.log(1.0 - level)
    for _ in range(HALVINGS):
        middle = 0.5 * (least + most)
        inside = inside_probability(number, points, *_intervals(number, draws, np.exp(middle)))
        if inside >= level:
            least = middle
        else:
            most = middle
    return _intervals(number, draws, float(np.exp(least)))


def _intervals(number: int, draws: int, outside: float) -> tuple[Counts, Counts]:
    """Return the counts at each point whose tails both have at least half of a probability."""
    points = _points(draws)
    low = np.asarray(stats.binom.ppf(0.5 * outside, number, points))
    high = np.asarray(stats.binom.isf(0.5 * outside, number, points))
    return low.astype(np.int64), high.astype(np.int64)


def _points(draws: int) -> npt.NDArray[np.float64]:
    return _steps(draws) / (draws + 1)


def _steps(draws: int) -> Counts:
    """Return k of each point: all ranks, or evenly spaced ones."""
    number = min(draws, POINTS)
    steps: Counts = np.unique(np.round(np.linspace(1, draws, number)).astype(np.int64))
    return steps


def _below(ranks: npt.NDArray[np.int64], draws: int) -> Counts:
    """Return how many ranks are below each point."""
    counts: Counts = np.searchsorted(np.sort(ranks), _steps(draws), side="left")
    return counts


def _check(number: int, draws: int, level: float) -> None:
    if number < 1 or draws < 1:
        raise InputError("ranks: there must be at least one data set and one draw.")
    if not 0.0 < level < 1.0:
        raise InputError(f"level: it must be between 0 and 1, and it is {level}.")
