"""The bundled clip: what is in it, that it is what its maker makes, and that its groups hold."""

import importlib.util
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from swarmssm import metrics
from swarmssm.datasets import load_sunbleak, load_sunbleak_groups
from swarmssm.errors import InputError
from swarmssm.tracks import validate_tracks

ROOT = Path(__file__).resolve().parents[2]
CLIP = resources.files("swarmssm").joinpath("data", "sunbleak.npz")
NAN = np.nan


@pytest.fixture(scope="module")
def maker():
    """The script that cut the clip, as a module."""
    path = ROOT / "benchmarks" / "make_sunbleak_clip.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def recording(shared_data):
    return shared_data / "sunbleak_trex" / "sunbleak_frames1200-1499.npz"


@pytest.fixture(scope="module")
def shoal():
    """All fish of the clip, (time, individual, 2)."""
    return load_sunbleak(None)["position"].transpose("time", "individual", "space").to_numpy()


def test_it_is_valid_tracks_of_ten_fish():
    tracks = load_sunbleak()
    assert dict(tracks.sizes) == {"time": 200, "space": 2, "individual": 10}
    assert tracks.attrs["fps"] == 40.0
    assert tracks.attrs["unit"] == "TRex cm"
    assert tracks.attrs["source_software"] == "TRex"
    assert tracks["frame"].to_numpy().tolist() == list(range(1200, 1400))
    np.testing.assert_allclose(tracks["time"], np.arange(1200, 1400) / 40)
    xr.testing.assert_identical(validate_tracks(tracks), tracks)


def test_licence_and_attribution_travel_with_the_tracks():
    attrs = load_sunbleak(2).attrs
    assert attrs["license"].startswith("CC BY 4.0, https://creativecommons.org/")
    for word in ("Walter, T., Albi, A., Bath, D., Couzin, I. D. et al.", "10.17617/3.4y"):
        assert word in attrs["attribution"]
    assert "389 of 1126" in attrs["changes"]
    text = resources.files("swarmssm").joinpath("data", "sunbleak_ATTRIBUTION.txt").read_text()
    for word in ("CC BY 4.0", "10.17617/3.4y", "389 of 1126", "Changes made"):
        assert word in text


def test_a_larger_group_holds_the_smaller_one():
    few, all_fish = load_sunbleak(7), load_sunbleak(None)
    assert all_fish.sizes["individual"] == 389
    xr.testing.assert_identical(few["position"], all_fish["position"][..., :7])
    assert len(set(all_fish["individual"].to_numpy())) == 389
    xr.testing.assert_identical(load_sunbleak(np.int64(7)), few)


@pytest.mark.parametrize("number", [0, -1, 390, 2.5, "10", NAN])
def test_a_number_of_fish_that_there_is_not(number):
    with pytest.raises(InputError, match="individuals: give a whole number from 1 to 389"):
        load_sunbleak(number)


def test_it_is_small_and_clean(shoal):
    assert len(CLIP.read_bytes()) <= 400_000
    present = np.isfinite(shoal).all(axis=-1)
    assert present.mean(axis=0).min() >= 0.9
    steps = np.linalg.norm(np.diff(shoal, axis=0), axis=-1)
    assert np.nanmax(steps) <= 5 * np.nanmedian(steps)
    edges = np.diff(np.pad(present.astype(int), ((1, 1), (0, 0))), axis=0).T
    runs = np.nonzero(edges == -1)[1] - np.nonzero(edges == 1)[1]
    assert runs.min() >= 5
    np.testing.assert_array_equal(shoal * 1024, np.round(shoal * 1024))


# Tracked, root mean square radius, median distance to the nearest member: the table of the
# docstring, to the digits printed there.
GROUPS = [(10, 0.989, 6.1, 2.6), (20, 0.986, 10.4, 2.9), (30, 0.984, 11.6, 3.2)]


@pytest.mark.parametrize(("number", "tracked", "radius", "nearest"), GROUPS)
def test_the_first_fish_are_a_group_away_from_the_walls(shoal, number, tracked, radius, nearest):
    group = shoal[:, :number]
    assert np.isfinite(group).all(axis=-1).mean() == pytest.approx(tracked, abs=0.0005)
    offset = group - np.nanmean(group, axis=1, keepdims=True)
    assert np.sqrt(np.nanmean((offset**2).sum(axis=-1))) == pytest.approx(radius, abs=0.05)
    median = np.nanmedian(metrics.nearest_neighbor_distance(group))
    assert median == pytest.approx(nearest, abs=0.05)
    # The tank spans about 3 to 119 and 3 to 122.
    assert np.nanmin(group) >= 13
    assert np.nanmax(group[..., 0]) <= 109
    assert np.nanmax(group[..., 1]) <= 112


@pytest.mark.parametrize(
    ("number", "first", "six"), [(10, 0.70, 0.54), (20, 0.65, 0.55), (30, 0.60, 0.57)]
)
def test_true_neighbours_are_inside_the_group(recording, number, first, six):
    """Against all fish seen in the recording, matched by the tracker's number."""
    with np.load(recording) as file:
        everyone, names = file["xy"][:200].astype(float), file["id"]
    tracks = load_sunbleak(number)
    group = np.isin(names, tracks["individual"].to_numpy().astype(int))
    assert group.sum() == number
    column = {str(name): index for index, name in enumerate(names)}
    inside = []
    for time, frame in enumerate(tracks["position"]):
        for fish in frame["individual"].to_numpy()[np.isfinite(frame[0].to_numpy())]:
            distance = np.linalg.norm(everyone[time] - everyone[time, column[fish]], axis=-1)
            distance[column[fish]] = NAN
            inside.append(group[np.argsort(distance)[:6]])  # NaN is sorted last
    assert np.mean(inside, axis=0)[0] == pytest.approx(first, abs=0.005)
    assert np.mean(inside) == pytest.approx(six, abs=0.005)


