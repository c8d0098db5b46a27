r"""Distances of the recording from its replicates, and their p-values.

If the model is right, the recording and its D replicates are exchangeable. Any distance that treats
all D + 1 the same way then has a uniform rank, whatever the statistic, and

.. math:: p = \frac{1 + \#\{d : \text{replicate } d \text{ is at least as far}\}}{D + 1}

is a valid p-value for any number of draws, never 0. Distances are:

- a *number*: its rank among the replicates', on either side: twice the smaller tail.
- a *histogram*: the Hellinger distance to the mean of all the others, for each of the D + 1.
- a *curve*: the extreme rank length of Myllymäki et al. (2017, J. R. Stat. Soc. B 79:381): at
  each point a curve has a rank from outside among all; curves are ordered by the worst of their
  ranks, then by the second worst, and so on. The heights of single points may be of any size.

A replicate that diverged, or has no value, never counts as "at least as far": each lowers p. A
recording never diverges.

Some of many statistics are far by chance. The adjusted p-value is that of Westfall and Young
(1993): the share of replicates whose *largest* standardised distance over all statistics exceeds
that of the recording in this one; if the model is right, any adjusted p-value is below 0.05 in one
check of twenty. The standardised distance is that from the median of all D + 1, in units in which
their 5 % and 95 % quantiles are 1.64, on each side separately.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from swarmssm.metrics.hellinger import hellinger_distance
from swarmssm.tracks import Array

__all__ = ["Judged", "adjusted_p_values", "judge"]

#: A standard normal number is within 5 % and 95 % as far.
NORMAL = 1.6448536269514722

#: Stands for any distance from replicates that are all the same.
FARTHEST = 1e9


@dataclass(frozen=True)
class Judged:
    """Comparison of one statistic with its replicates.

    Attributes
    ----------
    p_value
        NaN if the recording has no value.
    place
        Standardised distance of the recording; with its sign for a number.
    places
        ``(draw,)``: those of the replicates, NaN where there is none.
    hellinger, hellinger_among
        For a histogram: the distance from the recording to the mean of the replicates, and the
        median over replicates of that to the mean of the others. Else NaN.
    """

    p_value: float
    place: float
    places: Array
    hellinger: float = float("nan")
    hellinger_among: float = float("nan")


def judge(kind: str, observed: npt.ArrayLike, replicated: npt.ArrayLike) -> Judged:
    """Compare the recording with its replicates.

    Parameters
    ----------
    kind
        ``"number"``, ``"curve"`` or ``"histogram"``.
    observed
        Its value: ``()`` or any shape.
    replicated
        ``(draw, ...)``; NaN where a replicate has none.
    """
    draws = len(np.asarray(replicated))
    every = np.concatenate([np.asarray(observed)[None], np.asarray(replicated)])
    flat = every.reshape(draws + 1, -1).astype(np.float64)
    # Compared is what the recording has; replicates that lack any of it are left out.
    flat = flat[:, np.isfinite(flat[0])]
    nowhere = Judged(float("nan"), float("nan"), np.full(draws, np.nan))
    if not flat.shape[1] or (kind == "histogram" and flat[0].sum() <= 0):
        return nowhere
    known = np.isfinite(flat).all(-1)
    if kind == "histogram":
        known &= flat.sum(-1) > 0
    values = flat[known]
    among, own = float("nan"), float("nan")
    if kind == "number":
        far, near = _tails(values[:, 0])
        p_value = min(1.0, 2.0 * min(far, near) / (draws + 1))
        inside = _standardised(values)[:, 0]
    elif kind == "curve":
        p_value = _extreme_rank_length(values) / (draws + 1)
        inside = _outward(np.abs(_standardised(values)).max(-1))
    else:
        distance = _to_the_others(values)
        p_value = int((distance >= distance[0]).sum()) / (draws + 1)
        inside = _outward(distance)
        own = float(distance[0])
        among = float(np.median(distance[1:])) if len(distance) > 1 else float("nan")
    places = np.full(draws + 1, np.nan)
    places[known] = inside
    return Judged(p_value, float(places[0]), places[1:], own, among)


def adjusted_p_values(judged: list[Judged]) -> Array:
    """Return p-values that allow for the number of statistics, none below the unadjusted.

    Parameters
    ----------
    judged
        Those of one check, with the same replicates.

    Returns
    -------
    ``(statistic,)``, NaN where there is no p-value.
    """
    asked = [one for one in judged if np.isfinite(one.p_value)]
    if not asked:
        return np.full(len(judged), np.nan)
    every = np.stack([np.abs(one.places) for one in asked], -1)
    # A diverged replicate has no distance and never counts.
    largest = np.where(np.isnan(every), -np.inf, every).max(-1)
    adjusted = np.full(len(judged), np.nan)
    for index, one in enumerate(judged):
        if np.isfinite(one.p_value):
            as_far = 1 + int((largest >= abs(one.place)).sum())
            adjusted[index] = max(one.p_value, as_far / (len(largest) + 1))
    return adjusted


def _tails(values: Array) -> tuple[int, int]:
    """Return how many, the first included, are at least and at most as large as the first."""
    return int((values >= values[0]).sum()), int((values <= values[0]).sum())


def _standardised(values: Array) -> Array:
    """Return values ``(swarm, ...)`` about their median, in units of their tails."""
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95], axis=0)
    apart = values - middle
    width = np.where(apart > 0, high - middle, middle - low) / NORMAL
    out = np.where(apart == 0, 0.0, np.copysign(FARTHEST, apart))
    np.divide(apart, width, out=out, where=(width > 0) & (apart != 0))
    return out


def _outward(distances: Array) -> Array:
    """Return standardised distances; of these only the large ones are far."""
    return np.maximum(_standardised(distances[:, None])[:, 0], 0.0)


def _extreme_rank_length(values: Array) -> int:
    """Return how many curves, the first included, are at least as extreme as the first."""
    up = stats.rankdata(values, axis=0)
    outer = np.sort(np.minimum(up, len(values) + 1 - up), axis=1)
    # Lexicographic: by the first rank in which two differ.
    differs = outer != outer[0]
    first = differs.argmax(1)
    at = np.arange(len(outer))
    as_extreme = ~differs.any(1) | (outer[at, first] < outer[0, first])
    return int(as_extreme.sum())


def _to_the_others(values: Array) -> Array:
    """Return the Hellinger distance of each histogram to the mean of all others."""
    shares = values / values.sum(-1, keepdims=True)
    if len(shares) < 2:
        return np.zeros(1)
    others = (shares.sum(0) - shares) / (len(shares) - 1)
    # A sum less one of its parts may be just below zero.
    return hellinger_distance(shares, np.maximum(others, 0.0))
