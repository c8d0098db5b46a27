"""Directed adjacency from TRex's visual fields. No real file could be had: see io_samples."""

import numpy as np
import pytest
from io_samples import MOTION, positions, visual_field_arrays, write_trex, write_visual_field

from swarmssm.errors import InputError
from swarmssm.io import read

# Whom each individual sees in frames 0, 1, ... of its own list of frames with posture.
SEEN = {
    0: ([0, 1, 2, 3, 4, 5], [[1], [1, 2], [], [2], [1], [1]]),
    1: ([0, 2, 3], [[2], [0, 2], [0]]),
    2: ([0, 1, 2, 3, 4, 5], [[], [0], [0, 1], [], [], [1]]),
}


def expected():
    adjacency = np.zeros((6, 3, 3), dtype=np.uint8)
    known = np.zeros((6, 3), dtype=np.uint8)
    for own, (frames, seen) in SEEN.items():
        for frame, others in zip(frames, seen, strict=True):
            known[frame, own] = 1
            adjacency[frame, own, others] = 1
    return adjacency, known


@pytest.fixture(params=["v1", "v2", "split"])
def folder(tmp_path, request):
    version = 1 if request.param == "v1" else 2
    prefix = "fish" if version == 1 else "id"
    write_trex(tmp_path, names=[f"{prefix}{n}" for n in range(3)], version=version)
    for own, (frames, seen) in SEEN.items():
        arrays = visual_field_arrays(own, seen, frames, version=version)
        write_visual_field(tmp_path, f"{prefix}{own}", arrays, split=request.param == "split")
    return tmp_path


def test_adjacency_is_whom_a_ray_meets_first(folder):
    tracks = read(folder)
    adjacency, known = expected()
    assert tracks["adjacency"].dims == ("time", "individual", "neighbor")
    assert tracks["adjacency"].dtype == np.uint8
    # The own body (first two rays) and individual 0 behind the first (layer 1) are no edges.
    np.testing.assert_array_equal(tracks["adjacency"], adjacency)
    np.testing.assert_array_equal(tracks["adjacency_known"], known)
    # Individual 1 was tracked in frames 1, 4, 5 too, without posture.
    assert tracks.attrs["adjacency_unknown_rows"] == 3
    assert "adjacency_strangers" not in tracks.attrs
    np.testing.assert_array_equal(positions(tracks), MOTION)


def test_it_can_be_left_out(folder):
    assert "adjacency" not in read(folder, visual_field=False)
    with pytest.raises(InputError, match="choose True, False or auto"):
        read(folder, visual_field="yes")


def test_columns_follow_individuals_whose_numbers_have_holes(tmp_path):
    write_trex(tmp_path, names=("fish40", "fish7", "fish12"))
    write_visual_field(tmp_path, "fish40", visual_field_arrays(40, [[7], [12, 99]], [1, 3]))
    write_visual_field(tmp_path, "fish7", visual_field_arrays(7, [[40]], [5]))
    tracks = read(tmp_path)
    assert list(tracks["individual"].values) == ["7", "12", "40"]
    edges = [tuple(edge) for edge in np.argwhere(tracks["adjacency"].to_numpy())]
    assert edges == [(1, 2, 0), (3, 2, 1), (5, 0, 2)]
    # 99 has no file of its own, and 0 stands only in layer 1.
    assert tracks.attrs["adjacency_strangers"] == "99"


def test_a_hit_without_depth_is_none(tmp_path):
    write_trex(tmp_path)
    arrays = visual_field_arrays(0, [[1, 2]], [0])
    arrays["depth"][0, 1, 0, 2] = np.inf  # as the documentation has it
    write_visual_field(tmp_path, "fish0", arrays)
    assert read(tmp_path)["adjacency"].to_numpy()[0, 0].tolist() == [0, 0, 1]


def test_frames_outside_the_tracks_are_passed_over(tmp_path):
    write_trex(tmp_path, first=10)
    write_visual_field(tmp_path, "fish0", visual_field_arrays(0, [[1], [2], [1]], [9, 10, 16]))
    tracks = read(tmp_path)
    assert tracks["adjacency"].to_numpy().sum() == 1
    assert tracks["adjacency"].to_numpy()[0, 0, 2] == 1


