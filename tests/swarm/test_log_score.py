"""The log score of a Gaussian forecast, against scipy and against numbers worked by hand."""

import math

import numpy as np
import pytest
import scipy.stats

from swarmssm.metrics import gaussian_log_score, moments_of_draws


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
