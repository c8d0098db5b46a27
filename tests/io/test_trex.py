"""TRex's npz files: values, alignment on frames, names, versions, and what is refused."""

import numpy as np
import pytest
from io_samples import MOTION, positions, trex_arrays, write_trex

from swarmssm.errors import InputError
from swarmssm.io import read, read_trex


def test_motion_comes_back(tmp_path):
    tracks = read(write_trex(tmp_path))
    # Written as float32, in which all these numbers are exact.
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["fps"] == 25
    assert tracks.attrs["fps_source"] == "time"
    assert tracks.attrs["unit"] == "cm"
    assert tracks.attrs["source_software"] == "TRex"
    assert tracks.attrs["centroid"] == "wcentroid"
    assert list(tracks["individual"].values) == ["0", "1", "2"]
    assert "velocity" not in tracks


def test_version_2_states_its_settings(tmp_path):
    write_trex(tmp_path, names=("id0", "id1", "id2"), version=2, time=None)
    tracks = read(tmp_path)
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["fps"] == 25
    assert tracks.attrs["fps_source"] == "file"
    assert tracks.attrs["cm_per_pixel"] == 0.5
    assert "recorded_time" not in tracks


def test_individuals_are_aligned_on_the_frame_and_ordered_by_number(tmp_path):
    # Fish 10 is seen in frames 103 to 108, fish 9 in 100 to 105, and there is no fish between.
    np.savez(tmp_path / "a.b_c_fish10.npz", **trex_arrays(0, first=103))
    np.savez(tmp_path / "a.b_c_fish9.npz", **trex_arrays(2, first=100))
    tracks = read(tmp_path)
    assert list(tracks["individual"].values) == ["9", "10"]
    assert list(tracks["frame"].values) == list(range(100, 109))
    assert tracks["time"].values[0] == 4.0
    xy = positions(tracks)
    np.testing.assert_array_equal(xy[:6, 0], MOTION[:, 2])
    np.testing.assert_array_equal(xy[3:, 1], MOTION[:, 0])
    assert np.isnan(xy[6:, 0]).all()
    assert np.isnan(xy[:3, 1]).all()


def test_missing_rules_over_a_position_that_was_filled_in(tmp_path):
    missing = np.array([0, 0, 1, 0, 0, 0], dtype=np.float32)
    np.savez(tmp_path / "v_fish0.npz", **trex_arrays(0, missing=missing))
    xy = positions(read(tmp_path))
    assert np.isnan(xy[2]).all()
    assert np.isfinite(xy[[0, 1, 3, 4, 5]]).all()


def test_optional_arrays_may_be_absent(tmp_path):
    bare = {key: trex_arrays(0)[key] for key in ("X#wcentroid", "Y#wcentroid", "frame")}
    np.savez(tmp_path / "v_fish0.npz", **bare)
    with pytest.raises(InputError, match=r"does not tell its frames per second. Add fps="):
        read(tmp_path)
    tracks = read(tmp_path, fps=50)
    assert tracks.attrs["fps"] == 50
    assert tracks.attrs["fps_source"] == "argument"
    np.testing.assert_array_equal(positions(tracks)[:, 0], MOTION[:, 0])


def test_the_callers_rate_rules_and_the_other_is_kept(tmp_path):
    tracks = read(write_trex(tmp_path), fps=50)
    assert tracks.attrs["fps"] == 50
    assert tracks.attrs["fps_in_file"] == 25
    np.testing.assert_allclose(tracks["time"], np.arange(6) / 50)


def test_centroids(tmp_path):
    head = {"X": np.arange(6, dtype=np.float32), "Y": np.full(6, 7, dtype=np.float32)}
    posture = {"X#pcentroid": np.full(6, 3, np.float32), "Y#pcentroid": np.full(6, 4, np.float32)}
    np.savez(tmp_path / "v_fish0.npz", **trex_arrays(0, **head, **posture))
    np.testing.assert_array_equal(positions(read(tmp_path))[:, 0], MOTION[:, 0])
    np.testing.assert_array_equal(positions(read(tmp_path, centroid="head"))[:, 0, 0], np.arange(6))
    assert positions(read(tmp_path, centroid="pcentroid"))[0, 0].tolist() == [3, 4]
    with pytest.raises(InputError, match="no array X#centroid"):
        read(tmp_path, centroid="centroid")
    with pytest.raises(InputError, match="wcentroid, centroid, pcentroid, head"):
        read(tmp_path, centroid="tail")


