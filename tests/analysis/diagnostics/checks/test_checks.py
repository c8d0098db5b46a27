"""What a check says of right and wrong models, and what it refuses."""

import dataclasses

import numpy as np
import pytest
import torch
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.diagnostics.checks import (
    STATISTICS,
    ObservedSwarm,
    PredictiveCheck,
    Statistic,
    check,
)
from swarmssm.analysis.diagnostics.checks.arenas import SOFT_WALLS
from swarmssm.analysis.diagnostics.checks.replicates import replicates
from swarmssm.errors import InputError
from swarmssm.metrics.arena import Arena

NAN = np.nan
WALLS = {"wall_distance", "wall_angle"}


@pytest.fixture(scope="module")
def checked(flock) -> xr.Dataset:
    """All statistics of the flock by its own model."""
    return check(*flock, draws=19, seed=1).data


def test_every_statistic_has_values_units_and_a_verdict(checked):
    names = set(checked["statistic"].values)
    assert names == STATISTICS.keys() - WALLS
    assert "No distances to the wall: no walls are known." in checked.attrs["notes"]
    for name in names:
        own, drawn = checked[f"{name}_observed"], checked[f"{name}_replicated"]
        assert drawn.dims == ("draw", *own.dims)
        assert {"units", "long_name", "kind"} <= own.attrs.keys()
        for dim in own.dims:
            assert {"units", "long_name"} <= checked[dim].attrs.keys()
        if own.attrs["kind"] == "histogram":
            np.testing.assert_allclose(drawn.sum(own.dims), 1.0)
    assert np.isfinite(checked["p_value"]).all()
    assert (checked["p_adjusted"] >= checked["p_value"]).all()
    assert set(checked["verdict"].values) <= {"consistent", "borderline", "mismatch"}
    assert not checked["diverged"].any()
    assert checked.attrs["steps"] == 30
    assert checked.attrs["part"] == "all"


def test_numbers_of_the_recording_are_those_of_its_positions(flock, checked):
    position = flock[1]["position"].transpose("trial", "time", "individual", "space").to_numpy()
    # The first step of the run ends in frame 10.
    velocity = np.diff(position, axis=1)[:, 9:] * 10.0
    own = {name: float(checked[f"{name}_observed"]) for name in ("polarization", "amd")}
    assert own["polarization"] == pytest.approx(metrics.polarization(velocity).mean())
    assert own["amd"] == pytest.approx(metrics.amd(position[:, 10:]).mean())
    series = checked["series_observed"].sel(series="polarization")
    np.testing.assert_allclose(series.values, metrics.polarization(velocity))
    assert checked["series_replicated"].dims == ("series", "quantile", "run", "step")
    np.testing.assert_allclose(checked["ahead"], np.arange(1, 31) / 10.0)


