"""Hellinger distances by hand and by the closed form of normal distributions."""

import numpy as np
import pytest
from scipy import stats

from swarmssm.errors import InputError
from swarmssm.metrics.hellinger import hellinger_distance


def test_by_hand():
    first = [[1.0, 0], [1, 1], [3, 1], [0, 0]]
    second = [[0.0, 5], [2, 2], [1, 3], [1, 1]]
    # Shares 3/4, 1/4 and 1/4, 3/4: half of 2 (sqrt 3 / 2 - 1 / 2)^2.
    expected = [1, 0, (np.sqrt(3) - 1) / 2, np.nan]
    np.testing.assert_allclose(hellinger_distance(first, second), expected, atol=1e-15)


def test_of_two_normal_distributions():
    edges = np.linspace(-12, 12, 4801)
    bins = [np.diff(stats.norm.cdf(edges, mean, 1.0)) for mean in (-0.75, 0.75)]
    # 1 - H^2 = exp(-(difference of means)^2 / 8) for unit variances; bins of 0.005 are as good.
    assert hellinger_distance(*bins) == pytest.approx(np.sqrt(1 - np.exp(-(1.5**2) / 8)), abs=1e-5)


def test_wrong_histograms_are_refused():
    with pytest.raises(InputError, match="same bins"):
        hellinger_distance([1.0, 2], [1.0, 2, 3])
    with pytest.raises(InputError, match="negative"):
        hellinger_distance([1.0, -2], [1.0, 2])
