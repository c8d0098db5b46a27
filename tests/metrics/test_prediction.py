"""Errors of predicted states against numbers worked by hand."""

import warnings

import numpy as np
import pytest

from swarmssm import metrics
from swarmssm.errors import InputError

NAN = np.nan


@pytest.fixture
def two_walkers():
    """Two individuals, three times, [x, y, vx, vy].

    The steps of the first are (3, 4, 0, 0) and nothing, of length 5 and 0; those of the second
    (0, 0, 6, 8) and (0, 1, 0, 0), of length 10 and 1.
    """
    first = [[0, 0, 0, 0], [3, 4, 0, 0], [3, 4, 0, 0]]
    second = [[1, 1, 0, 0], [1, 1, 6, 8], [1, 2, 6, 8]]
    return np.stack([first, second], axis=1).astype(float)


def test_step_length_is_half_the_mean_step(two_walkers):
    # 1 / (2 N T) (5 + 0 + 10 + 1) with N = 2 and T = 2 steps
    assert metrics.step_length(two_walkers) == 2.0


def test_step_length_leaves_out_steps_from_and_to_the_unknown(two_walkers):
    two_walkers[2, 1, 3] = NAN  # one component unknown: the whole state is
    assert metrics.step_length(two_walkers) == (5 + 0 + 10) / (2 * 3)


def test_step_length_pools_trials_of_differing_length(two_walkers):
    short = two_walkers.copy()
    short[2] = NAN
    both = np.stack([two_walkers, short])
    assert metrics.step_length(both) == (5 + 0 + 10 + 1 + 5 + 10) / (2 * 6)


def test_mse_and_mae_by_hand(two_walkers):
    predicted = two_walkers.copy()
    predicted[0, 0] += [0, 3, 4, 0]  # error 5
    predicted[1, 1] += [1, 0, 0, 0]  # error 1
    # 1 / (2 L) times the mean over 6 states, L = 2
    assert metrics.mse(two_walkers, predicted) == pytest.approx((25 + 1) / 6 / 4)
    assert metrics.mae(two_walkers, predicted) == pytest.approx((5 + 1) / 6 / 4)
    assert metrics.mse(two_walkers, predicted, length=13.0) == pytest.approx(1 / 6)
    assert metrics.mae(two_walkers, predicted, length=3.0) == pytest.approx(1 / 6)


def test_errors_count_only_what_is_known_in_both(two_walkers):
    predicted = two_walkers + np.array([0, 3, 4, 0])
    predicted[0] = NAN
    predicted[1, 0, 2] = NAN
    truth = two_walkers.copy()
    truth[2, 0] = NAN
    # Two states are left, with error 5 each, however many are not.
    assert metrics.mae(truth, predicted, length=0.5) == 5.0
    assert metrics.mse(truth, predicted, length=0.5) == 25.0


def test_the_default_length_is_that_of_all_states(two_walkers):
    predicted = two_walkers.copy()
    predicted[:2] = NAN
    predicted[2] += [0, 0, 0, 4]
    assert metrics.mae(two_walkers, predicted) == 4 / (2 * 2.0)


def test_staying_put_has_mae_of_one():
    rng = np.random.default_rng(1)
    states = rng.normal(size=(3, 50, 6, 4)).cumsum(axis=1)
    states[rng.random(states.shape[:-1]) < 0.2] = NAN
    stay = np.full_like(states, NAN)
    stay[:, 1:] = states[:, :-1]
    assert metrics.mae(states, stay) == pytest.approx(1.0, rel=1e-14)
    assert metrics.mae(1000 * states, 1000 * stay) == pytest.approx(1.0, rel=1e-14)
    # (4.2) is not free of the unit: it grows with it.
    ratio = metrics.mse(1000 * states, 1000 * stay) / metrics.mse(states, stay)
    assert ratio == pytest.approx(1000, rel=1e-12)


def test_a_perfect_prediction_has_no_error(two_walkers):
    assert metrics.mse(two_walkers, two_walkers) == 0.0
    assert metrics.mae(two_walkers, two_walkers) == 0.0


def test_an_infinite_prediction_is_an_infinite_error(two_walkers):
    predicted = two_walkers.copy()
    predicted[1, 1, 0] = np.inf
    assert metrics.mse(two_walkers, predicted) == np.inf
    predicted[1, 1, 0] = 1e200  # its square does not fit into a float
    assert metrics.mse(two_walkers, predicted) == np.inf


