"""Proper scores against closed forms, and against an independent library."""

import math

import numpy as np
import pytest
import scipy.special
import scipy.stats
import scipy.stats.qmc
import scoringrules

from swarmssm.metrics import (
    ensemble_crps,
    ensemble_energy_score,
    ensemble_intervals,
    gaussian_crps,
    gaussian_energy_score,
    gaussian_intervals,
)


def expected_length(distance, sd, space):
    """E of the length of an isotropic normal vector: a generalised Rice distribution's mean."""
    root = math.sqrt(2.0) * math.gamma(0.5 * (space + 1)) / math.gamma(0.5 * space)
    return sd * root * scipy.special.hyp1f1(-0.5, 0.5 * space, -0.5 * (distance / sd) ** 2)


def isotropic_energy_score(distance, sd, space):
    return expected_length(distance, sd, space) - 0.5 * expected_length(
        0.0, math.sqrt(2.0) * sd, space
    )


def standard_crps(z):
    """Gneiting et al. (2005), equation (5), of a standard normal."""
    density = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    below = 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))
    return z * (2.0 * below - 1.0) + 2.0 * density - 1.0 / math.sqrt(math.pi)


@pytest.mark.parametrize("z", [-2.0, 0.0, 0.3, 5.0])
def test_the_crps_of_a_normal_is_its_closed_form(z):
    found = gaussian_crps(np.array(7.0 + 0.5 * z), np.array(7.0), np.array(0.5))
    assert found == pytest.approx(0.5 * standard_crps(z), abs=1e-12)


def test_a_normal_without_spread_is_a_point():
    found = gaussian_crps(np.array([1.0, np.nan]), np.array([3.0, 3.0]), np.array([0.0, 1.0]))
    assert found[0] == 2.0
    assert np.isnan(found[1])


@pytest.mark.parametrize("space", [1, 2, 3])
@pytest.mark.parametrize("distance", [0.0, 0.3, 1.0, 20.0])
@pytest.mark.parametrize("sd", [0.01, 1.0, 30.0])
def test_the_energy_score_of_a_normal_is_its_closed_form(space, distance, sd):
    truth = np.full((1, space), distance / math.sqrt(space))
    found = gaussian_energy_score(truth, np.zeros((1, space)), sd**2 * np.eye(space))
    assert found == pytest.approx(isotropic_energy_score(distance, sd, space), rel=1e-7)


def test_the_energy_score_of_a_correlated_normal_does_not_depend_on_the_axes():
    covariance = np.array([[2.0, 0.9], [0.9, 0.5]])
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    truth, mean = np.array([[0.4, -0.2]]), np.array([[0.1, 0.3]])
    plain = gaussian_energy_score(truth, mean, covariance)
    turned = gaussian_energy_score(truth @ turn.T, mean @ turn.T, turn @ covariance @ turn.T)
    assert turned == pytest.approx(plain, rel=1e-9)


def test_fair_scores_of_few_draws_have_the_closed_forms_as_their_expectation():
    """Of twelve draws the usual estimators would be off by 0.05 and 0.07."""
    generator = np.random.default_rng(0)
    draws = generator.normal(size=(12, 200_000, 2))
    truth = np.broadcast_to([0.6, -0.3], draws.shape[1:])
    crps = ensemble_crps(truth, draws)
    error = 4.0 * crps.std(0) / math.sqrt(len(crps))
    assert (error < 5e-3).all()
    assert abs(crps[:, 0].mean() - standard_crps(0.6)) < error[0]
    assert abs(crps[:, 1].mean() - standard_crps(0.3)) < error[1]
    energy = ensemble_energy_score(truth[:50_000], draws[:, :50_000])
    closed = isotropic_energy_score(math.hypot(0.6, 0.3), 1.0, 2)
    assert abs(energy.mean() - closed) < 4.0 * energy.std() / math.sqrt(len(energy))


