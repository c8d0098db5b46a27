"""The simultaneous band of ranks, against simulation and hand-worked numbers."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from swarmssm.analysis.diagnostics.sbc.uniformity import (
    ecdf_band,
    histogram_interval,
    inside_probability,
    uniformity_p_value,
)
from swarmssm.errors import InputError


def share_below(ranks, points, draws):
    return (ranks[..., None, :] < points[:, None] * (draws + 1) - 1e-9).mean(-1)


def test_probability_inside_bounds_by_counting_all_cases():
    # Two numbers, points 1/2 and 3/4: all cells of the pair have probabilities that multiply.
    points = np.array([0.5, 0.75])
    low, high = np.array([1, 1]), np.array([1, 2])
    cells = [0.5, 0.25, 0.25]
    wanted = 0.0
    for pair in itertools.product(range(3), repeat=2):
        first, second = sum(c == 0 for c in pair), sum(c <= 1 for c in pair)
        if low[0] <= first <= high[0] and low[1] <= second <= high[1]:
            wanted += cells[pair[0]] * cells[pair[1]]
    assert inside_probability(2, points, low, high) == pytest.approx(wanted, abs=1e-12)
    assert wanted == 0.5


@pytest.mark.parametrize(("number", "draws", "level"), [(50, 19, 0.95), (100, 99, 0.8)])
def test_the_band_holds_all_of_the_function_as_often_as_it_says(number, draws, level):
    points, low, high = ecdf_band(number, draws, level)
    bounds = [np.round(part * number).astype(int) for part in (low, high)]
    exact = inside_probability(number, points, *bounds)
    assert exact >= level
    # Counts are whole: the next narrower band falls below the level.
    assert exact < level + 0.03
    runs = 4000
    ranks = np.random.default_rng(0).integers(0, draws + 1, (runs, number))
    ecdf = share_below(ranks, points, draws)
    inside = ((ecdf >= low - 1e-9) & (ecdf <= high + 1e-9)).all(-1).mean()
    assert abs(inside - exact) < 4 * math.sqrt(exact * (1 - exact) / runs)


def test_the_band_is_wider_than_a_pointwise_one():
    points, low, high = ecdf_band(200, 199)
    middle = len(points) // 2
    pointwise = stats.binom.ppf([0.025, 0.975], 200, points[middle]) / 200
    assert low[middle] < pointwise[0]
    assert high[middle] > pointwise[1]


def test_the_band_agrees_with_the_p_value():
    rng = np.random.default_rng(1)
    points, low, high = ecdf_band(60, 39)
    verdicts = set()
    for trial in range(150):
        # Some calibrated, some too sure by a growing amount.
        ranks = np.floor(40 * rng.beta(*[1.0 - trial / 300] * 2, 60)).astype(int).clip(0, 39)
        ecdf = share_below(ranks, points, 39)
        inside = bool(((ecdf >= low - 1e-9) & (ecdf <= high + 1e-9)).all())
        verdicts.add(inside)
        assert inside == (uniformity_p_value(ranks, 39) > 0.05)
    assert verdicts == {True, False}


def test_p_values_of_uniform_ranks_are_not_too_small():
    rng = np.random.default_rng(2)
    runs = 400
    small = sum(uniformity_p_value(rng.integers(0, 20, 40), 19) <= 0.1 for _ in range(runs))
    assert small <= 0.1 * runs + 4 * math.sqrt(0.09 * runs)


def test_one_draw_is_one_binomial():
    # Ranks 0 and 1: the only point is 1/2, and the band the interval of one binomial.
    points, low, high = ecdf_band(100, 1)
    assert points.tolist() == [0.5]
    assert stats.binom.cdf(round(100 * low[0]) - 1, 100, 0.5) <= 0.025
    assert [low[0], high[0]] == [0.4, 0.6]
    # 2 P(X <= 39) = 0.0352, from tables of Binomial(100, 1/2).
    assert uniformity_p_value([0] * 39 + [1] * 61, 1) == pytest.approx(0.0352, abs=1e-4)


def test_interval_of_a_bin():
    assert histogram_interval(100, 0.5) == (40.0, 60.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ecdf_band(0, 10), "at least one"),
        (lambda: ecdf_band(10, 10, 1.0), "level"),
        (lambda: uniformity_p_value([3, 11], 10), "from 0 to 10"),
        (lambda: uniformity_p_value([], 10), "at least one"),
    ],
)
def test_mistakes(call, words):
    with pytest.raises(InputError, match=words):
        call()