def test_the_clip_is_what_the_maker_makes(maker, recording, tmp_path, monkeypatch, capsys):
    made = tmp_path / "clip.npz"
    monkeypatch.setattr(sys, "argv", ["make", str(recording), str(made)])
    maker.main()
    assert "N = 10: tracked 98.9%" in capsys.readouterr().out
    with np.load(made) as new, CLIP.open("rb") as stream, np.load(stream) as old:
        assert new.files == old.files
        for name in old.files:
            np.testing.assert_array_equal(new[name], old[name], err_msg=name)


def test_positions_are_those_of_the_recording(recording, shoal):
    """To half the rounding of 1/1024, and nothing is there that was not."""
    with np.load(recording) as file:
        at = {name: index for index, name in enumerate(file["id"].tolist())}
        order = [at[int(name)] for name in load_sunbleak(None)["individual"].to_numpy()]
        original = file["xy"][:200, order].astype(float)
    there = np.isfinite(shoal)
    assert np.abs(shoal - original)[there].max() <= 0.5 / 1024
    lost = np.isfinite(original).all(-1) & ~there.all(-1)
    assert 0 < lost.mean() < 0.01  # blips alone


def test_short_runs_are_dropped(maker):
    track = np.array([1, 1, NAN, 1, 1, 1, NAN, 1, NAN, 1, 1, 1.0])
    positions = np.stack([track, np.ones(12)], axis=-1)[:, None]
    kept = maker.drop_short_runs(positions, 3)[:, 0, 0]
    expected = [NAN, NAN, NAN, 1, 1, 1, NAN, NAN, NAN, 1, 1, 1]
    np.testing.assert_array_equal(kept, expected)


def test_neighbours_are_counted_among_everyone_seen(maker):
    line = np.array([[[0.0, 0], [1, 0], [3, 0], [9, 0]]] * 2)
    line[1, 1] = NAN  # in the second frame the first sees past the second
    present = np.isfinite(line).all(-1)
    present[:, 3] = False  # seen by others, itself not counted
    expected = [[0, 1, 1, 0], [1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 0, 0]]
    np.testing.assert_array_equal(maker.neighbor_counts(line, present, 1), expected)


def test_the_order_starts_with_the_tightest_group(maker):
    # 2, 4 and 5 are bound to each other (4 most), 0 to them more loosely than 3; 1 to nobody.
    counts = np.zeros((6, 6), dtype=np.int64)
    for i, j, bond in [(2, 4, 9), (4, 5, 8), (2, 5, 5), (3, 4, 4), (0, 2, 2), (0, 3, 1)]:
        counts[i, j] = bond
    everyone = np.ones(6, dtype=bool)
    # Peeled from the three: 5 (13), then of 2 and 4 (9 each) the lower index.
    assert maker.group_order(counts, 3, everyone) == [4, 2, 5, 3, 0, 1]
    # Without 4 the best pair is 2 and 5; 4 is not lost, only later.
    eligible = np.array([True, True, True, True, False, True])
    assert maker.group_order(counts, 2, eligible) == [5, 2, 4, 3, 0, 1]


def test_swaps_leave_a_seed_that_does_not_belong(maker):
    # Grown from 0, the group is {0, 1}; the best pair is {2, 3}, which swaps reach one by one.
    bonds = np.array([[0, 3, 2, 0], [3, 0, 4, 0], [2, 4, 0, 9], [0, 0, 9, 0]])
    assert maker._grown(bonds, 0, 2).tolist() == [False, False, True, True]


def test_groups_share_no_fish_and_are_compact():
    tracks = load_sunbleak_groups(10, 8)
    assert tracks["position"].dims == ("trial", "time", "space", "individual")
    assert dict(tracks.sizes) == {"trial": 8, "time": 200, "space": 2, "individual": 10}
    fish = tracks["fish"].to_numpy()
    assert len(set(fish.ravel())) == 80
    np.testing.assert_array_equal(fish[0], load_sunbleak(10)["individual"])
    np.testing.assert_array_equal(tracks["frame"], load_sunbleak(10)["frame"])
    # Ten fish drawn at random from the shoal are spread over the whole tank.
    shoal = load_sunbleak(None)
    by_number = shoal["position"].sel(individual=fish[3])
    np.testing.assert_array_equal(tracks["position"][3], by_number)
    spread = tracks["position"].std("individual").mean(("time", "space"))
    assert float(spread.max()) < float(shoal["position"].std("individual").mean()) / 4
    assert tracks.attrs["license"] == shoal.attrs["license"]


def test_each_group_is_the_tightest_of_the_fish_left():
    tracks = load_sunbleak_groups(3, 2)
    shoal = load_sunbleak(None).isel(individual=slice(3, None))
    position = shoal["position"].transpose("time", "individual", "space").to_numpy()
    apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    mean = np.nanmean(apart, axis=0)
    best = np.inf
    for seed in mean:
        group = np.argsort(seed, kind="stable")[:3]
        spread = mean[np.ix_(group, group)].sum()
        if spread < best:
            best, members = spread, group
    expected = set(shoal["individual"].to_numpy()[members])
    assert set(tracks["fish"].to_numpy()[1]) == expected


@pytest.mark.parametrize(("individuals", "groups"), [(10, 39), (1, 3), (10, 0)])
def test_groups_that_there_are_not(individuals, groups):
    with pytest.raises(InputError, match="groups"):
        load_sunbleak_groups(individuals, groups)
