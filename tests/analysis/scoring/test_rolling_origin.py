"""Scores of forecasts from the same frames, against numbers worked out by hand."""

import copy
import dataclasses

import numpy as np
import pyro.distributions as dist
import pytest
import torch
import xarray as xr

from swarmssm import inference, io
from swarmssm.analysis import evaluate
from swarmssm.analysis.scoring import frames_trained_on, score, score_table, skill
from swarmssm.errors import InputError
from swarmssm.metrics import gaussian_crps, gaussian_energy_score, gaussian_log_score
from swarmssm.tracks import states_of
from swarmssm.tracks.splits import Segment, Split

NET, STAY, STRAIGHT, FLOOR = "net", "stay-put", "constant-velocity", "noise-floor"
FEW = {"horizons": (1, 3), "origins": 6, "draws": 20}


def with_split(fit, **parts):
    own = {"train": (), "validation": (), "test": ()} | parts
    return dataclasses.replace(fit, split=Split(**own))


def test_it_says_who_was_scored_from_where(scores, quick_fit, boids):
    assert scores["model"].values.tolist() == [NET, STAY, STRAIGHT, FLOOR]
    assert scores["horizon"].values.tolist() == [1, 3, 5]
    np.testing.assert_allclose(scores["ahead"], [0.1, 0.3, 0.5])
    (test,) = quick_fit.split.test
    assert set(scores["trial"].values) == {test.trial}
    assert scores.sizes["origin"] == 12
    rows = scores["frame"].to_numpy()
    assert rows.min() == test.start
    assert rows.max() == test.stop - 2
    np.testing.assert_allclose(scores["time"], boids["time"].to_numpy()[rows])
    assert scores.attrs["part"] == "test"
    assert scores.attrs["notes"] == []
    for name, variable in scores.data_vars.items():
        assert {"units", "long_name"} <= variable.attrs.keys(), name
    assert scores["trained_on"].values.tolist() == [0, 0, 0, 0]


def test_later_horizons_count_those_whose_truth_is_known(scores, quick_fit):
    last = quick_fit.split.test[0].stop - 1
    for horizon in (1, 3, 5):
        counted = scores["number"].sel(horizon=horizon).to_numpy()
        room = scores["frame"].to_numpy() + horizon <= last
        np.testing.assert_array_equal(counted, np.where(room, 5, 0))
        assert scores["crps"].sel(horizon=horizon).isnull().any("model").values.tolist() == [
            not one for one in room
        ]


def test_constant_velocity_is_scored_as_by_hand(scores, quick_fit, boids):
    def steps(states, rows, ahead):
        return states[:, rows, :, :2] + 0.1 * ahead * states[:, rows, :, 2:]

    training = states_of(quick_fit.part(boids, "train"))
    part = states_of(quick_fit.part(boids, "test"))
    for horizon in (1, 5):
        errors = training[:, horizon:, :, :2] - steps(training, slice(0, -horizon), horizon)
        errors = errors.reshape(-1, 2)
        covariance = errors.T @ errors / len(errors)
        rows = scores["frame"].to_numpy()
        rows = rows[rows + horizon < part.shape[1]]
        truth, mean = part[0, rows + horizon, :, :2], steps(part, rows, horizon)[0]
        own = scores.sel(model=STRAIGHT, horizon=horizon).isel(origin=slice(0, len(rows)))
        # The covariance is of a sample of all these errors.
        sd = np.sqrt(np.diagonal(covariance))
        expected = gaussian_crps(truth, mean, sd).mean((-2, -1))
        np.testing.assert_allclose(own["crps"], expected, rtol=1e-6)
        expected = gaussian_log_score(truth, mean, covariance).mean(-1)
        np.testing.assert_allclose(own["log_score"], expected, rtol=1e-6)
        expected = gaussian_energy_score(truth, mean, covariance).mean(-1)
        np.testing.assert_allclose(own["energy_score"], expected, rtol=1e-6)
        np.testing.assert_allclose(own["mse"], ((truth - mean) ** 2).mean((-2, -1)), rtol=1e-9)
        half = 1.6448536 * sd
        inside = (np.abs(truth - mean) <= half).mean((-2, -1))
        np.testing.assert_allclose(own["coverage"].sel(level=0.9), inside)
        np.testing.assert_allclose(own["width"].sel(level=0.9), 2.0 * half.mean(), rtol=1e-6)


