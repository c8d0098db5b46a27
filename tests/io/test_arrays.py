"""Plain numpy arrays: npz with xy, or X and A; npy."""

import json

import numpy as np
import pytest
from io_samples import MOTION, positions

from swarmssm.errors import InputError
from swarmssm.io import read
from swarmssm.tracks import states_of


def save(tmp_path, **arrays):
    path = tmp_path / "tracks.npz"
    np.savez(path, **arrays)
    return path


def test_xy_with_everything(tmp_path):
    path = save(
        tmp_path,
        xy=MOTION.astype(np.float32),
        time_s=np.arange(100, 106) / 25,
        frame=np.arange(100, 106),
        fps=25.0,
        id=np.array([3, 1, 40]),
        unit="cm",
        reliability=np.arange(18).reshape(6, 3),
        velocity_source=MOTION + 1,
        role=np.array(["a", "b", "c"]),
        temperature=np.arange(6.0),
        tank=np.array([[0, 0], [9, 9]]),
        origin=np.array([1.5, 2.5]),
        species="guppy",
        background=np.zeros((200, 200)),
    )
    tracks = read(path)
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert list(tracks["individual"].values) == ["3", "1", "40"]
    assert tracks["frame"].values.tolist() == list(range(100, 106))
    assert tracks["time"].values[0] == 4.0
    assert tracks.attrs["fps"] == 25
    assert tracks.attrs["unit"] == "cm"
    assert "velocity" not in tracks
    assert tracks["reliability"].dims == ("time", "individual")
    assert tracks["reliability"].to_numpy()[2, 1] == 7
    assert tracks["velocity_source"].dims == ("time", "space", "individual")
    np.testing.assert_array_equal(
        np.swapaxes(tracks["velocity_source"].to_numpy(), 1, 2), MOTION + 1
    )
    assert tracks["role"].dims == ("individual",)
    assert tracks["temperature"].dims == ("time",)
    assert tracks.attrs["tank"] == "[[0, 0], [9, 9]]"
    assert tracks.attrs["origin"].tolist() == [1.5, 2.5]
    assert tracks.attrs["species"] == "guppy"
    assert tracks.attrs["left_out_arrays"] == "background"


@pytest.mark.parametrize("rate", [{"fps": 10}, {"dt": 0.1}, {"params": json.dumps({"dt": 0.1})}])
def test_states_and_adjacency_of_trials(tmp_path, rate):
    generator = np.random.default_rng(0)
    states = generator.normal(size=(2, 5, 3, 4)).astype(np.float32)
    adjacency = (generator.random((2, 5, 3, 3)) < 0.5).astype(np.uint8)
    adjacency[..., range(3), range(3)] = 0
    tracks = read(save(tmp_path, X=states, A=adjacency, train=np.array([0, 1, 1]), **rate))
    np.testing.assert_array_equal(states_of(tracks), states.astype(np.float64))
    np.testing.assert_array_equal(tracks["adjacency"], adjacency)
    assert tracks["adjacency"].dims == ("trial", "time", "individual", "neighbor")
    assert tracks.attrs["fps"] == 10
    # Three numbers, as many as individuals: the name says that they are trials.
    assert tracks.attrs["train"].tolist() == [0, 1, 1]


def test_one_trial_of_states_in_three_dimensions(tmp_path):
    states = np.arange(60.0).reshape(5, 2, 6)
    tracks = read(save(tmp_path, X=states, fps=1))
    np.testing.assert_array_equal(states_of(tracks)[0], states)
    assert list(tracks["space"].values) == ["x", "y", "z"]


@pytest.mark.parametrize("params", ["not json", '"text"', '{"dt": "fast"}', '{"a": 1}'])
def test_settings_without_a_step(tmp_path, params):
    path = save(tmp_path, xy=MOTION, params=params)
    with pytest.raises(InputError, match="Add fps="):
        read(path)
    assert read(path, fps=3).attrs["params"] == params


def test_npy(tmp_path):
    np.save(tmp_path / "a.npy", MOTION)
    np.testing.assert_array_equal(positions(read(tmp_path / "a.npy", fps=5)), MOTION)
    np.save(tmp_path / "a.npy", np.asfortranarray(MOTION.astype(">f4")))
    np.testing.assert_array_equal(positions(read(tmp_path / "a.npy", fps=5)), MOTION)
    with pytest.raises(InputError, match="Add fps="):
        read(tmp_path / "a.npy")


