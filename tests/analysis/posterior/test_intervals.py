"""Quantiles by one sort are those of numpy, whatever is missing."""

import numpy as np
import pytest

from swarmssm.analysis.posterior.intervals import QUANTILES, quantiles


@pytest.mark.parametrize("draws", [1, 2, 5, 19, 200])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.9])
def test_they_equal_nanquantile(draws, share):
    rng = np.random.default_rng(draws)
    values = rng.standard_cauchy((draws, 7, 11))
    values[rng.random(values.shape) < share] = np.nan
    values[:, 0, 0] = 3.0
    values[0, 1, 1] = np.nan
    expected = np.full((3, 7, 11), np.nan)
    known = np.isfinite(values).any(0)
    expected[:, known] = np.nanquantile(values[:, known], QUANTILES, axis=0, method="weibull")
    found = quantiles(values)
    # Relative to the larger of the two neighbours between which a quantile lies.
    size = np.nanmax(np.abs(np.where(known, values, 0.0)), initial=0.0, axis=0)
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    assert np.all(np.abs(found - expected)[:, known] <= 4e-15 * size[known])


def test_a_single_number():
    assert quantiles(np.arange(1.0, 20.0)).tolist() == [1.0, 10.0, 19.0]
    assert np.isnan(quantiles(np.full(3, np.nan))).all()