def test_one_fit_gets_the_scores_of_its_evaluation(quick_fit, boids):
    found = score({"net": quick_fit}, boids, horizons=(1, 4), origins=8, seed=3)
    other = evaluate(quick_fit, boids, horizons=(1, 4), origins=8, seed=3, free_run_steps=2)
    for own, name in ((NET, "graph-vae"), (STAY, STAY), (FLOOR, FLOOR)):
        for horizon in (1, 4):
            for kind in ("log_score", "crps", "coverage"):
                table = score_table(found, kind).sel(model=own, horizon=horizon)
                assert float(table) == pytest.approx(other.score(kind, name, horizon)), kind
    at_one = other.to_dict()["methods"]["graph-vae"]["horizons"]["1"]
    assert at_one["crps"] == pytest.approx(other.score("crps", "graph-vae", 1))
    assert at_one["coverage"]["0.5"] == other.score("coverage", "graph-vae", 1, level=0.5)


def test_the_true_rule_is_best_and_its_intervals_hold(scores):
    """Of some 600 coordinates, those of one origin depending on each other: 6 sd of 12 origins."""
    for kind in ("log_score", "crps", "energy_score"):
        best = skill(scores, STRAIGHT, FLOOR)[kind]
        assert float(best.sel(model=FLOOR).min()) == pytest.approx(1.0)
        assert float(best.sel(model=[NET, STAY]).max()) < 1.0
    for level in (0.5, 0.8, 0.9):
        covered = float(score_table(scores, "coverage", level).sel(model=FLOOR).mean())
        assert abs(covered - level) < 6.0 * np.sqrt(level * (1.0 - level) / (12 * 3 * 5))


def test_fits_that_differ_in_scaler_and_velocity_meet_on_the_same_frames(boids, quick_fit):
    """One who smooths velocities from the past has none in the first frame."""
    other = inference.fit(
        "graph-vae", boids, epochs=1, seed=1, scaler="isotropic", velocity="kalman"
    )
    both = score({"one": quick_fit, "two": other, "again": quick_fit}, boids, **FEW)
    assert both["frame"].values.min() == 1
    assert both.sizes["origin"] == 6
    np.testing.assert_array_equal(both["crps"].sel(model="one"), both["crps"].sel(model="again"))
    assert not (both["crps"].sel(model="one") == both["crps"].sel(model="two")).any()
    assert np.isfinite(both["crps"].sel(horizon=1)).all()
    assert (both["number"].sel(horizon=1) == 5).all()


def test_individuals_that_are_away_count_for_nobody(quick_fit, boids):
    tracks = boids[["position", "velocity", "adjacency"]].copy(deep=True)
    (test,) = quick_fit.split.test
    place = boids["trial"].values.tolist().index(test.trial)
    for name in ("position", "velocity"):
        # Individual 2 is away in rows 10 to 20, nobody is there in row 30.
        values = tracks[name].transpose("trial", "time", "space", "individual").values
        values[place, 10:21, :, 2] = np.nan
        values[place, 30] = np.nan
    fit = dataclasses.replace(
        quick_fit,
        provenance={**quick_fit.provenance, "data": {"sha256": "another"}},
    )
    found = score({"net": fit}, tracks, horizons=(1, 5), origins=60, draws=20, part="all")
    own = found.isel(origin=np.flatnonzero(found["trial"] == test.trial)).swap_dims(origin="frame")
    assert 30 not in own["frame"]
    number = own["number"]
    assert number.sel(frame=9).values.tolist() == [4, 4]
    assert number.sel(frame=5).values.tolist() == [5, 4]
    assert number.sel(frame=[10, 15, 20]).max() == 4
    assert number.sel(frame=29).values.tolist() == [0, 5]
    assert number.sel(frame=25).values.tolist() == [5, 0]
    assert own["crps"].sel(frame=29, horizon=1).isnull().all()
    assert own["crps"].sel(frame=29, horizon=5).notnull().all()


def test_a_model_that_breaks_down_counts_and_is_infinitely_bad(quick_fit, boids, monkeypatch):
    broken = copy.deepcopy(quick_fit)
    with torch.no_grad():
        for parameter in broken.model.decoder.parameters():
            parameter.mul_(1e3)
    monkeypatch.setattr(
        type(broken.guide), "encode", lambda self, states, graph: dist.Normal(1e9 * states, 1.0)
    )
    found = score({"net": broken}, boids, horizons=(1, 8), origins=5, draws=20)
    own = found.sel(model=NET, horizon=8).isel(origin=0)
    assert int(own["number"]) == 5
    assert float(own["crps"]) == np.inf
    assert float(own["energy_score"]) == np.inf
    assert float(own["log_score"]) == -np.inf
    assert own["coverage"].values.tolist() == [0.0, 0.0, 0.0]
    assert np.isposinf(own["width"]).all()
    assert np.isfinite(found["crps"].sel(model=STRAIGHT, horizon=8).isel(origin=0))