def test_individuals_never_tracked_are_dropped_as_neighbors_too(tmp_path):
    write_trex(tmp_path, motion=np.where(np.arange(3)[:, None] == 1, np.nan, MOTION))
    write_visual_field(tmp_path, "fish0", visual_field_arrays(0, [[1, 2]], [0]))
    tracks = read(tmp_path)
    assert tracks["adjacency"].shape == (6, 2, 2)
    assert list(tracks["neighbor"].values) == ["0", "2"]
    assert tracks["adjacency"].to_numpy()[0].tolist() == [[0, 1], [0, 0]]


def test_alone_it_gives_head_positions_in_px(tmp_path):
    for own, (frames, seen) in SEEN.items():
        write_visual_field(tmp_path, f"id{own}", visual_field_arrays(own, seen, frames))
    with pytest.raises(InputError, match="does not tell its frames per second"):
        read(tmp_path)
    tracks = read(tmp_path, fps=30)
    adjacency, known = expected()
    np.testing.assert_array_equal(tracks["adjacency"], adjacency)
    np.testing.assert_array_equal(tracks["position"].notnull().all("space"), known)
    assert tracks.attrs["unit"] == "px"
    assert tracks.attrs["centroid"] == "head"
    assert positions(tracks)[3, 1].tolist() == [12.0, 50.0]  # third row of individual 1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [({"fish_pos": None}, "no array fish_pos"), ({"fish_pos": np.zeros((3, 2))}, "for 2 frames")],
)
def test_alone_and_damaged(tmp_path, change, sentence):
    arrays = {**visual_field_arrays(0, [[1], []], [0, 1]), **change}
    arrays = {key: values for key, values in arrays.items() if values is not None}
    write_visual_field(tmp_path, "fish0", arrays)
    with pytest.raises(InputError, match=sentence):
        read(tmp_path, fps=30)


def test_a_split_array_cut_short(tmp_path):
    write_trex(tmp_path)
    arrays = visual_field_arrays(0, [[1], [2]], [0, 1])
    write_visual_field(tmp_path, "fish0", arrays, split=True)
    path = tmp_path / "video_visual_field_fish0_ids.npy"
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(InputError, match=r"fish0_ids.npy: this is not a whole npy file"):
        read(tmp_path)


def test_custom_names_of_version_1_tell_no_number(tmp_path):
    write_trex(tmp_path, names=("alice", "fish1"))
    write_visual_field(tmp_path, "fish1", visual_field_arrays(1, [[0]], [0]))
    with pytest.raises(InputError, match=r"video_alice.npz does not tell the number"):
        read(tmp_path, visual_field=True)
    tracks = read(tmp_path)
    assert "adjacency" not in tracks
    assert tracks.attrs["visual_field"].startswith("not read: video_alice.npz does not tell")


def test_required_and_absent(tmp_path):
    write_trex(tmp_path)
    with pytest.raises(InputError, match="Switch on output_visual_fields"):
        read(tmp_path, visual_field=True)
    with pytest.raises(InputError, match="Name the folder of all"):
        read(tmp_path / "video_fish0.npz", visual_field=True)
    assert "adjacency" not in read(tmp_path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"frames": None}, "no array frames"),
        ({"ids": None}, "no array ids"),
        ({"frames": np.array([0, 1])}, "frames, ids and depth differ in length"),
        ({"frames": np.array([1, 0, 2])}, "frames do not increase"),
        ({"ids": np.zeros((3, 2, 512), np.int32)}, "not \\(frame, eye, layer, ray\\)"),
    ],
)
def test_damage_is_named(tmp_path, change, sentence):
    write_trex(tmp_path)
    arrays = {**visual_field_arrays(0, [[1], [], []], [0, 1, 2]), **change}
    arrays = {key: values for key, values in arrays.items() if values is not None}
    write_visual_field(tmp_path, "fish0", arrays)
    with pytest.raises(InputError, match=sentence):
        read(tmp_path)


def test_the_file_itself_is_no_tracks(tmp_path):
    write_visual_field(tmp_path, "fish0", visual_field_arrays(0, [[1]], [0]))
    with pytest.raises(InputError, match="holds no tracks, but what belongs to them"):
        read(tmp_path / "video_visual_field_fish0.npz")
