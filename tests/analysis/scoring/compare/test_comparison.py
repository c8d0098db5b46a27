"""Who is first, by how much, and who may not be compared."""

import json
import math

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.posterior import window_log_likelihood
from swarmssm.analysis.scoring import Comparison, compare
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks

LFO = {"method": "lfo", "draws": 200, "window": 5}


@pytest.fixture(scope="module")
def left_out(whole_fits, flocks):
    return compare(whole_fits, flocks, method="loo", draws=400)


@pytest.fixture(scope="module")
def in_time(timed_fits, flock):
    return compare(timed_fits, flock, **LFO)


@pytest.fixture(scope="module")
def held_out(timed_fits, flock):
    return compare(timed_fits, flock, horizons=(1, 3), origins=20, draws=20)


@pytest.mark.parametrize("name", ["left_out", "in_time", "held_out"])
def test_the_law_that_made_the_tracks_is_first(name, request):
    comparison = request.getfixturevalue(name)
    found = comparison.data
    assert list(comparison.summary().index) == list(found["model"].values)
    assert str(found["model"].values[0]) == "aligned"
    assert int(found["rank"].sel(model="aligned")) == 1
    assert float(found["difference"].sel(model="aligned")) == 0.0
    behind = found.sel(model="alone")
    assert float(behind["difference"]) > 2.0 * float(behind["difference_se"]) > 0.0
    score = found["score"]
    assert float(score.sel(model="aligned") - score.sel(model="alone")) == pytest.approx(
        float(behind["difference"])
    )
    for variable in found.data_vars.values():
        assert {"units", "long_name"} <= set(variable.attrs)
    text = comparison.verdict()
    assert "aligned is first" in text
    json.dumps(comparison.to_dict())


def test_differences_are_paired(left_out, whole_fits, flocks):
    assert left_out.data.sizes["window"] == 12
    assert left_out.data.attrs["part"] == "train"
    elpd = left_out.data["elpd"]
    apart = (elpd.sel(model="aligned") - elpd.sel(model="alone")).to_numpy()
    own = left_out.data.sel(model="alone")
    assert float(own["difference"]) == pytest.approx(apart.sum())
    assert float(own["difference_se"]) == pytest.approx(np.sqrt(12) * apart.std(ddof=1))
    # A mean over draws lies between the least and the greatest of them.
    each = window_log_likelihood(whole_fits["alone"], flocks, 400).to_numpy()
    assert (
        (each.min(0) <= elpd.sel(model="alone")) & (elpd.sel(model="alone") <= each.max(0))
    ).all()


def test_future_frames_alone_are_scored(in_time):
    assert in_time.data.attrs["part"] == "test"
    assert int(in_time.data["start"].min()) == 45
    assert int(in_time.data["stop"].max()) == 90
    assert in_time.data.attrs["positions"] == 45 * 3
    assert any("follow each other" in note for note in in_time.data.attrs["notes"])


def test_rivals_stand_beside_the_fits(held_out):
    names = [str(name) for name in held_out.data["model"].values]
    assert {"constant-velocity", "stay-put"} < set(names)
    assert held_out.data["fitted"].to_series().to_dict()["stay-put"] is False
    assert list(held_out.data["log_score"]["horizon"].values) == [1, 3]
    rows = held_out.rows()
    assert [row["model"] for row in rows] == names
    assert rows[0]["behind the best"] == "–"
    assert "±" in rows[1]["behind the best"]


def test_models_without_a_posterior_take_part_where_they_can(quick_fit, boids):
    fits = {"one": quick_fit, "other": quick_fit}
    comparison = compare(fits, boids, **LFO)
    found = comparison.data
    assert float(found["difference"].max()) == pytest.approx(0.0)
    assert bool(found["believed"].all())
    assert "not behind" in comparison.verdict()
    with pytest.raises(InputError, match="learned weights without a posterior"):
        compare(fits, boids, method="loo")


def test_what_was_seen_is_refused_unless_told_otherwise(whole_fits, flocks):
    with pytest.raises(InputError, match=r"aligned and alone were fitted on frames .*--allow-seen"):
        compare(whole_fits, flocks)
    with pytest.raises(InputError, match="were fitted on frames"):
        compare(whole_fits, flocks, method="lfo")
    found = compare(whole_fits, flocks, allow_seen=True, **{**LFO, "window": None})
    assert any("trained on" in note for note in found.notes)


def test_what_was_not_seen_cannot_be_left_out(whole_fits, timed_fits, flock, flocks):
    with pytest.raises(InputError, match="alone was not fitted on these tracks"):
        compare(
            {"aligned": whole_fits["aligned"], "alone": timed_fits["alone"]}, flocks, method="loo"
        )


def test_what_is_left_out_must_be_the_same(whole_fits, flocks, fit_of_some):
    with pytest.raises(InputError, match="some was trained on other frames"):
        compare({"all": whole_fits["aligned"], "some": fit_of_some}, flocks, method="loo")