def test_compressed(tmp_path):
    np.savez_compressed(tmp_path / "c.npz", xy=MOTION, fps=5)
    np.testing.assert_array_equal(positions(read(tmp_path / "c.npz")), MOTION)


def test_segments_become_trials(tmp_path):
    """Nothing is differenced from one drive to the next: velocities start anew in each."""
    xy = np.zeros((7, 1, 2))
    xy[:4, 0, 0] = [0, 1, 2, 3]
    xy[4:, 0, 0] = [500, 502, 504]
    path = save(
        tmp_path,
        xy=xy,
        segment=[5, 5, 5, 5, 8, 8, 8],
        time_s=[10, 10.5, 11, 11.5, 2, 2.5, 3],
        event=[1, 1, 1, 1, 2, 2, 2],
        role=np.array(["dog"]),
        fps=2.0,
    )
    tracks = read(path)
    assert dict(tracks.sizes) == {"trial": 2, "time": 4, "space": 2, "individual": 1}
    assert list(tracks["trial"].values) == ["5", "8"]
    speed = states_of(tracks)[:, :, 0, 2]
    np.testing.assert_array_equal(speed, [[np.nan, 2, 2, 2], [np.nan, 4, 4, np.nan]])
    np.testing.assert_array_equal(
        tracks["source_time"], [[10, 10.5, 11, 11.5], [2, 2.5, 3, np.nan]]
    )
    np.testing.assert_array_equal(tracks["event"], [[1, 1, 1, 1], [2, 2, 2, np.nan]])
    assert tracks["role"].dims == ("individual",)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"xy": MOTION[..., 0]}, r"xy has the shape \(6, 3\); it must be"),
        ({"xy": np.zeros((6, 3, 5))}, r"xy has the shape \(6, 3, 5\)"),
        ({"xy": np.zeros((6, 3, 4))}, r"xy has the shape \(6, 3, 4\)"),
        ({"xy": np.zeros((6, 0, 2))}, r"shape \(6, 0, 2\); they are none"),
        ({"xy": MOTION.astype(str)}, "xy holds <U32, not numbers"),
        ({"xy": MOTION * (1 + 1j)}, "xy holds complex128, not numbers"),
        ({"xy": MOTION[:1]}, "it has 1 frame; motion needs at least 2"),
        ({"xy": np.full((6, 3, 2), np.nan)}, "no individual has a position|have no position"),
        ({"xy": np.where(MOTION > 20, np.inf, MOTION)}, "individual 0 in row 0 is y = inf"),
        ({"xy": np.where(MOTION > 100, 2e12, MOTION)}, r"row 0 is y = 2e\+12"),
        ({"velocity": MOTION[:5]}, r"velocity has the shape \(5, 3, 2\) and position \(6, 3, 2\)"),
        (
            {"A": np.zeros((6, 3, 2))},
            r"adjacency has the shape \(6, 3, 2\); it must be \(6, 3, 3\)",
        ),
        ({"A": np.full((6, 3, 3), 2)}, "hold 0 and 1 only"),
        ({"A": np.ones((6, 3, 3))}, "an individual that sees itself"),
        ({"id": [1, 2]}, r"individuals has the shape \(2,\), and positions of shape"),
        ({"id": [1, 2, 1]}, "individual '1' stands there more than once"),
        ({"frame": [0, 1, 2, 2, 3, 4]}, r"frame in row 3 \(2\) repeats"),
        ({"frame": [0, 1, 2]}, r"frames has the shape \(3,\)"),
        ({"time_s": [0, 1, 2, 1, 3, 4]}, r"time in row 3 \(1\) falls below"),
        ({"time_s": [0, 1, 2, 3, 4, np.nan]}, "the time in row 5 is nan"),
        ({"time_s": np.arange(6) / 30}, "says 5 frames per second, but its times say 30"),
        ({"fps": 0.0}, "frames per second must lie between 0 and 1e"),
        ({"fps": np.nan}, "frames per second must lie between"),
        ({"fps": np.array([1.0, 2.0])}, "fps has the shape"),
        ({"fps": None, "dt": -0.1}, "dt is -0.1; it must be a positive number"),
        ({"segment": [0, 0, 0, 1, 1, 0]}, "segment '0' stands there more than once"),
        ({"segment": [0, 0, 0, 0, 0, 1]}, "segment 1: it has 1 frame"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, change, sentence):
    arrays = {"xy": MOTION, "fps": 5.0, **change}
    path = save(tmp_path, **{key: value for key, value in arrays.items() if value is not None})
    with pytest.raises(InputError, match=sentence) as caught:
        read(path)
    assert str(path) in str(caught.value)


