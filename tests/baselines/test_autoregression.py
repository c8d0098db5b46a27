"""Linear prediction, on motions that are linear."""

import numpy as np
import pytest

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.autoregression import AR1, AR5
from swarmssm.baselines.regression import compress, ridge_maps
from swarmssm.errors import InputError

FPS = 10.0


def spirals(num_trials=3, num_times=40, num_individuals=4, offset=0.0):
    """States that are turned by 0.3 and shrink by 1 % in each frame, about an offset."""
    random = np.random.default_rng(0)
    turn = 0.99 * np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    matrix = np.kron(np.eye(2), turn)
    states = [random.standard_normal((num_trials, num_individuals, 4))]
    for _ in range(num_times - 1):
        states.append(states[-1] @ matrix.T)
    return np.stack(states, axis=1) + offset, matrix


@pytest.mark.parametrize("kind", [AR1, AR5])
def test_a_linear_motion_is_learned_exactly(kind):
    states, _ = spirals(offset=2.0)
    baseline = kind()
    baseline.fit_states(states, FPS, Training())
    path = baseline.predict(states[:, :20], 20, FPS)
    np.testing.assert_allclose(path, states[:, 20:], rtol=0, atol=1e-6)


def test_the_matrix_of_order_one_is_that_of_the_motion():
    states, matrix = spirals()
    baseline = AR1()
    baseline.fit_states(states, FPS, Training())
    np.testing.assert_allclose(baseline.change.weights, matrix - np.eye(4), rtol=0, atol=1e-8)
    np.testing.assert_allclose(baseline.change.intercept, 0.0, rtol=0, atol=1e-8)


def test_five_frames_make_84_numbers_and_one_makes_20():
    states, _ = spirals()
    for kind, number in ((AR5, 84), (AR1, 20)):
        baseline = kind()
        baseline.fit_states(states, FPS, Training())
        assert baseline.num_parameters == number


def test_the_penalty_is_that_which_validation_prefers():
    random = np.random.default_rng(1)
    few, many = random.standard_normal((1, 31, 1, 4)), random.standard_normal((1, 400, 3, 4))
    baseline = AR5()
    baseline.fit_states(few, FPS, Training(many))
    # 26 rows for 21 numbers of each coordinate: plain least squares fits their noise.
    rows = np.stack([few[0, time : time + 5, 0].ravel() for time in range(26)])
    plain = np.linalg.lstsq(np.c_[rows, np.ones(26)], few[0, 5:, 0], rcond=None)[0]
    held = np.stack([many[0, time : time + 5].swapaxes(0, 1).reshape(3, -1) for time in range(395)])
    unpenalised = held @ plain[:-1] + plain[-1] - many[0, 5:]
    ahead = (baseline.one_step(many, FPS) - many)[0, 5:]
    assert (ahead**2).mean() < 0.5 * (unpenalised**2).mean()


def test_tracks_shorter_than_the_order_are_learned_from_with_filled_frames():
    states, _ = spirals(num_times=4)
    baseline = AR5()
    baseline.fit_states(states, FPS, Training())
    assert np.isfinite(baseline.predict(states, 2, FPS)).all()


def test_it_cannot_run_before_it_is_fitted():
    with pytest.raises(InputError, match="fit it first"):
        AR5().predict(spirals()[0], 1, FPS)


def test_a_triangle_stands_for_all_rows():
    random = np.random.default_rng(2)
    rows = random.standard_normal((500, 4)) + 3.0
    triangle = compress([rows[:100], rows[100:101], rows[101:]])
    assert triangle.shape == (4, 4)
    np.testing.assert_allclose(triangle.T @ triangle, rows.T @ rows)


def test_ridge_is_the_textbooks():
    random = np.random.default_rng(3)
    features = random.standard_normal((50, 3)) * [1.0, 10.0, 0.1] + 5.0
    targets = features @ random.standard_normal((3, 2)) + random.standard_normal((50, 2))
    found = ridge_maps(features, targets, [0.5])[0]
    scaled = (features - features.mean(0)) / features.std(0)
    centred = targets - targets.mean(0)
    weights = np.linalg.solve(scaled.T @ scaled + 0.5 * 50 * np.eye(3), scaled.T @ centred)
    expected = scaled @ weights + targets.mean(0)
    np.testing.assert_allclose(found(features), expected, rtol=1e-9)