def test_the_next_best_centroid_is_taken_and_named(tmp_path):
    arrays = trex_arrays(0)
    renamed = {key.replace("#wcentroid", "#pcentroid"): value for key, value in arrays.items()}
    np.savez(tmp_path / "v_fish0.npz", **renamed)
    tracks = read(tmp_path)
    assert tracks.attrs["centroid"] == "pcentroid"
    np.testing.assert_array_equal(positions(tracks)[:, 0], MOTION[:, 0])


def test_a_head_without_posture_is_refused(tmp_path):
    with pytest.raises(InputError, match="TRex had no posture"):
        read(write_trex(tmp_path), centroid="head")


def test_custom_names_and_companion_files(tmp_path):
    write_trex(tmp_path, names=("alice", "bob", "fish2"), video="my_video.1")
    for name in ("posture_fish2", "recognition_x", "statistics", "memory", "global_memory"):
        np.savez(tmp_path / f"my_video.1_{name}.npz", frames=np.arange(3))
    (tmp_path / "my_video.1_tracklet_images.npz").write_bytes(b"not read")
    (tmp_path / "my_video.1_heatmap_1_2.npz").write_bytes(b"not read")
    tracks = read(tmp_path)
    assert list(tracks["individual"].values) == ["2", "alice", "bob"]
    np.testing.assert_array_equal(positions(tracks)[:, 1], MOTION[:, 0])


def test_names_that_are_numbered_but_not_by_the_usual_prefix(tmp_path):
    write_trex(tmp_path, names=("id0", "id1", "bob7"), version=2)
    assert list(read(tmp_path)["individual"].values) == ["0", "1", "bob7"]


def test_a_single_file(tmp_path):
    tracks = read(write_trex(tmp_path) / "video_fish2.npz")
    assert list(tracks["individual"].values) == ["2"]
    np.testing.assert_array_equal(positions(tracks)[:, 0], MOTION[:, 2])


def test_individuals_never_tracked_are_dropped_and_named(tmp_path):
    write_trex(tmp_path)
    lost = np.ones(6, dtype=np.float32)
    np.savez(tmp_path / "video_fish7.npz", **trex_arrays(0, missing=lost))
    tracks = read(tmp_path)
    assert list(tracks["individual"].values) == ["0", "1", "2"]
    assert tracks.attrs["left_out_individuals"] == "7"
    assert read(tmp_path, empty="keep").sizes["individual"] == 4
    with pytest.raises(InputError, match="individual 7 has no position in any frame"):
        read(tmp_path, empty="refuse")


def test_two_recordings(tmp_path):
    write_trex(tmp_path, video="first")
    write_trex(tmp_path, video="second", names=("fish0",))
    with pytest.raises(InputError, match=r"2 recordings, first \(3 files\), second \(1 files\)"):
        read(tmp_path)
    assert read(tmp_path, video="first").sizes["individual"] == 3
    assert read(tmp_path, video="second").sizes["individual"] == 1
    with pytest.raises(InputError, match="no recording called third, but first, second"):
        read(tmp_path, video="third")


