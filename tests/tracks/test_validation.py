import copy
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks, states_of, validate_tracks
from swarmssm.tracks.validation import text_of

NAN = np.nan
#: Two animals on straight lines: x = t, y = 2 t and x = -t, y = 10.
LINES = np.stack(
    [
        np.stack([np.arange(4.0), 2 * np.arange(4.0)], -1),
        np.stack([-np.arange(4.0), np.full(4, 10.0)], -1),
    ],
    axis=1,
)


def movement(plural: bool = False, keypoints: int = 0, fps: float | None = 10.0) -> xr.Dataset:
    """Build what `movement` makes of the lines; keypoints lie one unit apart along x."""
    end = "s" if plural else ""
    position = LINES.transpose(0, 2, 1)
    dims = ["time", "space", f"individual{end}"]
    coords: dict[str, Any] = {
        "time": np.arange(4) if fps is None else np.arange(4) / fps,
        "space": ["x", "y"],
        f"individual{end}": ["id_0", "id_1"],
    }
    if keypoints:
        offset = np.arange(keypoints) - (keypoints - 1) / 2
        position = position[:, :, None] + np.multiply.outer([1.0, 0.0], offset)[None, :, :, None]
        dims.insert(2, f"keypoint{end}")
        coords[f"keypoint{end}"] = [f"keypoint_{k}" for k in range(keypoints)]
    spaceless = [dim for dim in dims if dim != "space"]
    attrs: dict[str, Any] = {
        "source_software": "DeepLabCut",
        "ds_type": "poses" if keypoints else "bboxes",
        "time_unit": "frames" if fps is None else "seconds",
        "source_file": "a.h5",
    }
    if fps is not None:
        attrs["fps"] = fps
    data = {
        "position": (dims, position.copy()),
        "confidence": (spaceless, np.full([position.shape[dims.index(d)] for d in spaceless], 0.9)),
    }
    return xr.Dataset(data, coords, attrs)


@pytest.mark.parametrize("plural", [True, False])
@pytest.mark.parametrize("keypoints", [0, 1, 3])
def test_datasets_of_movement_are_tracks(plural: bool, keypoints: int):
    tracks = validate_tracks(movement(plural, keypoints))
    assert tracks["position"].dims == ("time", "space", "individual")
    np.testing.assert_allclose(states_of(tracks)[0, ..., :2], LINES, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        states_of(tracks)[0, 1:, :, 2:], [[[10, 20], [-10, 0]]] * 3, rtol=1e-12
    )
    assert tracks["individual"].values.tolist() == ["id_0", "id_1"]
    assert tracks.attrs["fps"] == 10.0
    assert tracks.attrs["time_unit"] == "seconds"
    assert tracks.attrs["source_software"] == "DeepLabCut"
    assert tracks.attrs["source_file"] == "a.h5"
    assert tracks.attrs["ds_type"] == ("poses" if keypoints else "bboxes")
    assert tracks.attrs["unit"] == ""
    assert not {"keypoint", "keypoints", "individuals"} & set(map(str, tracks.dims))
    # Confidence of a keypoint is none of the animal's; that of a box is.
    assert ("confidence" in tracks) == (not keypoints)


def test_the_place_of_an_animal_is_the_mean_of_the_keypoints_that_were_seen():
    dataset = movement(keypoints=3)
    position = dataset["position"].transpose("time", "individual", "keypoint", "space").values
    position[0, 0, 2] = NAN  # keypoints at x = -1, 0 are left
    position[1, 0, 0, 1] = NAN  # y of the first is unknown: it does not count, so x = 1, 2 are left
    position[2, 0] = NAN
    dataset["position"] = (("time", "individual", "keypoint", "space"), position)
    centre = validate_tracks(dataset)["position"].sel(individual="id_0").values
    np.testing.assert_array_equal(centre, [[-0.5, 0], [1.5, 2], [NAN, NAN], [3, 6]])


def test_an_infinite_keypoint_is_not_averaged_away():
    dataset = movement(keypoints=2)
    dataset["position"][1, 0, :, 0] = [np.inf, -np.inf]
    with pytest.raises(InputError, match=r"^a.h5: position of a keypoint is infinite; use NaN"):
        validate_tracks(dataset, "a.h5")


