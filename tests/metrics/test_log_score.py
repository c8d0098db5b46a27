"""The log score of a Gaussian forecast, against scipy and against numbers worked by hand."""

import math

import numpy as np
import pytest
import scipy.stats

from swarmssm.metrics import gaussian_log_score, mixture_log_score, moments_of_draws


def test_it_is_scipys_log_density_per_coordinate():
    generator = np.random.default_rng(0)
    truth, mean = generator.normal(size=(2, 5, 3, 2))
    factor = generator.normal(size=(5, 3, 2, 2))
    covariance = factor @ factor.swapaxes(-1, -2) + 0.1 * np.eye(2)
    found = gaussian_log_score(truth, mean, covariance)
    for place in np.ndindex(5, 3):
        normal = scipy.stats.multivariate_normal(mean[place], covariance[place])
        np.testing.assert_allclose(found[place], 0.5 * normal.logpdf(truth[place]), rtol=1e-12)


def test_a_number_by_hand():
    """An error of (1, 0) at sd 2 and 1: -(1/4 + log 4 + 2 log 2 pi) / 4."""
    found = gaussian_log_score(np.array([1.0, 0.0]), np.zeros(2), np.diag([4.0, 1.0]))
    expected = -(0.25 + math.log(4.0) + 2.0 * math.log(2.0 * math.pi)) / 4.0
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_what_is_unknown_and_what_is_certain():
    truth = np.array([[0.0, 0.0], [np.nan, 0.0], [0.0, 0.0], [0.0, 0.0]])
    mean = np.array([[0.0, 0.0], [0.0, 0.0], [np.nan, 0.0], [0.0, 0.0]])
    covariance = np.stack([np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))])
    found = gaussian_log_score(truth, mean, covariance)
    assert found[0] == pytest.approx(-0.5 * math.log(2.0 * math.pi))
    assert np.isnan(found[1:3]).all()
    assert found[3] == -np.inf  # a forecast that knows for certain has no density


def test_the_right_spread_scores_best():
    truth = np.random.default_rng(1).normal(scale=2.0, size=(4000, 2))
    scores = [
        gaussian_log_score(truth, np.zeros(2), scale**2 * np.eye(2)).mean()
        for scale in (1.5, 2.0, 2.7)
    ]
    assert scores[1] > max(scores[0], scores[2])


def test_moments_of_draws():
    draws = np.array([[1.0, 2.0], [3.0, 2.0], [2.0, 5.0]])
    mean, covariance = moments_of_draws(draws)
    np.testing.assert_allclose(mean, [2.0, 3.0])
    np.testing.assert_allclose(covariance, np.cov(draws, rowvar=False))
    with pytest.raises(ValueError, match="2 draws have no covariance in 2 coordinates"):
        moments_of_draws(draws[:2])


@pytest.mark.parametrize("degrees", [math.inf, 4.5])
def test_futures_that_agree_leave_the_density_of_the_last_step(degrees):
    generator = np.random.default_rng(2)
    truth, place = generator.normal(size=(2, 6, 2))
    location = np.broadcast_to(place, (7, 6, 2))
    variance = np.broadcast_to(generator.uniform(0.5, 2.0, size=(6, 1)), (6, 2))
    found = mixture_log_score(truth, location, np.broadcast_to(variance, (7, 6, 2)), degrees)
    for i in range(6):
        if math.isinf(degrees):
            law = scipy.stats.multivariate_normal(place[i], np.diag(variance[i]))
        else:
            shape = np.diag(variance[i]) * (degrees - 2) / degrees
            law = scipy.stats.multivariate_t(place[i], shape, df=degrees)
        np.testing.assert_allclose(found[i], 0.5 * law.logpdf(truth[i]), rtol=1e-10)


def test_many_futures_tend_to_their_density():
    """Places of variance 3 and a last step of variance 1 make a normal of variance 4."""
    generator = np.random.default_rng(3)
    truth = generator.normal(scale=2.0, size=(300, 2))
    location = generator.normal(scale=3**0.5, size=(4000, 1, 2)).repeat(300, 1)
    found = mixture_log_score(truth, location, np.ones_like(location))
    exact = gaussian_log_score(truth, np.zeros(2), 4.0 * np.eye(2))
    # The kernels widen 4 by 3 * 4000^(-1/3) = 0.19: a loss of about (0.19 / 4)^2 / 4 in the mean.
    assert abs(found.mean() - exact.mean()) < 0.01


def test_a_future_that_breaks_down_gives_no_probability():
    location = np.zeros((5, 3, 2))
    location[2, 1] = np.inf
    location[:, 2] = np.nan
    found = mixture_log_score(np.zeros((3, 2)), location, np.ones_like(location))
    assert np.isfinite(found[0])
    assert found[1] == -np.inf
    assert np.isnan(found[2])


def test_one_future_far_out_makes_a_bad_score_and_no_error():
    """Its distance squared is more than 1e16 times the variance of the step."""
    location = np.zeros((10, 1, 2))
    location[0, 0] = [3e10, 4e10]
    score = mixture_log_score(np.zeros((1, 2)), location, np.ones((10, 1, 2)))
    assert np.isfinite(score).all()
    assert score[0] < -10.0