def test_scores_of_many_draws_agree_with_the_closed_forms_to_a_thousandth():
    """Evenly spread points in place of draws: no chance in it."""
    points = scipy.stats.norm.ppf((np.arange(4000) + 0.5) / 4000)
    for z in (0.0, 0.7, 2.0):
        found = ensemble_crps(np.array([z]), points[:, None])
        assert found[0] == pytest.approx(standard_crps(z), abs=1e-3)
    even = scipy.stats.qmc.Sobol(2, scramble=False).random(4096) + 0.5 / 4096
    even = scipy.stats.norm.ppf(even)
    for distance in (0.0, 0.5, 2.0):
        found = ensemble_energy_score(np.array([[distance, 0.0]]), even[:, None])
        assert found[0] == pytest.approx(isotropic_energy_score(distance, 1.0, 2), abs=1e-3)


def test_an_independent_library_agrees():
    generator = np.random.default_rng(2)
    truth, draws = generator.normal(size=(6, 3)), generator.normal(size=(20, 6, 3))
    members = np.moveaxis(draws, 0, 1)
    other = scoringrules.es_ensemble(truth, members, estimator="fair", backend="numpy")
    np.testing.assert_allclose(ensemble_energy_score(truth, draws), other, rtol=1e-12)
    other = scoringrules.crps_ensemble(
        truth, np.moveaxis(draws, 0, -1), estimator="fair", backend="numpy"
    )
    np.testing.assert_allclose(ensemble_crps(truth, draws), other, rtol=1e-9)


def test_the_crps_of_two_draws_by_hand():
    """|1 - 0| and |4 - 0| have the mean 2.5, their distance is 3: 2.5 - 3 / 2 = 1."""
    assert ensemble_crps(np.array([0.0]), np.array([[1.0], [4.0]]))[0] == pytest.approx(1.0)
    score = ensemble_energy_score(np.zeros((1, 2)), np.array([[[3.0, 4.0]], [[0.0, 0.0]]]))
    assert score[0] == pytest.approx(2.5 - 2.5)


def test_places_far_from_the_origin_lose_no_digits():
    draws = np.array([[0.1], [0.4], [0.2]])
    near = ensemble_crps(np.array([0.0]), draws)
    far = ensemble_crps(np.array([1e6]), draws + 1e6)
    assert far == pytest.approx(near, abs=1e-9)


@pytest.mark.parametrize("score", [ensemble_crps, ensemble_energy_score])
def test_what_broke_down_is_infinitely_bad_and_what_is_unknown_does_not_count(score):
    draws = np.ones((5, 4, 2))
    draws[2, 1, 0] = np.inf
    draws[:, 2] = np.nan
    draws[:3, 3], draws[3:, 3] = 1e300, -1e300
    truth = np.zeros((4, 2))
    truth[0] = np.nan
    found = score(truth, draws)
    found = found if found.ndim == 1 else found[:, 0]
    assert np.isnan(found[0])
    assert found[1] == np.inf
    assert np.isnan(found[2])
    assert found[3] == np.inf or found[3] > 1e299
    with pytest.raises(ValueError, match="at least two draws"):
        score(truth, draws[:1])


def test_intervals_of_draws_hold_another_draw_as_often_as_they_say():
    """With ranks of n + 1: of 19 draws the 90 % interval is from the least to the greatest."""
    draws = np.arange(1.0, 20.0)[:, None]
    lower, upper = ensemble_intervals(draws, [0.9, 0.5])
    np.testing.assert_allclose(lower[:, 0], [1.0, 5.0])
    np.testing.assert_allclose(upper[:, 0], [19.0, 15.0])
    broken = draws.repeat(3, 1)
    broken[4, 1], broken[:, 2] = np.inf, np.nan
    lower, upper = ensemble_intervals(broken, [0.5])
    assert (lower[0, 1], upper[0, 1]) == (-np.inf, np.inf)
    assert np.isnan([lower[0, 2], upper[0, 2]]).all()


def test_intervals_of_a_normal():
    lower, upper = gaussian_intervals(np.array([2.0]), np.array([3.0]), [0.5, 0.9])
    half = 3.0 * np.array([0.6744898, 1.6448536])
    np.testing.assert_allclose(upper[:, 0], 2.0 + half, atol=1e-6)
    np.testing.assert_allclose(lower[:, 0], 2.0 - half, atol=1e-6)
