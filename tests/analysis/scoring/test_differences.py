"""Paired differences, and intervals that know that neighbouring forecasts err together."""

import numpy as np
import pytest

from swarmssm.analysis.scoring import paired_difference, score_table, skill, summary, verdict
from swarmssm.analysis.scoring.differences import block_length, moving_blocks
from swarmssm.errors import InputError


def test_tables_weigh_origins_by_the_individuals_counted(planted):
    scores = planted({"a": [[1.0, 2.0], [4.0, 8.0]]}, number=[[3, 1], [1, 0]])
    table = score_table(scores, "crps")
    assert table.dims == ("model", "horizon")
    assert table.sel(model="a").values.tolist() == [7.0 / 4.0, 2.0]
    assert float(score_table(scores, "coverage", 0.5).sel(model="a", horizon=1)) == 0.9


def test_skill_is_the_share_of_the_rivals_error_that_is_gone(planted):
    scores = planted({"a": 3.0, "constant-velocity": 4.0, "noise-floor": 2.0})
    plain, closed = skill(scores), skill(scores, perfect="noise-floor")
    assert plain["crps"].sel(model="a").values.tolist() == [0.25, 0.25]
    assert plain["crps"].sel(model="constant-velocity").values.tolist() == [0.0, 0.0]
    assert plain["log_score"].sel(model="a").values.tolist() == [1.0, 1.0]
    assert closed["log_score"].sel(model="a").values.tolist() == [0.5, 0.5]
    assert closed["mse"].sel(model="noise-floor").values.tolist() == [1.0, 1.0]
    same = skill(scores, "noise-floor", "noise-floor")
    assert same["crps"].isnull().all()
    with pytest.raises(InputError, match="reference: there is no model 'b'; choose one of a"):
        skill(scores, "b")


def test_a_difference_is_positive_where_the_model_is_better(planted):
    generator = np.random.default_rng(0)
    noise = generator.normal(size=(60, 1))
    scores = planted({"a": 2.0 + noise, "b": 2.5 + noise})
    for score, gain in (("crps", 0.5), ("log_score", 0.5), ("energy_score", 1.0)):
        found = paired_difference(scores, score, "a", "b")
        np.testing.assert_allclose(found["difference"], gain)
        np.testing.assert_allclose(found["se"], 0.0, atol=1e-12)
    assert float(paired_difference(scores, "crps", "b", "a")["difference"].max()) < 0.0


def test_the_standard_error_of_independent_origins_is_the_usual_one(planted):
    generator = np.random.default_rng(1)
    off = generator.normal(scale=2.0, size=(400, 2))
    scores = planted({"a": 5.0 - off, "b": 5.0})
    found = paired_difference(scores, "crps", "a", "b", block=1)
    expected = off.std(0) / 20.0
    # A standard deviation over 4000 resamples is off by 1.1 %.
    np.testing.assert_allclose(found["se"], expected, rtol=0.06)
    np.testing.assert_allclose(found["difference"].sel(quantile=0.5), off.mean(0))
    width = found["difference"].sel(quantile=0.95) - found["difference"].sel(quantile=0.05)
    np.testing.assert_allclose(width, 2 * 1.645 * expected, rtol=0.1)


def test_blocks_reach_beyond_the_horizon():
    trials = np.repeat(["a", "b"], 50)
    frames = np.tile(np.arange(50) * 4, 2)
    assert block_length(trials, frames, 1) == 5
    assert block_length(trials, frames, 20) == 5
    assert block_length(trials, frames, 50) == 13


def test_blocks_stay_within_their_trial_and_draw_all_alike():
    trials = np.array(["a"] * 7 + ["b"] * 3)
    rows = moving_blocks(trials, 5, 20_000, np.random.default_rng(0))
    assert rows.shape == (20_000, 10)
    blocks = rows.reshape(-1, 5)
    assert ((blocks < 7).all(1) | (blocks >= 7).all(1)).all()
    of_a = blocks[(blocks < 7).all(1)]
    assert (np.diff(of_a, axis=1) % 7 == 1).all()
    share = np.bincount(rows.ravel(), minlength=10) / rows.size
    np.testing.assert_allclose(share, 0.1, atol=0.004)


