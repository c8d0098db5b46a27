"""Scores of a predicted interaction graph, step by step.

``A[..., t, i, j]`` = 1 when i sees j. Only ordered pairs of two different individuals that are both
present count; the diagonal never does. A score with nothing to divide by is NaN, and says so: no
warning, and no 0 or 1 by convention.
"""

import numpy as np
import numpy.typing as npt
import scipy

from swarmssm.errors import InputError
from swarmssm.metrics.masked import Array, Mask, as_array, check_same_shape, ratio

__all__ = ["edge_accuracy", "edge_auc", "edge_precision", "edge_recall"]

AXES = "time, individual, neighbor"


def edge_accuracy(
    truth: npt.ArrayLike,
    predicted: npt.ArrayLike,
    present: npt.ArrayLike | None = None,
    *,
    threshold: float = 0.5,
) -> Array:
    """Return the share of pairs, with and without an edge, that were predicted rightly.

    With few edges it is near 1 for an empty graph: look at :func:`edge_auc` too.

    Parameters
    ----------
    truth
        Shape ``(..., time, individual, neighbor)`` of 0 and 1, NaN where unknown.
    predicted
        Same shape: 0 and 1, probabilities or any other score, NaN where there is none.
    present
        Shape ``(..., time, individual)`` of bool: who is there; default everyone.
    threshold
        A pair scored at least this is predicted to have an edge.

    Returns
    -------
    Shape ``(..., time)``; NaN where there is no pair.

    Raises
    ------
    InputError
        If a shape does not fit, or ``truth`` holds anything but 0, 1 and NaN.
    """
    edge, claimed, valid = _decide(truth, predicted, present, threshold)
    return ratio((valid & (edge == claimed)).sum(axis=-1), valid.sum(axis=-1))


def edge_precision(
    truth: npt.ArrayLike,
    predicted: npt.ArrayLike,
    present: npt.ArrayLike | None = None,
    *,
    threshold: float = 0.5,
) -> Array:
    """Return the share of predicted edges that are true ones.

    Parameters
    ----------
    truth, predicted, present, threshold
        As for :func:`edge_accuracy`.

    Returns
    -------
    Shape ``(..., time)``; NaN where no edge was predicted.

    Raises
    ------
    InputError
        As :func:`edge_accuracy`.
    """
    edge, claimed, valid = _decide(truth, predicted, present, threshold)
    return ratio((valid & edge & claimed).sum(axis=-1), (valid & claimed).sum(axis=-1))


def edge_recall(
    truth: npt.ArrayLike,
    predicted: npt.ArrayLike,
    present: npt.ArrayLike | None = None,
    *,
    threshold: float = 0.5,
) -> Array:
    """Return the share of true edges that were predicted.

    Parameters
    ----------
    truth, predicted, present, threshold
        As for :func:`edge_accuracy`.

    Returns
    -------
    Shape ``(..., time)``; NaN where there is no true edge.

    Raises
    ------
    InputError
        As :func:`edge_accuracy`.
    """
    edge, claimed, valid = _decide(truth, predicted, present, threshold)
    return ratio((valid & edge & claimed).sum(axis=-1), (valid & edge).sum(axis=-1))


def edge_auc(
    truth: npt.ArrayLike, scores: npt.ArrayLike, present: npt.ArrayLike | None = None
) -> Array:
    """Return the area under the receiver operating characteristic.

    It is the chance that a pair with an edge is scored above one without, a tie counting one half
    (the statistic of Mann and Whitney): 1/2 for scores that know nothing, whatever their scale.

    Parameters
    ----------
    truth
        Shape ``(..., time, individual, neighbor)`` of 0 and 1, NaN where unknown.
    scores
        Same shape, larger where an edge is more likely: probabilities, logits, or minus the
        distance. NaN where there is none.
    present
        Shape ``(..., time, individual)`` of bool: who is there; default everyone.

    Returns
    -------
    Shape ``(..., time)``; NaN where all pairs, or none, have an edge.

    Raises
    ------
    InputError
        As :func:`edge_accuracy`.
    """
    edge, score, valid = _pairs(truth, scores, present, "scores")
    ranks = scipy.stats.rankdata(np.where(valid, score, np.nan), axis=-1, nan_policy="omit")
    positive = (valid & edge).sum(axis=-1)
    negative = valid.sum(axis=-1) - positive
    rank_sum = np.where(valid & edge, ranks, 0.0).sum(axis=-1)
    return ratio(rank_sum - positive * (positive + 1) / 2, positive * negative)


def _decide(
    truth: npt.ArrayLike, predicted: npt.ArrayLike, present: npt.ArrayLike | None, threshold: float
) -> tuple[Mask, Mask, Mask]:
    """Return for each pair: has it an edge, is one claimed, does it count."""
    edge, score, valid = _pairs(truth, predicted, present, "predicted")
    return edge, score >= threshold, valid


def _pairs(
    truth: npt.ArrayLike, scores: npt.ArrayLike, present: npt.ArrayLike | None, name: str
) -> tuple[Mask, Array, Mask]:
    """Return edges, scores and what counts, each ``(..., time, pair)`` without the diagonal."""
    true = as_array(truth, "truth", AXES)
    score = as_array(scores, name, AXES, allow_inf=True)
    check_same_shape(true, score, "truth", name)
    num_individuals = true.shape[-1]
    if true.shape[-2] != num_individuals:
        raise InputError(
            f"truth: its shape is {true.shape}; the last two axes, individual and neighbor, must "
            "be of one length."
        )
    wrong = ~(np.isnan(true) | (true == 0) | (true == 1))
    if wrong.any():
        place = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise InputError(
            f"truth: the entry at {place} is {true[place]:g}; each must be 0, 1 or NaN."
        )
    valid = ~(np.isnan(true) | np.isnan(score))
    if present is not None:
        there = np.asarray(present)
        if there.shape != true.shape[:-1] or there.dtype != np.bool_:
            raise InputError(
                f"present: it must be an array of bool of shape {true.shape[:-1]}; it is "
                f"{there.dtype} of shape {there.shape}."
            )
        valid &= there[..., :, None] & there[..., None, :]
    row, column = np.nonzero(~np.eye(num_individuals, dtype=bool))
    return true[..., row, column] == 1, score[..., row, column], valid[..., row, column]