def test_a_file_keeps_all_of_it(checked, tmp_path):
    checked.to_netcdf(tmp_path / "c.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "c.nc", engine="h5netcdf") as read:
        xr.testing.assert_identical(read.load().drop_attrs(), checked.drop_attrs())
        assert PredictiveCheck(read).verdict() == PredictiveCheck(checked).verdict()


def test_the_same_seed_gives_the_same(flock, checked):
    again = check(*flock, draws=19, seed=1, statistics=["amd", "speed"]).data
    for name in ("amd_replicated", "speed_replicated"):
        xr.testing.assert_equal(again[name], checked[name])
    other = check(*flock, draws=19, seed=2, statistics=["amd"]).data
    assert not other["amd_replicated"].equals(checked["amd_replicated"])


def test_tables_hold_what_the_dataset_holds(checked):
    result = PredictiveCheck(checked)
    summary = result.summary()
    assert set(summary.index) == set(checked["statistic"].values)
    assert summary.loc["amd", "observed"] == float(checked["amd_observed"])
    assert summary.loc["amd", "low"] < summary.loc["amd", "high"]
    assert np.isnan(summary.loc["speed", "observed"])
    assert summary["distance"].abs().is_monotonic_decreasing
    values = result.to_pandas().groupby("statistic").size()
    assert values["amd"] == 1
    assert values["speed"] == checked["speed_observed"].size
    assert values["neighbor_position"] == checked["neighbor_position_observed"].size


@pytest.fixture
def hurried(flock):
    """The flock seen through a clock that runs twice as fast: all move at half the speed."""
    fit, tracks = flock
    position = tracks["position"]
    middle = position.isel(time=0)
    return fit, tracks.assign(position=middle + 0.5 * (position - middle))


def test_a_wrong_model_is_found_out(hurried):
    found = check(*hurried, draws=99, statistics=["speed", "polarization", "displacement"]).data
    assert found["verdict"].sel(statistic="speed") == "mismatch"
    assert float(found["p_value"].sel(statistic="speed")) == pytest.approx(1 / 100)
    assert "(speeds" in PredictiveCheck(found).verdict()


def test_ones_own_statistics(flock):
    def fastest(swarm: ObservedSwarm) -> float:
        assert swarm.position.shape == swarm.velocity.shape == (1, 30, 5, 2)
        assert swarm.mask.all()
        assert swarm.fps == 10.0
        return float(np.nanmax(swarm.speed))

    def by_time(swarm: ObservedSwarm) -> np.ndarray:
        return metrics.amd(swarm.position)

    found = check(*flock, draws=19, statistics={"fastest": fastest, "by_time": by_time}).data
    assert found["fastest_observed"].attrs["kind"] == "number"
    assert found["by_time_observed"].attrs["kind"] == "curve"
    assert found["by_time_replicated"].dims == ("draw", "by_time_point_0", "by_time_point_1")
    assert found["fastest_observed"] == found["fastest_observed"].max()
    assert found["title"].values.tolist() == ["fastest", "by time"]


def test_a_histogram_of_ones_own(flock):
    halves = Statistic(
        "halves",
        "halves of the plane",
        lambda swarm: [(swarm.position[..., 0] < 0).mean(), (swarm.position[..., 0] >= 0).mean()],
        "histogram",
    )
    found = check(*flock, draws=19, statistics=[halves, "amd"]).data
    assert np.isfinite(found["hellinger"].sel(statistic="halves"))
    assert np.isnan(found["hellinger"].sel(statistic="amd"))


def test_walls_are_those_that_the_tracks_tell_else_those_given(flock):
    fit, tracks = flock
    names = sorted(WALLS)
    told = tracks.assign_attrs(arena="[[-9, -9], [9, 9]]")
    first = check(fit, told, draws=10, statistics=names).data
    assert "attribute arena" in first.attrs["walls"]
    second = check(fit, tracks, draws=10, statistics=names, walls=Arena.box([-9, -9], [9, 9])).data
    xr.testing.assert_equal(first["wall_angle_replicated"], second["wall_angle_replicated"])
    hull = check(fit, tracks, draws=10, statistics=names, walls="hull").data
    assert "biased towards 0" in hull.attrs["notes"]
    with pytest.raises(InputError, match="no walls are known"):
        check(fit, tracks, draws=10, statistics=names)
    with pytest.raises(InputError, match="attribute arena must hold corners"):
        check(fit, tracks.assign_attrs(arena="round"), draws=10)
    with pytest.raises(InputError, match="walls: give an Arena"):
        check(fit, tracks, draws=10, walls="brick")


def test_the_onset_of_a_wall_force_is_not_called_the_wall(flock):
    fit, tracks = flock
    soft = Arena.box([-9, -9], [9, 9], SOFT_WALLS)
    found = check(fit, tracks, draws=10, statistics=["wall_distance"], walls=soft).data
    assert found["title"].item() == "distances to the onset of the fitted wall force"
    assert "onset" in found["wall_distance_bin"].attrs["long_name"]
    tank = check(
        fit, tracks, draws=10, statistics=["wall_distance"], walls=Arena.box([-9, -9], [9, 9])
    )
    assert tank.data["title"].item() == "distances to the wall"


def test_replicates_that_diverge_count_against_the_fit(flock, monkeypatch):
    fit, tracks = flock
    plain = check(fit, tracks, draws=20, statistics=["amd", "speed", "displacement"]).data
    seen = replicates

    def some(*args):
        for index, positions in enumerate(seen(*args)):
            yield None if index < 15 else positions

    monkeypatch.setattr("swarmssm.analysis.diagnostics.checks.comparison.replicates", some)
    found = check(fit, tracks, draws=20, statistics=["amd", "speed", "displacement"]).data
    assert found["diverged"].sum() == 15
    assert np.isnan(found["amd_replicated"][:15]).all()
    # At most five replicates and itself are as far, on two sides.
    assert (found["p_value"].sel(statistic=["speed", "displacement"]) <= 6 / 21).all()
    assert float(found["p_value"].sel(statistic="amd")) <= 2 * 6 / 21
    assert (found["p_value"][:3].values <= plain["p_value"].values).all()
    diverged = found.sel(statistic="divergence")
    assert (float(diverged["p_value"]), diverged["verdict"].item()) == (
        pytest.approx(6 / 21),
        "mismatch",
    )
    assert "15 of 20 replicates diverged" in found.attrs["notes"]
    assert "divergence" in PredictiveCheck(found).verdict()


def test_every_other_frame(flock):
    found = check(*flock, draws=10, every=3, statistics={"n": lambda s: s.position.shape[1]}).data
    assert found["n_observed"] == 10
    fps = check(*flock, draws=10, every=3, statistics={"fps": lambda s: s.fps}).data["fps_observed"]
    assert float(fps) == pytest.approx(10 / 3)


def test_a_model_of_one_step_is_checked_too(quick_fit, boids):
    found = check(quick_fit, boids, draws=10, steps=15, statistics=["amd", "speed"]).data
    assert found.attrs["part"] == "test"
    assert found.sizes["run"] >= 1
    assert np.isfinite(found["amd_replicated"]).any()


def test_parameters_are_drawn_too(flock, monkeypatch):
    """The tracking noise of a replicate is that of its own draw of the parameters."""
    fit, tracks = flock
    predictor = type(fit.predictor())
    begin = predictor.begin

    def drawn(self, prepared, trials, rows, draws, *, carry=False):
        found = begin(self, prepared, trials, rows, draws, carry=carry)
        values = tuple({} for _ in range(draws))
        return dataclasses.replace(found, parameters=values) if draws else found

    monkeypatch.setattr(predictor, "begin", drawn)
    given = []

    def watched(self, values):
        given.append(values)
        return torch.no_grad()

    monkeypatch.setattr(type(fit), "with_parameters", watched)
    check(fit, tracks, draws=10, statistics=["amd"], walls="none")
    assert given == [{}] * 10


def failing(swarm):
    raise KeyError("speed")


def fickle(swarm):
    return np.zeros(1 + int(swarm.position[0, -1, 0, 0] * 1e6) % 97)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"draws": 5}, "draws: it must be at least 10"),
        ({"every": 0}, "every: it must be at least 1"),
        ({"seed": -1}, "seed"),
        ({"steps": 2}, "steps: a run needs at least 3"),
        ({"steps": 500}, "room for 30 steps"),
        ({"part": "test"}, "part"),
        ({"statistics": ["sped"]}, "'sped' is unknown. Choose of polarization"),
        ({"statistics": []}, "give at least one"),
        ({"statistics": ["amd", "amd"]}, "none twice"),
        ({"statistics": {"one": 3}}, "one must be a function"),
        ({"statistics": {"my own": len}}, "'my own' is no valid name"),
        ({"statistics": {"own": failing}}, "own failed with KeyError"),
        ({"statistics": {"own": lambda swarm: "fast"}}, "own failed with ValueError"),
        ({"statistics": {"own": fickle}}, "It must return the same for every swarm"),
        ({"statistics": [Statistic("a", "a", lambda s: [1.0, 2.0], "number")]}, "is said to be"),
    ],
)
def test_mistakes_are_told_in_plain_words(flock, options, words):
    with pytest.raises(InputError, match=words):
        check(*flock, **{"draws": 10, **options})


def test_a_statistic_of_an_unknown_kind_is_refused():
    with pytest.raises(InputError, match="choose one of number, curve, histogram"):
        Statistic("a", "a", len, "list")
