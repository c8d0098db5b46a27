"""p-values by hand, and their distribution where recording and replicates are alike."""

import numpy as np
import pytest
from scipy import stats

from swarmssm.analysis.diagnostics.checks.p_values import Judged, adjusted_p_values, judge

NAN = np.nan
#: How often a test here may fail although all is right.
FALSE_ALARM = 1e-5


def test_a_number_by_its_rank_on_either_side():
    replicated = np.arange(19.0)
    assert judge("number", 100.0, replicated).p_value == pytest.approx(2 / 20)
    assert judge("number", -1.0, replicated).p_value == pytest.approx(2 / 20)
    # Above seventeen of nineteen: two and itself are at least as high.
    assert judge("number", 16.5, replicated).p_value == pytest.approx(2 * 3 / 20)
    assert judge("number", 9.0, replicated).p_value == 1.0


def test_where_all_are_the_same_nothing_is_unusual():
    found = judge("number", 2.0, np.full(9, 2.0))
    assert (found.p_value, found.place) == (1.0, 0.0)
    assert judge("number", 3.0, np.full(9, 2.0)).p_value == pytest.approx(0.2)


def test_a_replicate_that_flew_off_is_no_company():
    replicated = np.arange(19.0)
    alike = judge("number", 9.5, replicated).p_value
    some = judge("number", 9.5, np.where(replicated % 2 == 0, NAN, replicated)).p_value
    # Of nine that are left four are above and five below.
    assert some == pytest.approx(2 * 5 / 20)
    assert some < alike
    assert judge("number", 9.5, np.full(19, NAN)).p_value == pytest.approx(2 / 20)
    shares = np.tile([0.5, 0.5], (19, 1))
    shares[4:] = NAN
    # The observed and four others, all at the same distance.
    assert judge("histogram", [0.5, 0.5], shares).p_value == pytest.approx(5 / 20)
    assert judge("curve", [0.5, 0.5], shares).p_value == pytest.approx(5 / 20)


def test_what_the_recording_does_not_tell_is_not_judged():
    assert np.isnan(judge("number", NAN, np.arange(9.0)).p_value)
    assert np.isnan(judge("histogram", [0.0, 0.0], np.ones((9, 2))).p_value)
    curves = np.random.default_rng(0).normal(size=(9, 3))
    first = judge("curve", [NAN, 0.3, 0.1], curves)
    assert first.p_value == judge("curve", [0.3, 0.1], curves[:, 1:]).p_value


def test_hellinger_distance_to_the_others_by_hand():
    shares = np.array([[1.0, 0.0], [1.0, 0.0], [0.5, 0.5]])
    found = judge("histogram", [0.0, 1.0], shares)
    # The mean of the replicates is (5/6, 1/6).
    assert found.hellinger == pytest.approx(np.sqrt(1 - np.sqrt(1 / 6)))
    # Each replicate to the mean of the two others and the observed: twice (1/2, 1/2), then
    # (2/3, 1/3).
    others = [np.sqrt(1 - np.sqrt(0.5))] * 2 + [np.sqrt(1 - np.sqrt(1 / 3) - np.sqrt(1 / 6))]
    assert found.hellinger_among == pytest.approx(np.median(others))
    assert found.p_value == pytest.approx(1 / 4)


def test_extreme_rank_length_by_hand():
    # Ranks at three points, from the outside: the observed is outermost twice, the first replicate
    # outermost once, at the other end.
    observed = [5.0, 5.0, 3.0]
    curves = np.array([[1.0, 2.0, 2.0], [2.0, 1.0, 5.0], [3.0, 3.0, 4.0], [4.0, 4.0, 1.0]])
    # Sorted: observed (1, 1, 3); (1, 2, 2); (1, 1, 2) is more extreme; (2, 3, 3); (1, 2, 2).
    assert judge("curve", observed, curves).p_value == pytest.approx(2 / 5)


def test_the_height_of_a_peak_does_not_matter_to_a_curve():
    rng = np.random.default_rng(1)
    curves, observed = rng.normal(size=(19, 5)), rng.normal(size=5)
    found = judge("curve", observed, curves).p_value
    curves[curves == curves.max()] = 1e12
    assert judge("curve", observed, curves).p_value == found


@pytest.mark.parametrize("kind", ["number", "curve", "histogram"])
def test_p_values_are_uniform_where_all_are_alike(kind):
    rng = np.random.default_rng(2)
    draws, repeats = 19, 1500
    found = []
    for _ in range(repeats):
        if kind == "number":
            values = rng.standard_t(2, size=draws + 1)
        elif kind == "curve":
            # Points that hang together, with heavy tails.
            values = rng.standard_t(2, size=(draws + 1, 6)).cumsum(-1)
        else:
            values = rng.dirichlet(np.full(6, 0.5), size=draws + 1)
        found.append(judge(kind, values[0], values[1:]).p_value)
    step = 2 if kind == "number" else 1
    counts = np.bincount(np.round(np.array(found) * (draws + 1) / step).astype(int))[1:]
    assert len(counts) == (draws + 1) // step
    assert stats.chisquare(counts).pvalue > FALSE_ALARM


def test_adjusted_p_values_raise_few_false_alarms():
    rng = np.random.default_rng(3)
    draws, repeats, alarms = 39, 800, 0
    for _ in range(repeats):
        common = rng.normal(size=(draws + 1, 1))
        values = common + rng.normal(size=(draws + 1, 12))
        judged = [judge("number", column[0], column[1:]) for column in values.T]
        alarms += bool((adjusted_p_values(judged) <= 0.05).any())
    # A rank of 1 or 2 among 40 is at or below 0.05.
    assert alarms <= stats.binom.isf(FALSE_ALARM, repeats, 0.05)


def test_one_far_statistic_among_many_is_still_found():
    rng = np.random.default_rng(4)
    values = rng.normal(size=(100, 20))
    values[0, 7] = 15.0
    judged = [judge("number", column[0], column[1:]) for column in values.T]
    adjusted = adjusted_p_values(judged)
    assert adjusted[7] == pytest.approx(2 / 100)
    assert (np.delete(adjusted, 7) >= [one.p_value for i, one in enumerate(judged) if i != 7]).all()


def test_a_statistic_that_is_not_judged_is_not_counted():
    empty = Judged(NAN, NAN, np.full(9, NAN))
    one = judge("number", 100.0, np.arange(9.0))
    adjusted = adjusted_p_values([empty, one])
    assert np.isnan(adjusted[0])
    assert adjusted[1] == pytest.approx(0.2)
    assert np.isnan(adjusted_p_values([empty])).all()