def test_two_exports_of_one_individual(tmp_path):
    write_trex(tmp_path, names=("fish0", "fish1"))
    write_trex(tmp_path, names=("id0",), version=2)
    with pytest.raises(InputError, match=r"video_fish0.npz and video_id0.npz are both of individu"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"frame": np.array([0, 1, 1, 2, 3, 4], np.float32)}, r"frame in row 2 is 1; .*increase"),
        ({"frame": np.array([0, 1, 2.5, 3, 4, 5], np.float32)}, "frame in row 2 is 2.5"),
        ({"frame": np.full(6, np.inf, np.float32)}, "frame in row 0 is inf"),
        ({"Y#wcentroid": np.zeros(5, np.float32)}, "Y#wcentroid has 5 rows and frame has 6"),
        ({"Y#wcentroid": np.zeros((6, 2), np.float32)}, "must have 1 dimension"),
        ({"Y#wcentroid": np.array(["a"] * 6)}, "Y#wcentroid holds <U1, not numbers"),
        ({"X#wcentroid": np.full(6, 1e13, np.float32)}, r"individual 0 in row 0 is x = 1e\+13"),
        (
            {key: np.zeros(0, np.float32) for key in trex_arrays(0) if key != "frame_segments"},
            "no frame",
        ),
        ({"frame_rate": np.array([0.0])}, "frames per second must lie between 0 and 1e"),
        ({"frame_rate": np.array([25.0, 30.0])}, "frame_rate must hold one number"),
    ],
)
def test_damage_is_named(tmp_path, change, sentence):
    np.savez(tmp_path / "v_fish0.npz", **trex_arrays(0, **change))
    with pytest.raises(InputError, match=sentence) as caught:
        read(tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_files_that_disagree(tmp_path):
    write_trex(tmp_path, names=("id0",), version=2)
    np.savez(tmp_path / "video_id1.npz", **trex_arrays(1, version=2, fps=30.0))
    with pytest.raises(InputError, match=r"video_id0.npz has frame_rate 25 and video_id1.npz has"):
        read(tmp_path)


def test_one_frame_is_no_motion(tmp_path):
    write_trex(tmp_path, motion=MOTION[:1])
    with pytest.raises(InputError, match="it has 1 frame; motion needs at least 2"):
        read(tmp_path)


def test_frames_far_apart_do_not_fill_the_memory(tmp_path):
    frame = np.array([0, 1, 2, 3, 4, 2**24], dtype=np.float32)
    for number in range(200):
        np.savez(tmp_path / f"v_fish{number}.npz", **trex_arrays(0, frame=frame))
    with pytest.raises(InputError, match=r"would take \d+ GB, and this machine has"):
        read(tmp_path)


def test_half_a_pair(tmp_path):
    np.savez(tmp_path / "v_fish0.npz", **trex_arrays(0, **{"Y#wcentroid": None, "Y": None}))
    with pytest.raises(InputError, match="no tracks were found in this folder"):
        read(tmp_path)
    for visual_field in (None, False):
        with pytest.raises(InputError, match=r"holds no npz file of TRex"):
            read(tmp_path, "trex", visual_field=visual_field)


def test_a_folder_above(tmp_path):
    write_trex(tmp_path / "data")
    with pytest.raises(InputError, match=r"TRex's files lie in its folder data. Name .*data"):
        read(tmp_path)


def test_real_files(shared_data):
    folder = shared_data / "sunbleak_trex"
    tracks = read_trex(folder / "trex_npz")
    numbers = [1, 3, 4, 10, 25, 46, 52, 611, 629, 999]
    assert list(tracks["individual"].values) == [str(number) for number in numbers]
    assert dict(tracks.sizes) == {"time": 296, "space": 2, "individual": 10}
    # Frames 1200 to 1495; fish 1 is first seen in 1205, at (91.06612, 49.83135).
    assert tracks["frame"].values[[0, -1]].tolist() == [1200, 1495]
    first = positions(tracks)[5, 0]
    np.testing.assert_allclose(first, [91.06612, 49.83135], rtol=0, atol=5e-6)
    # Sum of `missing` over the ten files: 120 + 234 + 117 + 245; the rest of 2960 lies outside.
    rows = 284 + 287 + 286 + 282 + 283 + 287 + 284 + 287 + 288 + 295
    assert int(tracks["position"].notnull().all("space").sum()) == rows - (120 + 234 + 117 + 245)
    assert tracks.attrs["fps"] == 40
    # The same recording, stacked into one array by someone else: frames 1210 to 1488 are in all.
    with np.load(folder / "sunbleak_frames1200-1499.npz") as stacked:
        columns = [list(stacked["id"]).index(number) for number in numbers]
        np.testing.assert_array_equal(
            positions(tracks)[10:289].astype(np.float32), stacked["xy"][10:289][:, columns]
        )