def test_time_in_frames_becomes_seconds():
    dataset = movement(fps=None)
    dataset.attrs["fps"] = 4
    tracks = validate_tracks(dataset)
    np.testing.assert_array_equal(tracks["time"], [0, 0.25, 0.5, 0.75])
    assert tracks.attrs["time_unit"] == "seconds"
    later = dataset.assign_coords(time=[8, 9, 10, 11])
    np.testing.assert_array_equal(validate_tracks(later)["time"], [2, 2.25, 2.5, 2.75])
    # Without a time at all the rows are frames.
    bare = movement().drop_vars("time")
    np.testing.assert_allclose(validate_tracks(bare)["time"], np.arange(4) / 10, rtol=1e-15)


def test_missing_fps_is_told_by_the_seconds_but_not_by_frames():
    dataset = movement()
    del dataset.attrs["fps"]
    assert validate_tracks(dataset).attrs["fps"] == 10.0
    with pytest.raises(InputError) as caught:
        validate_tracks(movement(fps=None), "a.h5")
    assert str(caught.value) == "a.h5: time is in frames and fps is not known; give fps."
    with pytest.raises(InputError) as caught:
        validate_tracks(dataset.drop_vars("time"))
    assert str(caught.value) == "tracks: it has no time and fps is not known; give fps."


@pytest.mark.parametrize(
    "order", list(itertools.permutations(["trial", "time", "space", "individual"]))
)
def test_dimensions_may_come_in_any_order(order: tuple[str, ...]):
    position = np.random.default_rng(0).normal(size=(2, 3, 4, 2))
    edges = np.random.default_rng(0).random((2, 3, 4, 4)) < 0.5
    edges[..., range(4), range(4)] = False
    tracks = make_tracks(position, fps=1, velocity=-position, adjacency=edges)
    turned = tracks.transpose(*order, "neighbor")
    again = validate_tracks(turned)
    xr.testing.assert_identical(again, tracks)
    for name in ("position", "velocity", "adjacency"):
        assert again[name].dims == tracks[name].dims
        assert again[name].values.flags.c_contiguous
    backwards = validate_tracks(tracks.transpose("neighbor", *order))
    xr.testing.assert_identical(backwards, tracks)


def test_spatial_axes_are_brought_into_order_by_their_names():
    tracks = make_tracks(np.random.default_rng(0).normal(size=(3, 2, 3)), fps=1)
    for names in itertools.permutations("xyz"):
        xr.testing.assert_identical(validate_tracks(tracks.sel(space=list(names))), tracks)


def test_neighbors_are_brought_into_the_order_of_the_individuals():
    edges = np.zeros((2, 3, 3))
    edges[:, 0, 1] = 1  # a sees b
    edges[:, 1, 2] = 1  # b sees c
    tracks = make_tracks(np.zeros((2, 3, 2)), fps=1, adjacency=edges, individuals=["a", "b", "c"])
    turned = tracks.isel(neighbor=[2, 0, 1])
    assert turned["adjacency"].values[0].tolist() == [[0, 0, 1], [1, 0, 0], [0, 0, 0]]
    xr.testing.assert_identical(validate_tracks(turned), tracks)
    unnamed = tracks.drop_vars("neighbor")
    xr.testing.assert_identical(validate_tracks(unnamed), tracks)


@pytest.mark.parametrize("dtype", [int, np.int16, np.float32, np.uint8, np.float16])
def test_positions_of_any_number_become_double_precision(dtype: type):
    dataset = movement()
    values = np.abs(dataset["position"].values)
    dataset["position"] = (dataset["position"].dims, values.astype(dtype))
    position = validate_tracks(dataset)["position"]
    assert position.dtype == np.float64
    np.testing.assert_array_equal(position, values)


@pytest.mark.parametrize("dtype", [bool, int, np.int8, float, np.float32])
def test_edges_of_any_number_become_bytes(dtype: type):
    edges = np.array([[[0, 1], [0, 0]]] * 4)
    dataset = movement().assign(adjacency=(("time", "individual", "neighbor"), edges.astype(dtype)))
    adjacency = validate_tracks(dataset)["adjacency"]
    assert adjacency.dtype == np.uint8
    np.testing.assert_array_equal(adjacency, edges)


@pytest.mark.parametrize("fps", [np.float64(10), np.int64(10), np.array([10.0]), np.float32(10)])
def test_attributes_of_a_file_may_be_numbers_of_numpy(fps: object):
    dataset = movement()
    dataset.attrs["fps"] = fps
    rate = validate_tracks(dataset).attrs["fps"]
    assert rate == 10.0
    assert type(rate) is float


