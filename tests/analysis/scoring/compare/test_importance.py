"""Weights against exact answers: conjugate normals, and the Kalman filter on a grid."""

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import norm

from swarmssm.analysis.posterior import window_log_likelihood
from swarmssm.analysis.scoring.importance import good_k, psis_lfo, psis_loo
from swarmssm.inference.filtering import collapsed_evidence
from swarmssm.models.pyro_modules import own_parameters

COUNT, DRAWS = 20, 4000


@pytest.fixture
def conjugate():
    """Numbers about an unknown mean with prior N(0, 1), noise 1; and draws of the posterior."""
    generator = np.random.default_rng(0)
    data = 0.7 + generator.normal(size=COUNT)
    return data, generator


def predictive(data, new):
    """Return log p(new | data)."""
    variance = 1.0 / (1.0 + len(data))
    return norm.logpdf(new, variance * data.sum(), np.sqrt(1.0 + variance))


def draws_of(data, generator):
    variance = 1.0 / (1.0 + len(data))
    return variance * data.sum() + np.sqrt(variance) * generator.normal(size=DRAWS)


def test_leave_one_out_of_a_conjugate_model(conjugate):
    data, generator = conjugate
    mean = draws_of(data, generator)
    found = psis_loo(norm.logpdf(data, mean[:, None]))
    exact = [predictive(np.delete(data, k), data[k]) for k in range(COUNT)]
    # Weights are nearly even here: the error of a mean of DRAWS densities whose spread is about
    # the posterior's sd times the distance to the datum, at most 3 / sqrt(21).
    np.testing.assert_allclose(found.elpd, exact, atol=6.0 * 0.65 / np.sqrt(DRAWS))
    assert found.learned.all()
    assert (found.in_sample > found.elpd).all()


def test_leave_future_out_of_a_conjugate_model(conjugate):
    data, generator = conjugate
    past, future = data[:10], data[10:]
    mean = draws_of(past, generator)
    found = psis_lfo(norm.logpdf(future, mean[:, None]))
    exact = [predictive(data[: 10 + k], future[k]) for k in range(10)]
    # As above; the weights of ten numbers leave at least a third of the draws.
    np.testing.assert_allclose(found.elpd, exact, atol=6.0 * 0.9 / np.sqrt(DRAWS / 3))
    assert np.isnan(found.pareto_k[0])
    assert found.learned.all()


def test_what_cannot_be_believed_is_not_learned():
    generator = np.random.default_rng(1)
    mean = generator.normal(size=DRAWS)
    # A thousand times as sharp as the draws: after the first window only a handful of them is left.
    sharp = norm.logpdf([0.3, 3.0, 3.1], mean[:, None], 1e-3)
    found = psis_lfo(sharp)
    assert found.learned.tolist() == [True, False, False]
    assert found.pareto_k[1] > good_k(DRAWS)
    # It goes on with the draws as they were.
    np.testing.assert_allclose(found.elpd, logsumexp(sharp, axis=0) - np.log(DRAWS))
    loo = psis_loo(norm.logpdf([0.3, 6.0], mean[:, None], [10.0, 0.05]))
    assert loo.learned.tolist() == [True, False]


def test_draws_that_are_all_the_same_need_no_weights():
    same = np.tile([-1.0, -2.0, -3.0], (200, 1))
    found = psis_lfo(same)
    np.testing.assert_allclose(found.elpd, [-1.0, -2.0, -3.0])
    assert found.learned.all()


def test_a_draw_without_any_density_is_no_reason_to_believe():
    values = np.full((200, 2), -1.0)
    values[0, 0] = -np.inf
    found = psis_loo(values)
    assert found.learned.tolist() == [False, True]
    assert found.pareto_k[0] == np.inf
    assert found.elpd[0] == pytest.approx(np.log(199 / 200) - 1.0)


@pytest.mark.parametrize(("draws", "limit"), [(100, 0.5), (10_000, 0.7), (400, 0.6157)])
def test_the_limit_depends_on_the_number_of_draws(draws, limit):
    assert good_k(draws) == pytest.approx(limit, abs=1e-4)


@pytest.mark.slow
def test_leave_one_out_of_a_swarm_is_that_of_the_kalman_filter(whole_fits, flocks):
    fit = whole_fits["aligned"]
    draws = 1000
    found = psis_loo(window_log_likelihood(fit, flocks, draws).to_numpy())
    # The exact posterior of two parameters, with and without each trial, on a grid of 1 sd to
    # both sides of the mean, which integrates a normal to 1e-8 but for what is beyond 4 sd.
    drawn = fit.parameters(2000)
    gain = drawn["transition.alignment_gain"]
    log_noise = np.log(drawn["transition.process_noise"])
    sides = torch.linspace(-4.0, 4.0, 9)
    align = float(gain.mean()) + float(gain.std()) * sides
    shake = float(log_noise.mean()) + float(log_noise.std()) * sides
    batch = fit.prepare(flocks).batch()
    density, prior = [], []
    with own_parameters(fit.model), torch.no_grad():
        for a in align:
            for s in shake:
                values = {"transition.alignment_gain": a, "transition.process_noise": s.exp()}
                found_here = collapsed_evidence(fit.model, batch, values, method="extended")
                density.append(found_here.numpy())
                prior.append(norm.logpdf(a, 0.0, 2.0) + norm.logpdf(s, -1.0, 1.0))
    density, prior = np.stack(density), np.array(prior)
    whole = density.sum(-1) + prior
    exact = logsumexp(whole) - logsumexp(whole[:, None] - density, axis=0)
    assert found.learned.all()
    # Two standard errors of the estimated sum, by the spread of the terms: what PSIS-LOO claims
    # of itself. And far less than that, as it should be: what 1000 draws leave open.
    difference = found.elpd - exact
    error = np.sqrt(len(exact)) * found.elpd.std(ddof=1)
    assert abs(difference.sum()) < 2.0 * error
    assert np.abs(difference).max() < 0.1
    # Each of two parameters is worth about one nat in all.
    assert 1.0 < (found.in_sample - found.elpd).sum() < 4.0
