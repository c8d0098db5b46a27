"""Force maps: hand-worked pairs, a constructed rule, errors, agreement with raw data."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr

from swarmssm import simulate
from swarmssm.analysis.interpretation.forces.map_bins import Portion, binned, labelled
from swarmssm.analysis.interpretation.forces.maps import (
    default_extent,
    force_map,
    force_map_agreement,
    force_maps,
    raw_force_map,
)
from swarmssm.analysis.interpretation.forces.parabolas import parabola, shortest_window
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks

Make = Callable[..., Any]
MAPS = ("turning", "speeding")


def pair(heading: tuple[float, float], other: tuple[float, float]) -> xr.Dataset:
    """Return two frames of one who heads somewhere, and sees another who rests."""
    position = np.array([[[0.0, 0.0], other]] * 2)
    velocity = np.array([[heading, (0.0, 0.0)]] * 2)
    graph = np.array([[[0, 1], [1, 0]]] * 2)
    return make_tracks(position, fps=10, velocity=velocity, adjacency=graph, unit="cm")


@pytest.mark.parametrize(
    ("heading", "other", "place"),
    [
        ((0.0, 1.0), (2.0, 0.0), {"left_right": 2.0, "front_back": 0.0}),
        ((0.0, 1.0), (0.0, -2.0), {"left_right": 0.0, "front_back": -2.0}),
        ((1.0, 0.0), (0.0, 2.0), {"left_right": -2.0, "front_back": 0.0}),
    ],
)
def test_a_pair_by_hand(
    heading: Any, other: Any, place: dict[str, float], make_fit: Make, make_law: Make
) -> None:
    tracks = pair(heading, other)
    fit = make_fit(tracks, make_law(separation_gain=0.0, alignment_gain=0.0))
    found = force_map(fit, tracks, draws=1, bins=5, extent=2.5, symmetric=False)
    assert found["count"].sum() == 2  # who rests has no heading
    there = found.sel(place)
    # Pulled by half the distance, to where the other is.
    assert float(there["turning"]) == pytest.approx(0.5 * place["left_right"], abs=1e-5)
    assert float(there["speeding"]) == pytest.approx(0.5 * place["front_back"], abs=1e-5)
    assert found["turning"].attrs["units"] == "cm/s^2"


def test_right_is_right_where_y_grows_downwards(make_fit: Make, make_law: Make) -> None:
    """In a video, who swims to the right and has another below it, has it to its right."""
    tracks = pair((1.0, 0.0), (0.0, 2.0)).assign_attrs(y_axis="down")
    fit = make_fit(tracks, make_law(separation_gain=0.0, alignment_gain=0.0))
    found = force_map(fit, tracks, draws=1, bins=5, extent=2.5, symmetric=False)
    assert found["count"].sum() == 2
    there = found.sel(left_right=2.0, front_back=0.0)
    assert float(there["turning"]) == pytest.approx(1.0, abs=1e-5)
    walk = np.random.default_rng(0).normal(size=(200, 4, 2)).cumsum(0)
    up = make_tracks(walk, fps=10)
    options = {"bins": 5, "extent": 20.0, "symmetric": False, "window": 5}
    one, other = (raw_force_map(t, **options) for t in (up, up.assign_attrs(y_axis="down")))
    assert float(abs(one["turning"]).sum()) > 0
    np.testing.assert_allclose(other["turning"], -one["turning"][:, ::-1])
    np.testing.assert_allclose(other["speeding"], one["speeding"][:, ::-1])


def test_map_of_a_pull_is_the_place_itself(make_fit: Make, make_law: Make) -> None:
    pull: dict[str, Any] = {"separation_gain": 0.0, "alignment_gain": 0.0}
    tracks = simulate.simulate_boids(
        2,
        100,
        20,
        seed=3,
        graph="complete",
        wall_gain=0.0,
        min_speed=0.0,
        max_speed=3.0,
        noise="additive",
        process_noise=0.3,
        **pull,
    )
    maps = force_maps(make_fit(tracks, make_law(**pull)), tracks, draws=1, bins=7, extent=2.1)
    # Within a bin of width 0.6 the place is anywhere, and half of it is the pull.
    model = maps.sel(source="model").where(maps["count"].sel(source="model") > 0)
    assert int(model["turning"].count()) > 40
    for name, place in (("turning", "left_right"), ("speeding", "front_back")):
        assert float(np.abs(model[name] - 0.5 * model[place]).max()) < 0.15 + 1e-5
    # In the data there is noise as well.
    assert int(maps["num_bins"]) > 20
    assert float(maps["correlation"].min()) > 0.95
    np.testing.assert_allclose(maps["slope"], 1.0, atol=0.15)


def test_a_symmetric_map_is_its_own_mirror_image(packed_boids: xr.Dataset) -> None:
    found = raw_force_map(packed_boids, bins=6)
    mirrored = found.isel(left_right=slice(None, None, -1))
    np.testing.assert_allclose(found["turning"], -mirrored["turning"], atol=1e-12)
    np.testing.assert_allclose(found["speeding"], mirrored["speeding"], atol=1e-12)
    plain = raw_force_map(packed_boids, bins=6, symmetric=False)
    np.testing.assert_allclose(
        found["count"], plain["count"].to_numpy() + plain["count"].to_numpy()[:, ::-1]
    )


def test_maps_turn_with_the_group_and_are_mirrored_with_it(packed_boids: xr.Dataset) -> None:
    position = packed_boids["position"].transpose("trial", "time", "individual", "space").to_numpy()
    options: dict[str, Any] = {"bins": 6, "extent": 3.0, "symmetric": False, "window": 3}
    plain = raw_force_map(packed_boids, **options)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    turned = raw_force_map(make_tracks(position @ turn.T, fps=10), **options)
    flipped = raw_force_map(make_tracks(position * [1.0, -1.0], fps=10), **options)
    for name in MAPS:
        np.testing.assert_allclose(turned[name], plain[name], atol=1e-6)
    mirror = flipped.isel(left_right=slice(None, None, -1))
    np.testing.assert_allclose(mirror["turning"], -plain["turning"], atol=1e-6)
    np.testing.assert_allclose(mirror["speeding"], plain["speeding"], atol=1e-6)


def test_standard_errors_are_those_of_blocks() -> None:
    # Forty frames in twenty blocks; both frames of a block have the same speeding.
    rng = np.random.default_rng(0)
    level = np.repeat(rng.normal(size=20), 2)
    states = np.zeros((40, 2, 4))
    states[:, 0, 3] = 1.0  # heads up
    states[:, 1, 1] = 1.0  # stands ahead of it
    acceleration = np.zeros((40, 2, 2))
    acceleration[:, 0, 1] = level
    there = np.ones((40, 2, 2), dtype=bool)
    portions = [Portion(slice(0, 40), states, acceleration, there)]
    sums = binned(iter(portions), 40, 3, 1.5, False)
    found = labelled([sums], 3, 1.5, False, "all", "cm", "raw").sel(front_back=1.0, left_right=0.0)
    assert float(found["speeding"]) == pytest.approx(level.mean())
    expected = level[::2].std(ddof=1) / np.sqrt(20)
    assert float(found["speeding_error"]) == pytest.approx(expected)
    assert float(found["count"]) == 40
    assert float(found["num_blocks"]) == 20
    both = labelled([sums, sums], 3, 1.5, False, "all", "cm", "model")
    assert float(both["speeding_error"].sel(front_back=1.0, left_right=0.0)) == pytest.approx(
        expected
    )


def test_only_those_who_are_seen(make_fit: Make, make_law: Make) -> None:
    tracks = pair((0.0, 1.0), (2.0, 0.0))
    blind = tracks.assign(adjacency=0 * tracks["adjacency"])
    fit = make_fit(tracks, make_law())
    options: dict[str, Any] = {"bins": 5, "extent": 2.5, "neighbors": "seen"}
    assert force_map(fit, tracks, draws=1, **options)["count"].sum() == 4
    assert force_map(fit, blind, draws=1, **options)["count"].sum() == 0
    assert raw_force_map(free_walk(), bins=5, extent=9.0, window=3)["count"].sum() > 0
    with pytest.raises(InputError, match="adjacency"):
        raw_force_map(free_walk(), neighbors="seen")


def free_walk() -> xr.Dataset:
    """Return two who walk straight, beside each other."""
    time = np.arange(10.0)[:, None, None]
    start = np.array([[0.0, 0.0], [1.0, 0.0]])
    return make_tracks(start + time * np.array([0.0, 0.5]), fps=10)


def test_parabolas_are_exact_on_parabolas() -> None:
    time = np.arange(12) / 20.0
    position = np.stack([1 + 2 * time - 3 * time**2, 0.5 * time**2], -1)[None, :, None]
    states, acceleration = parabola(position, 20.0, 5)
    assert np.isnan(states[0, :2]).all()
    assert np.isnan(states[0, -2:]).all()
    np.testing.assert_allclose(acceleration[0, 2:-2, 0], np.tile([-6.0, 1.0], (8, 1)), atol=1e-9)
    np.testing.assert_allclose(states[0, 2:-2, 0, 2], (2 - 6 * time)[2:-2], atol=1e-9)
    np.testing.assert_allclose(states[0, 2:-2, 0, :2], position[0, 2:-2, 0], atol=1e-9)
    position[0, 6] = np.nan
    missing = np.isnan(parabola(position, 20.0, 5)[1][0, :, 0, 0])
    np.testing.assert_array_equal(np.flatnonzero(~missing), [2, 3, 9])


def test_noisy_tracks_are_smoothed_over_more_frames() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(400) / 10.0
    circle = np.stack([np.cos(time), np.sin(time)], -1)[None, :, None]
    assert shortest_window(circle, 10.0) == 3
    noisy = circle + 0.02 * rng.normal(size=circle.shape)
    window = shortest_window(noisy, 10.0)
    assert 5 <= window <= 11
    acceleration = parabola(noisy, 10.0, window)[1]
    error = acceleration + circle
    # Half of what is seen may be noise: of 1 / sqrt(2) in each coordinate, and a little flattening.
    assert np.sqrt(np.nanmean(error**2)) < 0.5


def test_tracking_noise_feigns_no_brake() -> None:
    rng = np.random.default_rng(1)
    walk = free_walk()["position"].transpose("time", "individual", "space").to_numpy()
    longer = np.concatenate([walk + 5.0 * step * np.array([0.0, 1.0]) for step in range(300)])
    noisy = make_tracks(longer + 0.05 * rng.normal(size=longer.shape), fps=10)
    found = raw_force_map(noisy, bins=3, extent=1.5, window=5)
    side = found.sel(front_back=0.0, left_right=1.0)
    assert float(side["count"]) > 1000
    assert abs(float(side["speeding"])) < 4 * float(side["speeding_error"])


def planted(values: np.ndarray, error: float = 0.0, count: float = 100.0) -> xr.Dataset:
    """Return a map with these values for turning and for speeding."""
    over = ("front_back", "left_right")
    middles = np.arange(values.shape[0]) - 1.0
    data = dict.fromkeys(MAPS, (over, values))
    data |= {f"{name}_error": (over, np.full(values.shape, error)) for name in MAPS}
    data["count"] = (over, np.full(values.shape, count))
    data["num_blocks"] = (over, np.full(values.shape, 20))
    return xr.Dataset(data, dict.fromkeys(over, middles))


def test_agreement_by_hand() -> None:
    values = np.arange(9.0).reshape(3, 3)
    found = force_map_agreement(planted(values), planted(2 * values + 1, error=1.0))
    np.testing.assert_allclose(found["correlation"], 1.0)
    np.testing.assert_allclose(found["slope"], 2.0)
    # The variance of the raw map is 4 * 60 / 9.
    np.testing.assert_allclose(found["reliability"], 1 - 9 / 240)
    assert found["num_bins"] == 9
    few = force_map_agreement(planted(values), planted(values, count=5.0))
    assert np.isnan(few["correlation"]).all()
    assert few["num_bins"] == 0
    with pytest.raises(InputError, match="bins"):
        force_map_agreement(planted(values), planted(np.zeros((4, 4))))


def test_default_extent_is_four_nearest_distances() -> None:
    assert default_extent(free_walk()) == pytest.approx(4.0)


def test_errors(packed_boids: xr.Dataset, make_fit: Make, make_law: Make) -> None:
    solid = simulate.simulate_boids(3, 10, space=3, seed=0)
    with pytest.raises(InputError, match="two dimensions"):
        raw_force_map(solid)
    with pytest.raises(InputError, match="two dimensions"):
        force_map(make_fit(solid, make_law(space=3)), solid)
    with pytest.raises(InputError, match="bins"):
        raw_force_map(packed_boids, bins=1)
    with pytest.raises(InputError, match="extent"):
        raw_force_map(packed_boids, extent=-1.0)
    with pytest.raises(InputError, match="neighbors"):
        raw_force_map(packed_boids, neighbors="some")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="odd"):
        raw_force_map(packed_boids, window=4)
    with pytest.raises(InputError, match="window"):
        raw_force_map(packed_boids, window=1)
    alone = packed_boids.isel(individual=[0]).drop_vars(["adjacency", "neighbor"])
    with pytest.raises(InputError, match="never two"):
        default_extent(alone)