def test_splits_that_differ_meet_in_what_all_hold_out(quick_fit, boids):
    first, second = (str(name) for name in boids["trial"].values[:2])
    one = with_split(quick_fit, train=(Segment(second, 0, 60),), test=(Segment(first, 0, 40),))
    two = with_split(
        quick_fit,
        train=(Segment(first, 0, 20),),
        test=(Segment(first, 20, 60), Segment(second, 0, 60)),
    )
    found = score({"one": one, "two": two}, boids, horizons=(1,), origins=99, draws=20)
    assert found["trial"].values.tolist() == [first] * 19
    assert found["frame"].values.tolist() == list(range(20, 39))
    assert found.attrs["part"] == "common"
    assert "what all hold out" in found.attrs["notes"][0]
    apart = with_split(quick_fit, train=(Segment(first, 0, 60),), test=(Segment(second, 0, 60),))
    with pytest.raises(InputError, match="test of one, test of apart have no two consecutive"):
        score({"one": one, "apart": apart}, boids)


def test_frames_that_trained_a_model_are_told(quick_fit, boids):
    found = score({"net": quick_fit}, boids, part="all", **FEW)
    number = sum(s.stop - s.start for s in quick_fit.split.train)
    assert int(found["trained_on"].sel(model=NET)) == number
    assert f"net was trained on {number} of the scored frames" in " ".join(found.attrs["notes"])
    assert frames_trained_on(quick_fit, quick_fit.split.test) == 0


def test_other_tracks_are_held_out_whole(quick_fit, boids):
    tracks = boids.isel(time=slice(0, 30))
    found = score({"net": quick_fit}, tracks, **FEW)
    assert found.attrs["part"] == "all"
    assert len(set(found["trial"].values)) == 4
    notes = " ".join(found.attrs["notes"])
    assert "net was not fitted on these tracks" in notes
    assert "their scores are too good" in notes
    with pytest.raises(InputError, match="have no test part of theirs"):
        score({"net": quick_fit}, tracks, part="test")


def test_horizons_without_room_are_left_out(quick_fit, boids):
    found = score({"net": quick_fit}, boids, horizons=(1, 80), origins=3, draws=20)
    assert found["horizon"].values.tolist() == [1]
    assert "room for at most 59 steps ahead: 80 steps are not scored" in found.attrs["notes"][0]
    with pytest.raises(InputError, match="room for at most 59 steps"):
        score({"net": quick_fit}, boids, horizons=(80,))


def test_it_can_be_written_and_read(scores, tmp_path):
    io.write_dataset(scores, tmp_path / "scores.nc")
    with xr.open_dataset(tmp_path / "scores.nc") as again:
        np.testing.assert_array_equal(again["crps"], scores["crps"])
        assert again["model"].values.tolist() == scores["model"].values.tolist()


def test_progress_is_told(quick_fit, boids):
    seen = []
    score({"net": quick_fit}, boids, progress=seen.append, **FEW)
    assert [one.done for one in seen] == [1, 2, 3, 4]
    assert {one.total for one in seen} == {4}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizons": (5, 1)}, "horizons: give rising whole numbers"),
        ({"horizons": ()}, "horizons: give rising whole numbers"),
        ({"levels": (0.5, 1.0)}, "levels: give probabilities between 0 and 1"),
        ({"levels": (0.5, 0.5)}, "levels: one of .* is given twice"),
        ({"origins": 0}, "origins: it must be at least 1"),
        ({"draws": 5}, "draws: it must be at least 10, and it is 5"),
        ({"seed": -1}, "seed: it must not be negative"),
        ({"part": "tset"}, "part: 'tset' is unknown"),
    ],
)
def test_arguments_out_of_range_are_told(quick_fit, boids, options, message):
    with pytest.raises(InputError, match=message):
        score({"net": quick_fit}, boids, **options)


def test_names_must_be_free_and_fits_there(quick_fit, boids):
    with pytest.raises(InputError, match="at least one fit is needed"):
        score({}, boids)
    with pytest.raises(InputError, match="stay-put is the name of a reference"):
        score({STAY: quick_fit}, boids)