def test_errors_of_nothing_are_nan(two_walkers):
    nothing = np.full_like(two_walkers, NAN)
    assert np.isnan(metrics.step_length(nothing))
    assert np.isnan(metrics.step_length(two_walkers[:1]))
    assert np.isnan(metrics.mse(two_walkers, nothing))
    assert np.isnan(metrics.mae(nothing, two_walkers))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda x: metrics.step_length(x[0]), r"states: its shape is \(2, 4\)"),
        (lambda x: metrics.step_length(x / 0.0), r"states: the entry at \(\d, \d, \d\) is inf"),
        (lambda x: metrics.step_length("abc"), "states: it must be an array of numbers"),
        (lambda x: metrics.mse(x, x[:, :1]), r"predicted: its shape \(3, 1, 4\) differs"),
        (lambda x: metrics.mae(x, x, length=0.0), "length: it must be a positive number, not 0.0"),
        (lambda x: metrics.mae(x, x, length=NAN), "length: it must be a positive number, not nan"),
        (lambda x: metrics.mse(x[[0, 0]], x[[0, 0]]), r"states: nothing moves, so that L of \(4"),
    ],
)
@pytest.mark.filterwarnings("ignore:(divide by zero|invalid value):RuntimeWarning")
def test_what_prediction_errors_refuse(two_walkers, call, words):
    with pytest.raises(InputError, match=words):
        call(two_walkers)


def test_horizon_errors_by_hand():
    # Two forecasts of three steps of one individual with two components; L = 1/2.
    truth = np.zeros((2, 3, 1, 2))
    forecasts = np.zeros((2, 3, 1, 2))
    forecasts[0, :, 0] = [[3, 4], [6, 8], [0, 2]]
    forecasts[1, :, 0] = [[0, 1], [NAN, 0], [0, 4]]
    truth[1, 1] = 0.0
    truth[0, 2] = NAN
    scores = metrics.horizon_errors(truth, forecasts, [1, 2, 3], length=0.5)
    np.testing.assert_array_equal(scores.horizons, [1, 2, 3])
    np.testing.assert_allclose(scores.squared_error, [(25 + 1) / 4, 100 / 2, 16 / 2])
    np.testing.assert_allclose(scores.mse, [(25 + 1) / 2, 100, 16])
    np.testing.assert_allclose(scores.mae, [(5 + 1) / 2, 10, 4])
    np.testing.assert_array_equal(scores.num_scored, [2, 1, 1])
    np.testing.assert_allclose(scores.coverage, [1, 1 / 2, 1])


def test_horizon_errors_agree_with_one_step_scores():
    rng = np.random.default_rng(2)
    truth = rng.normal(size=(4, 7, 3, 4))
    forecasts = rng.normal(size=truth.shape)
    truth[rng.random(truth.shape[:-1]) < 0.1] = NAN
    scores = metrics.horizon_errors(truth, forecasts, [2, 5])
    length = metrics.step_length(truth)
    for index, step in enumerate((2, 5)):
        at = np.s_[:, step - 1 : step]
        assert scores.mse[index] == pytest.approx(metrics.mse(truth[at], forecasts[at], length))
        assert scores.mae[index] == pytest.approx(metrics.mae(truth[at], forecasts[at], length))


def test_horizon_errors_of_nothing_are_nan():
    truth = np.arange(4.0).reshape(2, 1, 2)
    scores = metrics.horizon_errors(truth, np.full_like(truth, NAN), [1, 2])
    for errors in (scores.squared_error, scores.mse, scores.mae):
        assert np.isnan(errors).all()
    assert scores.num_scored.tolist() == [0, 0]
    assert scores.coverage.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("horizons", [[], [0, 1], [4], [2, 1], [1, 1], [1.5], 2, [[1]]])
def test_horizons_that_are_refused(horizons):
    truth = np.arange(6.0).reshape(3, 1, 2)
    with pytest.raises(InputError, match="horizons: "):
        metrics.horizon_errors(truth, truth, horizons)


def test_a_single_step_needs_a_length():
    truth = np.zeros((1, 1, 2))
    with pytest.raises(InputError, match="length: it cannot be computed from a single step"):
        metrics.horizon_errors(truth, truth, [1])
    assert metrics.horizon_errors(truth, truth, [1], length=1.0).mse == [0.0]


def test_no_score_warns_when_nothing_is_known():
    nothing = np.full((2, 3, 2), NAN)
    pairs = np.full((2, 3, 3), NAN)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        results = [
            metrics.amd(nothing),
            metrics.avd(nothing),
            metrics.polarization(nothing),
            metrics.rotation(nothing, nothing),
            metrics.speeds(nothing),
            metrics.nearest_neighbor_distance(nothing),
            metrics.edge_accuracy(pairs, pairs),
            metrics.edge_precision(pairs, pairs),
            metrics.edge_recall(pairs, pairs),
            metrics.edge_auc(pairs, pairs),
            metrics.mse(nothing, nothing),
        ]
    assert all(np.isnan(result).all() for result in results)