def test_intervals_hold_where_errors_last_and_blocks_of_one_do_not(planted):
    """100 series that remember (rho 0.8): the naive interval is three times too narrow."""
    generator = np.random.default_rng(2)
    held = {1: 0, 40: 0}
    for _ in range(100):
        series = np.empty(600)
        last = generator.normal() / 0.6
        for place in range(600):
            last = series[place] = 0.8 * last + generator.normal()
        scores = planted({"a": 9.0 - series[:, None], "b": 9.0}, horizons=(1,))
        for length in held:
            found = paired_difference(scores, "crps", "a", "b", block=length, resamples=200)
            low, _, high = found["difference"].values[0]
            held[length] += low <= 0.0 <= high
    # The naive one holds 0 with probability 0.42.
    assert held[1] / 100 < 0.42 + 4 * 0.05
    assert held[40] / 100 > 0.9 - 4 * 0.03


def test_too_few_blocks_have_no_interval(planted):
    scores = planted({"a": np.arange(8.0)[:, None], "b": 2.0}, horizons=(1, 40))
    found = paired_difference(scores, "crps", "a", "b")
    assert found["blocks"].values.tolist() == [4, 1]
    assert found["difference"].sel(quantile=0.05).isnull().all()
    assert found["difference"].sel(quantile=0.5).notnull().all()


def test_a_rival_that_broke_down_is_infinitely_worse(planted):
    broken = np.full((30, 1), 1.0)
    broken[3] = np.inf
    found = paired_difference(planted({"a": 1.0, "b": broken}), "crps", "a", "b")
    assert (found["difference"].sel(quantile=0.5) == np.inf).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (("coverage", "a", "b"), "score: 'coverage' cannot be compared"),
        (("crps", "c", "b"), "model: there is no model 'c'"),
        (("crps", "a", "c"), "reference: there is no model 'c'"),
    ],
)
def test_what_is_not_there_is_told(planted, call, message):
    with pytest.raises(InputError, match=message):
        paired_difference(planted({"a": 1.0, "b": 2.0}), *call)


def test_blocks_and_levels_out_of_range_are_told(planted):
    scores = planted({"a": 1.0, "b": 2.0})
    with pytest.raises(InputError, match="block: it must be at least 1"):
        paired_difference(scores, "crps", "a", "b", block=0)
    with pytest.raises(InputError, match="resamples: there must be at least 100"):
        paired_difference(scores, "crps", "a", "b", resamples=5)
    with pytest.raises(InputError, match=r"level: 0.8 was not scored; choose one of 0.5, 0.9"):
        score_table(scores, "coverage", 0.8)
    with pytest.raises(InputError, match="score: 'rmse' is unknown"):
        score_table(scores, "rmse")


def test_the_verdict_has_skill_interval_and_coverage(planted):
    noise = np.random.default_rng(3).normal(scale=0.01, size=(80, 1))
    better = verdict(planted({"a": 2.0 + noise, "constant-velocity": 4.0, "stay-put": 9.0}))
    assert "a: CRPS 5 steps (0.500 s) ahead 50 % lower than constant-velocity" in better
    assert "interval 50 to 50 %" in better
    assert "90 %" in better.rpartition("intervals contain ")[2]
    assert "too" not in better
    level = planted({"a": 4.0 + 100 * noise, "stay-put": 4.0}, coverage=0.7, trained_on=[9, 0])
    assert "no clear difference" in verdict(level)
    assert "too narrow" in verdict(level)
    assert "not a test" in verdict(level)
    few = verdict(planted({"a": np.ones((6, 1)), "constant-velocity": 2.0}))
    assert "too few origins" in few
    worse = {"a": np.array([9.0, 3.0]) + noise, "b": 10.0, "constant-velocity": 4.0}
    assert "worse at 1 steps" in verdict(planted(worse))
    assert verdict(planted(worse), "b").startswith("b: CRPS 5 steps (0.500 s) ahead 150 % higher")


def test_the_summary_has_the_skill_over_the_best_reference(planted):
    found = summary(planted({"a": np.full((40, 2), [2.0, 3.0]), "stay-put": 4.0}))
    assert found.loc["a", ("skill", 1)] == pytest.approx(0.5)
    assert found.loc["a", ("skill_low", 5)] == pytest.approx(0.25)
    assert found.loc["stay-put", ("skill", 5)] == 0.0
    assert found.loc["a", ("crps", 5)] == 3.0
    assert found.loc["a", ("coverage", 5)] == pytest.approx(0.9)