@pytest.fixture
def fit_of_some(whole_fits):
    """A fit that was trained on the first eight trials."""
    from dataclasses import replace

    from swarmssm.tracks.splits import Split

    own = whole_fits["aligned"]
    return replace(own, split=Split(own.split.train[:8], (), own.split.train[8:]))


def test_the_past_is_no_future(timed_fits, flock):
    from dataclasses import replace

    from swarmssm.tracks.splits import Split

    own = timed_fits["aligned"]
    turned = replace(own, split=Split(own.split.test, (), own.split.train))
    with pytest.raises(InputError, match="frames that come after"):
        compare({"one": turned, "other": turned}, flock, **LFO)


def test_other_tracks_are_all_held_out(timed_fits, flocks):
    found = compare(timed_fits, flocks, **{**LFO, "window": None}).data
    assert found.attrs["part"] == "all"
    assert found.sizes["window"] == 12


def test_tracks_of_another_kind_are_refused(timed_fits, flock):
    position = flock["position"].transpose("trial", "time", "individual", "space").to_numpy()
    graph = flock["adjacency"].to_numpy()
    slow = make_tracks(position, fps=25.0, adjacency=graph)
    with pytest.raises(InputError, match="aligned: it was fitted on 5 frames a second"):
        compare(timed_fits, slow, **LFO)
    pixels = make_tracks(100.0 * position, fps=5.0, adjacency=graph)
    with pytest.raises(InputError, match=r"aligned: its animals spread over .*units differ"):
        compare(timed_fits, pixels, **LFO)
    deep = np.concatenate([position, position[..., :1]], -1)
    with pytest.raises(InputError, match="tracks of 2 coordinates, and these have 3"):
        compare(timed_fits, make_tracks(deep, fps=5.0, adjacency=graph), **LFO)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "waic"}, "method: 'waic' is unknown"),
        ({"method": "loo", "part": "test"}, "leave-one-out is of the training part"),
        ({"method": "loo", "allow_seen": True}, "frames that the fits have seen"),
        ({"window": 5}, "held-out has no windows"),
        ({"method": "lfo", "draws": 20}, "fewer than 100 draws"),
        ({"method": "lfo", "window": 0}, "window: it must be at least 1"),
        ({"part": "end"}, "part: 'end' is unknown"),
    ],
)
def test_wrong_input(timed_fits, flock, options, words):
    with pytest.raises(InputError, match=words):
        compare(timed_fits, flock, **options)


def test_one_fit_is_no_comparison(timed_fits, flock):
    with pytest.raises(InputError, match="at least two"):
        compare({"aligned": timed_fits["aligned"]}, flock)


def plain(method, scores, differences, errors, believed=None):
    """Return a comparison with planted numbers."""
    names = list(scores)
    data = {
        "rank": ("model", np.arange(1, len(names) + 1)),
        "fitted": ("model", [name not in ("constant-velocity", "stay-put") for name in names]),
        "score": ("model", list(scores.values())),
        "se": ("model", [0.1] * len(names)),
        "difference": ("model", differences),
        "difference_se": ("model", errors),
    }
    if believed is not None:
        data["believed"] = (("model", "window"), believed)
    return Comparison(xr.Dataset(data, {"model": names}, {"method": method, "notes": []}))


def test_words_of_a_close_race():
    text = plain(
        "held-out", {"a": 1.0, "b": 0.9, "far": 0.1}, [0, 0.1, 0.9], [0, 0.08, 0.1]
    ).verdict()
    assert "a is first with 1.00 nats a coordinate, 0.100 (standard error 0.0800) before b" in text
    assert "b is not behind by 2 standard errors" in text
    assert "far" not in text.split("before b")[1]


def test_words_of_a_rule_that_loses_to_none():
    scores = {"constant-velocity": 1.0, "a": 0.5}
    text = plain("held-out", scores, [0, 0.5], [0, 0.1]).verdict()
    assert "All others are behind" in text
    assert "a does not forecast better than constant velocity" in text


def test_words_without_a_standard_error():
    text = plain("held-out", {"a": 1.0, "b": 0.9}, [0, 0.1], [0, math.nan]).verdict()
    assert "0.100 (no standard error) before b" in text
    assert "All others" not in text


def test_words_of_weights_that_cannot_be_believed():
    believed = [[True] * 9 + [False], [False] * 2 + [True] * 8]
    text = plain("loo", {"a": 9.0, "b": 1.0}, [0, 8.0], [0, 1.0], believed).verdict()
    assert "In 3 of 10 windows the weights cannot be believed: read no ranking" in text
    text = plain("loo", {"a": 9.0, "b": 1.0}, [0, 8.0], [0, 1.0], [believed[0]] * 2).verdict()
    assert "In 1 of 10 windows the weights cannot be believed." in text
