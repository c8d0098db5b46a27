"""Scores of a predicted graph by hand and against scikit-learn."""

import numpy as np
import pytest
import sklearn.metrics

from swarmssm import metrics
from swarmssm.errors import InputError

NAN = np.nan


def test_edge_scores_by_hand():
    truth = np.array([[[0, 1, 0], [1, 0, 0], [0, 1, 0]]])
    predicted = np.array([[[1, 0.9, 0.2], [0.4, 1, 0.8], [0.1, 0.5, 1]]])
    # Off the diagonal: true edges scored .9, .4, .5 and none-edges .2, .8, .1; at least 0.5 is
    # claimed for .9, .5 and .8.
    assert metrics.edge_accuracy(truth, predicted) == [4 / 6]
    assert metrics.edge_precision(truth, predicted) == [2 / 3]
    assert metrics.edge_recall(truth, predicted) == [2 / 3]
    # Pairs of (edge, no edge) in the right order: .9 beats three, .4 and .5 beat two each.
    assert metrics.edge_auc(truth, predicted) == [7 / 9]
    assert metrics.edge_recall(truth, predicted, threshold=0.4) == [1]
    present = np.array([[True, False, True]])
    assert metrics.edge_accuracy(truth, predicted, present) == [1]
    assert np.isnan(metrics.edge_recall(truth, predicted, present)).all()


def test_edge_scores_agree_with_scikit_learn():
    rng = np.random.default_rng(6)
    truth = (rng.random((2, 20, 6, 6)) < 0.3).astype(float)
    scores = np.round(rng.random(truth.shape) + 0.2 * truth, 1)  # many ties
    present = rng.random((2, 20, 6)) < 0.9
    truth[rng.random(truth.shape) < 0.05] = NAN
    scores[rng.random(truth.shape) < 0.05] = NAN
    own = {
        "accuracy": metrics.edge_accuracy(truth, scores, present, threshold=0.6),
        "precision": metrics.edge_precision(truth, scores, present, threshold=0.6),
        "recall": metrics.edge_recall(truth, scores, present, threshold=0.6),
        "auc": metrics.edge_auc(truth, scores, present),
    }
    assert all(score.shape == (2, 20) for score in own.values())
    for step in np.ndindex(2, 20):
        counted = present[step][:, None] & present[step][None, :] & ~np.eye(6, dtype=bool)
        counted &= ~np.isnan(truth[step]) & ~np.isnan(scores[step])
        edge, score = truth[step][counted], scores[step][counted]
        claimed = score >= 0.6
        judge = {
            "accuracy": sklearn.metrics.accuracy_score(edge, claimed),
            "precision": sklearn.metrics.precision_score(edge, claimed, zero_division=NAN),
            "recall": sklearn.metrics.recall_score(edge, claimed, zero_division=NAN),
            "auc": sklearn.metrics.roc_auc_score(edge, score) if 0 < edge.mean() < 1 else NAN,
        }
        for name, value in judge.items():
            assert own[name][step] == pytest.approx(value, nan_ok=True), (name, step)


def test_edge_scores_without_a_denominator_are_nan():
    empty, full = np.zeros((1, 3, 3)), np.ones((1, 3, 3))
    assert np.isnan(metrics.edge_precision(full, empty)).all()
    assert np.isnan(metrics.edge_recall(empty, full)).all()
    assert np.isnan(metrics.edge_auc(full, full)).all()
    assert np.isnan(metrics.edge_auc(empty, full)).all()
    assert np.isnan(metrics.edge_accuracy(empty[:, :1, :1], empty[:, :1, :1])).all()
    assert metrics.edge_accuracy(full, full, np.zeros((1, 3), bool)) == pytest.approx(
        NAN, nan_ok=True
    )


def test_auc_takes_any_scale_of_scores():
    rng = np.random.default_rng(7)
    truth = rng.random((1, 8, 8)) < 0.4
    probability = rng.random(truth.shape)
    probability[0, 0, 1], probability[0, 1, 0] = 0.0, 1.0  # logits of minus and plus infinity
    with np.errstate(divide="ignore"):
        logits = np.log(probability) - np.log1p(-probability)
    np.testing.assert_array_equal(
        metrics.edge_auc(truth, logits), metrics.edge_auc(truth, probability)
    )
    np.testing.assert_allclose(
        metrics.edge_auc(truth, -probability), 1 - metrics.edge_auc(truth, probability)
    )
    np.testing.assert_array_equal(metrics.edge_auc(truth, np.ones(truth.shape)), [0.5])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.zeros((1, 3, 2)), np.zeros((1, 3, 2))), "must be of one length"),
        ((np.zeros((1, 3, 3)), np.zeros((2, 3, 3))), r"predicted: its shape \(2, 3, 3\) differs"),
        (
            (np.full((1, 2, 2), 2), np.zeros((1, 2, 2))),
            r"truth: the entry at \(0, 0, 0\) is 2; eac",
        ),
        (
            (np.zeros((1, 2, 2)), np.zeros((1, 2, 2)), np.ones((1, 2))),
            "present: it must be an arra",
        ),
        ((np.zeros((1, 2, 2)), np.zeros((1, 2, 2)), np.ones((2,), bool)), "present: it must be an"),
        ((np.zeros((2, 2)), np.zeros((2, 2))), r"truth: its shape is \(2, 2\)"),
    ],
)
def test_what_edge_scores_refuse(arguments, words):
    with pytest.raises(InputError, match=words):
        metrics.edge_accuracy(*arguments)