def test_no_array_of_positions(tmp_path):
    with pytest.raises(InputError, match="holds the arrays a, b, and no tracks are recognised"):
        read(save(tmp_path, a=1, b=2))
    with pytest.raises(InputError, match="it has no array xy"):
        read(save(tmp_path, a=1, b=2), "arrays")


def test_rates_of_trials_in_the_sheep_recording(shared_data):
    path = shared_data / "sheep_dog" / "sheep_dog_events_1-2-3-4-5-6.npz"
    tracks = read(path)
    assert dict(tracks.sizes) == {"trial": 20, "time": 401, "space": 2, "individual": 16}
    assert tracks.attrs["fps"] == 10
    assert tracks.attrs["unit"] == "m"
    assert list(tracks["role"].values[[13, 14, 15]]) == ["sheep", "dog", "shepherd"]
    states = states_of(tracks)
    # "Inside drives no sheep exceeds 7 m/s"; across two drives there are jumps of tens of metres.
    assert np.nanmax(np.hypot(states[:, :, :14, 2], states[:, :, :14, 3])) < 7
    with np.load(path) as raw:
        lengths = np.unique(raw["segment"], return_counts=True)[1]
        known = np.isfinite(states[..., 0, 0])
        assert known.sum(1).tolist() == lengths.tolist()
        np.testing.assert_array_equal(
            positions(tracks)[3, :361].astype(np.float32), raw["xy"][raw["segment"] == 3]
        )


@pytest.mark.parametrize(
    ("name", "sizes", "fps", "missing"),
    [
        ("goats_gps/goats_gps.npz", (3600, 16), 1, None),
        ("guppies_trex8/guppies_trex8.npz", (200, 8), 25, 141),
        ("guppy_pair/guppy_pair_trial_b.npz", (9000, 2), 30, 0),
        ("sunbleak_trex/sunbleak_frames1200-1499.npz", (300, 1126), 40, None),
        ("zebrafish100_idtracker/zebrafish100_idtracker.npz", (300, 100), 32, None),
        ("zebrafish_idtracker8/zebrafish_idtracker8.npz", (508, 8), 28, None),
    ],
)
def test_real_recordings(shared_data, name, sizes, fps, missing):
    tracks = read(shared_data / name)
    assert (tracks.sizes["time"], tracks.sizes["individual"]) == sizes
    assert tracks.attrs["fps"] == fps
    with np.load(shared_data / name) as raw:
        np.testing.assert_array_equal(positions(tracks).astype(np.float32), raw["xy"])
        np.testing.assert_array_equal(tracks["frame"], raw["frame"])
        # Where camera times jitter they stand beside the grid.
        stamps = tracks["recorded_time"] if "recorded_time" in tracks else tracks["time"]
        np.testing.assert_allclose(stamps, raw["time_s"], rtol=0, atol=0.01 / fps)
        np.testing.assert_allclose(np.diff(tracks["time"]), 1 / fps, rtol=1e-6)
        assert tracks.attrs["unit"] == str(raw["unit"])
    if missing is not None:
        assert int(tracks["position"].isnull().all("space").sum()) == missing


def test_real_simulation(shared_data):
    path = shared_data / "boids_benchmark" / "boids.npz"
    tracks = read(path)
    assert tracks.attrs["fps"] == 10
    with np.load(path) as raw:
        np.testing.assert_array_equal(states_of(tracks), raw["X"].astype(np.float64))
        np.testing.assert_array_equal(tracks["adjacency"], raw["A"])
