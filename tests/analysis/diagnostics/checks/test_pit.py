"""PITs of mixtures by hand, and of forecasts that are right, too narrow and too wide."""

import numpy as np
import pytest
from scipy import stats

from swarmssm.analysis.diagnostics.checks.pit import mixture_pit, one_step_pit
from swarmssm.errors import InputError

NAN = np.nan


def test_of_mixtures_by_hand():
    location, variance = np.array([[0.0, 0.0], [4.0, 0.0]]), np.array([[1.0, 4.0], [4.0, 4.0]])
    found = mixture_pit(np.array([2.0, NAN]), location, variance)
    expected = (stats.norm.cdf(2) + stats.norm.cdf(-1)) / 2
    np.testing.assert_allclose(found, [expected, NAN])


def test_of_students_t_by_its_variance():
    # A t of 5 degrees has the variance 5 / 3 of its squared scale.
    found = mixture_pit(np.array([1.0]), np.zeros((1, 1)), np.full((1, 1), 5 / 3), 5.0)
    np.testing.assert_allclose(found, stats.t.cdf(1.0, 5))


def test_a_part_that_broke_down_is_on_either_side():
    found = mixture_pit(np.array([3.0]), np.array([[np.inf], [0.0]]), np.ones((2, 1)))
    np.testing.assert_allclose(found, (0.5 + stats.norm.cdf(3)) / 2)


def test_the_model_that_made_the_flock_is_calibrated(flock):
    result = one_step_pit(*flock, draws=40, origins=30)
    found = result.data
    assert found["passes"].all()
    assert found["pit"].dims == ("origin", "individual", "space")
    assert found["parameter"].values.tolist() == ["x", "y"]
    assert result.verdict().startswith("One-step forecasts are calibrated")
    assert result.summary()["in_band"].tolist() == [True, True]
    assert len(result.to_pandas()) == int(found["pit"].notnull().sum())


@pytest.mark.parametrize(("factor", "words"), [(3.0, "too narrow"), (0.2, "too wide")])
def test_a_flock_that_is_noisier_or_calmer_is_told(flock, factor, words):
    """The same places seen with other noise: of three times the size, or nearly none."""
    fit, tracks = flock
    position = tracks["position"]
    smooth = position.rolling(time=5, center=True, min_periods=1).mean()
    found = one_step_pit(fit, tracks.assign(position=smooth + factor * (position - smooth)))
    assert not found.data["passes"].all()
    assert words in found.verdict()


def test_a_model_that_only_draws_has_pits_too(quick_fit, boids):
    found = one_step_pit(quick_fit, boids, draws=20, origins=10)
    pit = found.data["pit"].values
    assert np.isfinite(pit).any()
    assert ((pit > 0) & (pit < 1))[np.isfinite(pit)].all()
    assert found.verdict()


def test_too_few_draws_are_refused(flock):
    with pytest.raises(InputError, match="draws"):
        one_step_pit(*flock, draws=3)
