"""Ranks of individuals, and how sure they are."""

import numpy as np
from scipy.stats import rankdata

from swarmssm.tracks import Array

__all__ = ["rank_probabilities"]


def rank_probabilities(scores: Array) -> Array:
    """Return in which share of the draws an individual has each rank.

    Parameters
    ----------
    scores
        ``(draw, individual)``. Those equal share the ranks that they take together, in equal parts;
        one whose score is NaN comes last.

    Returns
    -------
    ``(individual, rank)``, the highest score first. Rows and columns add up to 1.
    """
    filled = np.where(np.isnan(scores), -np.inf, scores)
    first = rankdata(-filled, method="min", axis=1).astype(int)
    last = rankdata(-filled, method="max", axis=1).astype(int)
    ranks = np.arange(1, filled.shape[1] + 1)
    taken = (first[..., None] <= ranks) & (ranks <= last[..., None])
    shares: Array = (taken / (last - first + 1)[..., None]).mean(0)
    return shares