def test_labels_in_bytes_are_read_as_text():
    dataset = movement().assign_coords(individual=np.array([b"M\xc3\xbccke", b"b"], dtype="S6"))
    assert validate_tracks(dataset)["individual"].values.tolist() == ["Mücke", "b"]
    assert text_of(3) == "3"
    assert text_of(np.str_("a")) == "a"
    assert text_of(np.bytes_(b"a")) == "a"


def test_missing_labels_are_numbers():
    tracks = validate_tracks(movement().drop_vars("individual"))
    assert tracks["individual"].values.tolist() == ["0", "1"]


def test_durations_are_seconds():
    stamps = (np.arange(4) * 100).astype("timedelta64[ms]").astype("timedelta64[ns]")
    tracks = validate_tracks(movement().assign_coords(time=stamps))
    np.testing.assert_allclose(tracks["time"], np.arange(4) / 10, rtol=1e-15)


def test_stamps_that_jitter_are_put_on_the_grid_and_exact_ones_left():
    dataset = movement()
    exact = 7.3 + np.arange(4) / 10.0
    tracks = validate_tracks(dataset.assign_coords(time=exact))
    np.testing.assert_array_equal(tracks["time"], exact)
    jittered = dataset.assign_coords(time=exact + np.array([0.0, 0.01, -0.02, 0.0]))
    np.testing.assert_allclose(validate_tracks(jittered)["time"], exact, rtol=0, atol=1e-12)


def test_a_place_known_in_part_is_not_known():
    dataset = movement()
    dataset["position"][1, 0, 0] = NAN
    dataset["velocity"] = dataset["position"].copy(data=np.ones((4, 2, 2)))
    dataset["velocity"][2, 1, 1] = NAN
    tracks = validate_tracks(dataset)
    assert np.isnan(tracks["position"].values[1, :, 0]).all()
    assert np.isnan(tracks["position"]).sum() == 2
    assert np.isnan(tracks["velocity"].values[2, :, 1]).all()
    assert np.isnan(tracks["velocity"]).sum() == 2


def snapshot(dataset: xr.Dataset) -> dict[object, Any]:
    """Return all that a dataset holds, copied deeply."""
    held = {
        name: (v.dims, v.values.copy(), copy.deepcopy(v.attrs), copy.deepcopy(v.encoding))
        for name, v in dataset.variables.items()
    }
    return {
        **held,
        "attrs": copy.deepcopy(dataset.attrs),
        "sizes": dict(dataset.sizes),
        "encoding": copy.deepcopy(dataset.encoding),
    }


@pytest.mark.parametrize("plural", [True, False])
@pytest.mark.parametrize("keypoints", [0, 2])
def test_the_given_dataset_is_not_changed(plural: bool, keypoints: int):
    dataset = movement(plural, keypoints, fps=None)
    dataset.attrs["fps"] = np.int64(5)
    dataset.attrs["nested"] = {"a": [1, 2]}
    dataset["position"].attrs["units"] = "furlong"
    dataset["time"].attrs["long_name"] = "frame"
    dataset["position"].encoding["dtype"] = "int16"
    dataset["position"].values.flat[0] = NAN
    dataset["velocity"] = dataset["position"].copy(deep=True)
    before = snapshot(dataset)
    tracks = validate_tracks(dataset)
    for name, variable in tracks.variables.items():
        variable.attrs["mine"] = 1
        variable.encoding["mine"] = 1
        if name in ("position", "velocity"):
            variable.values[...] = 0
    tracks.attrs["mine"] = 1
    after = snapshot(dataset)
    assert before.keys() == after.keys()
    for name, held in before.items():
        np.testing.assert_equal(after[name], held)


def test_checked_tracks_stay_as_they_are():
    tracks = make_tracks(
        np.random.default_rng(0).normal(size=(2, 3, 4, 3)),
        fps=29.97,
        velocity=np.random.default_rng(1).normal(size=(2, 3, 4, 3)),
        adjacency=np.zeros((2, 3, 4, 4)),
        unit="m",
        attrs={"note": 1},
        variables={"force": (("trial", "time", "term"), np.zeros((2, 3, 5)))},
    )
    xr.testing.assert_identical(validate_tracks(tracks), tracks)
    xr.testing.assert_identical(
        validate_tracks(validate_tracks(movement())), validate_tracks(movement())
    )


