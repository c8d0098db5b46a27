"""Leave-one-out PITs of a posterior known in closed form, and of the flock."""

import numpy as np
import pytest
from scipy import stats

from swarmssm.analysis.diagnostics.checks import loo_pit
from swarmssm.analysis.diagnostics.checks.leave_one_out import weighted_pit
from swarmssm.errors import InputError


def test_the_mean_of_a_normal_with_each_sighting_left_out():
    """Of n sightings N(mu, 1) with a flat prior each is N(mean of the others, 1 + 1 / (n - 1))."""
    rng = np.random.default_rng(0)
    seen = np.array([-1.2, 0.1, 0.4, 0.9, 1.8])
    number, draws = len(seen), 8000
    mu = seen.mean() + rng.normal(size=(draws, 1)) / np.sqrt(number)
    drawn = mu + rng.normal(size=(draws, number))
    density = stats.norm.logpdf(seen, mu, 1.0)
    pit, pareto = weighted_pit(seen[:, None], drawn[..., None], density)
    others = (seen.sum() - seen) / (number - 1)
    exact = stats.norm.cdf(seen, others, np.sqrt(1 + 1 / (number - 1)))
    # The variance of the weights is at most that of five times fewer draws.
    np.testing.assert_allclose(pit[:, 0], exact, atol=6 * 0.5 / np.sqrt(draws / 5))
    plain, _ = weighted_pit(seen[:, None], drawn[..., None], np.zeros_like(density))
    # With the sighting itself in the posterior the outermost look less extreme.
    assert pit[0] < plain[0]
    assert pit[-1] > plain[-1]
    assert (pareto < 0.7).all()


def test_the_model_that_made_the_flock_is_calibrated(flock):
    result = loo_pit(*flock, observations=150)
    found = result.data
    # Such a p-value is below 1e-4 in one of ten thousand flocks.
    assert (found["p_value"] > 1e-4).all()
    assert found["pit"].shape == (150, 2)
    assert np.isnan(found["pareto_k"]).all()  # nothing was learned, so nothing is left out
    assert "of 150 observations" in result.verdict()


@pytest.mark.parametrize("name", ["draws", "observations"])
def test_too_few_are_refused(flock, name):
    with pytest.raises(InputError, match=name):
        loo_pit(*flock, **{name: 0})