def test_how_a_file_packed_its_numbers_is_forgotten(tmp_path: Path):
    small = {"dtype": "int16", "_FillValue": -1}
    packed = {"position": small, "confidence": small}
    movement().to_netcdf(tmp_path / "a.nc", engine="h5netcdf", encoding=packed)
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as dataset:
        assert dataset["position"].encoding["dtype"] == "int16"
        tracks = validate_tracks(dataset.load())
    tracks["position"] += 0.25
    tracks["confidence"] = tracks["confidence"].copy(data=np.full((4, 2), 0.25))
    tracks.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "b.nc", engine="h5netcdf") as dataset:
        np.testing.assert_array_equal(dataset["position"], tracks["position"])
        assert (dataset["confidence"] == 0.25).all()


def test_notes_on_a_variable_are_kept():
    dataset = movement()
    dataset["position"].attrs["long_name"] = "centre of the body"
    dataset["time"].attrs["long_name"] = "since the lamp was lit"
    dataset.attrs["unit"] = "mm"
    tracks = validate_tracks(dataset)
    assert tracks["position"].attrs == {"long_name": "centre of the body", "units": "mm"}
    assert tracks["time"].attrs == {"long_name": "since the lamp was lit", "units": "s"}


EDGE_DIMS = ("time", "individual", "neighbor")
REFUSALS: list[tuple[xr.Dataset, str]] = [
    (
        movement().rename(position="place"),
        "a.nc: it has no variable called position (found: place, confidence).",
    ),
    (xr.Dataset(), "a.nc: it has no variable called position (found: no variable at all)."),
    (
        movement().isel(individual=0),
        "a.nc: position has the dimensions ('time', 'space'); it needs time, space and "
        "individual, and may have trial.",
    ),
    (
        movement().rename(time="frame"),
        "a.nc: position has the dimensions ('frame', 'space', 'individual'); it needs",
    ),
    (movement().expand_dims("view"), "a.nc: position has the dimensions ('view', 'time',"),
    (
        movement().assign_coords(space=["u", "v"]),
        "a.nc: the space axis must be x, y or x, y, z, and it is u, v.",
    ),
    (
        movement().assign_coords(space=["x", "z"]),
        "a.nc: the space axis must be x, y or x, y, z, and it is x, z.",
    ),
    (movement().isel(space=[0]), "a.nc: the space axis must be x, y or x, y, z, and it is x."),
    (
        movement().drop_vars("space"),
        "a.nc: the 2 entries of the space axis have no names. Name them x, y or x, y, z.",
    ),
    (
        movement().assign_coords(individual=["a", "a"]),
        "a.nc: the individual a stands there more than once.",
    ),
    (movement().isel(individual=[]), "a.nc: it has no individual."),
    (movement().isel(time=[0]), "a.nc: it has 1 frame; motion needs at least 2."),
    (movement().isel(time=[]), "a.nc: it has no frame; motion needs at least 2."),
    (
        movement().isel(time=[0, 1, 3]),
        "a.nc: time row 2 comes 0.2 s after the row before it, where fps = 10 asks for 0.1 s. Put "
        "rows of NaN where frames are missing.",
    ),
    (
        movement().isel(time=[0, 2, 1]),
        "a.nc: time: row 2 (0.1) falls below the row before it (0.2); it must increase.",
    ),
    (
        movement().assign_coords(time=[0, 0.1, NAN, 0.3]),
        "a.nc: time: row 2 is not a finite number.",
    ),
    (
        movement().assign_coords(time=np.array(["2020-01-01"] * 4, dtype="datetime64[ns]")),
        "a.nc: time must be in seconds or frames, not datetime64[ns].",
    ),
    (
        movement().assign_coords(time=list("abcd")),
        "a.nc: time must be in seconds or frames, not <U1.",
    ),
    (
        movement().assign_attrs(fps="x"),
        "a.nc: fps: frames per second must lie between 0 and 1e+06, not x.",
    ),
    (
        movement().assign_attrs(fps=-1),
        "a.nc: fps: frames per second must lie between 0 and 1e+06, not -1.",
    ),
    (
        movement().assign_attrs(fps=16.0),
        "a.nc: time: row 1 (0.1 s) does not lie on a grid of 16 frames per second. Mend fps or "
        "time.",
    ),
    (
        # Each step is within a quarter of the stated one; together they drift away from it.
        make_tracks(np.zeros((50, 1, 2)), fps=30).assign_attrs(fps=25.0),
        "does not lie on a grid of 25 frames per second. Mend fps or time.",
    ),
    (
        movement().assign(position=lambda d: d["position"].where(d["time"] != 0.2, np.inf)),
        "a.nc: position of individual id_0 in time row 2 is inf; use NaN for what was not seen.",
    ),
    (
        movement().assign(position=lambda d: d["position"].astype(str)),
        "a.nc: position holds no numbers.",
    ),
    (
        movement(keypoints=2).assign(position=lambda d: d["position"].astype(str)),
        "a.nc: position holds no numbers.",
    ),
    (
        movement().assign(position=lambda d: d["position"] * NAN),
        "a.nc: no individual has a position in any frame.",
    ),
    (
        movement().assign(velocity=lambda d: d["position"].isel(space=0)),
        "a.nc: velocity has the dimensions ('time', 'individual'); it needs time, space, "
        "individual.",
    ),
    (
        movement().assign(adjacency=(EDGE_DIMS[:2], np.zeros((4, 2)))),
        "a.nc: adjacency has the dimensions ('time', 'individual'); it needs time, individual, "
        "neighbor.",
    ),
    (
        movement().assign(adjacency=(EDGE_DIMS, np.full((4, 2, 2), 0.5))),
        "a.nc: adjacency of individual id_0 to neighbor id_0 in time row 0 is 0.5; it must be 0 "
        "or 1.",
    ),
    (
        movement().assign(adjacency=(EDGE_DIMS, np.full((4, 2, 2), NAN))),
        "a.nc: adjacency of individual id_0 to neighbor id_0 in time row 0 is nan; it must be 0 "
        "or 1.",
    ),
    (
        movement().assign(adjacency=(EDGE_DIMS, np.ones((4, 2, 2)))),
        "a.nc: adjacency of individual id_0 in time row 0 says that the individual sees itself; "
        "set it to 0.",
    ),
    (
        movement().assign(adjacency=(EDGE_DIMS, np.zeros((4, 2, 3)))),
        "a.nc: it has 3 neighbors and 2 individuals; each individual must be a neighbor too.",
    ),
    (
        movement()
        .assign(adjacency=(EDGE_DIMS, np.zeros((4, 2, 2))))
        .assign_coords(neighbor=["id_0", "id_7"]),
        "a.nc: the neighbor id_7 is not one of the individuals, each of which must stand there "
        "once.",
    ),
    (
        movement()
        .assign(adjacency=(EDGE_DIMS, np.zeros((4, 2, 2))))
        .assign_coords(neighbor=["id_0", "id_0"]),
        "a.nc: the neighbor id_0 is not one of the individuals",
    ),
]


@pytest.mark.parametrize(("dataset", "sentence"), REFUSALS)
def test_each_refusal_names_the_file_the_variable_and_the_place(dataset: xr.Dataset, sentence: str):
    with pytest.raises(InputError) as caught:
        validate_tracks(dataset, "a.nc")
    told = str(caught.value)
    assert sentence in told
    assert told.startswith("a.nc: ")
    assert "\n" not in told


def test_what_was_checked_is_not_checked_again():
    given = movement(plural=False)
    first = validate_tracks(given)
    assert first is not given
    assert validate_tracks(first) is first
    # A dataset that follows the schema already, and is no result of the validation itself.
    copied = first.copy(deep=True)
    second = validate_tracks(copied)
    assert second is not copied
    assert not np.shares_memory(second["position"].values, copied["position"].values)
    assert validate_tracks(copied) is copied


@pytest.mark.parametrize("name", ["position", "time", "fps", "unit", "individual", "dims"])
def test_what_was_changed_in_place_is_checked_again(name):
    tracks = validate_tracks(movement(plural=False))
    if name == "position":
        tracks["position"].values[2, 0, 1] = np.nan
        assert np.isnan(validate_tracks(tracks)["position"].values[2, :, 1]).all()
        tracks["position"].values[2, 0, 1] = np.inf
    elif name == "time":
        tracks["time"] = tracks["time"].values[::-1]
    elif name == "fps":
        tracks.attrs["fps"] = -1.0
    elif name == "unit":
        tracks.attrs["unit"] = "furlong"
        assert validate_tracks(tracks)["position"].attrs["units"] == "furlong"
        return
    elif name == "individual":
        tracks["individual"] = ["a"] * tracks.sizes["individual"]
    else:
        tracks["position"] = tracks["position"].isel(space=0)
    with pytest.raises(InputError):
        validate_tracks(tracks)


def test_only_a_dataset_is_tracks():
    with pytest.raises(InputError, match=r"tracks are a dataset, .* not ndarray"):
        validate_tracks(np.zeros((3, 2, 2)))
