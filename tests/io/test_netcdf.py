"""Our own NetCDF files, to the last bit, and those of movement."""

import h5py
import numpy as np
import pytest
import xarray as xr
from io_samples import MOTION, positions

from swarmssm.errors import InputError, WorkError
from swarmssm.io import read, write, write_dataset
from swarmssm.tracks import make_tracks


def full_tracks():
    generator = np.random.default_rng(0)
    adjacency = (generator.random((6, 3, 3)) < 0.5).astype(np.uint8)
    adjacency[:, range(3), range(3)] = 0
    return make_tracks(
        MOTION / 3,
        fps=29.97,
        frames=np.arange(7, 13),
        individuals=["Zoë", "b", "c"],
        velocity=MOTION / 7,
        adjacency=adjacency,
        unit="µm",
        source_software="none",
        source_file="a.csv",
        variables={
            "role": (("individual",), np.array(["sheep", "dog", "a shepherd"])),
            "seen": (("time", "individual"), np.isfinite(MOTION[..., 0])),
            "count": (("time",), np.arange(6) - 3),
        },
        attrs={"note": "né", "scale": 0.1, "counts": np.array([1, 2, 3]), "empty": "", "n": 3},
    )


def assert_same(first, second):
    xr.testing.assert_identical(first, second)
    for name in first.variables:
        assert first[name].dtype == second[name].dtype, name
        assert first[name].dims == second[name].dims, name


@pytest.mark.parametrize("trials", [False, True])
def test_round_trip_is_exact(tmp_path, trials):
    tracks = full_tracks()
    if trials:
        tracks = make_tracks([MOTION / 3, MOTION[:4] / 7], fps=10, trials=["day", "night"])
    path = tmp_path / "tracks.nc"
    write(tracks, path)
    back = read(path)
    assert_same(tracks, back)
    # And once more, so that what was read carries nothing that changes what is written.
    write(back, path, overwrite=True)
    assert_same(tracks, read(path))


def test_attributes_that_netcdf_has_no_form_for(tmp_path):
    tracks = full_tracks()
    tracks.attrs["tank"] = np.array([[0, 1], [2, 3]])
    odd = {"nothing": None, "true": True, "nested": {"a": [1, {"b": None}]}, "list": [1, "a"]}
    tracks.attrs.update(odd)
    write(tracks, tmp_path / "t.nc")
    back = read(tmp_path / "t.nc")
    assert {name: back.attrs[name] for name in odd} == odd
    assert back.attrs["true"] is True
    assert back.attrs["tank"] == [[0, 1], [2, 3]]
    tracks.attrs["object"] = object()
    with pytest.raises(InputError, match="attribute object: a value of type object cannot be"):
        write(tracks, tmp_path / "t.nc", overwrite=True)
    assert_same(back, read(tmp_path / "t.nc"))


def test_text_of_varying_length(tmp_path):
    """Other programs store text without a length; it comes back as plain text."""
    with h5py.File(tmp_path / "t.nc", "w") as file:
        file["position"] = np.swapaxes(MOTION, 1, 2)
        file.create_dataset("individual", (3,), h5py.string_dtype(), ["ä", "bee", "c"])
        file.create_dataset("role", (3,), h5py.string_dtype(), ["x", "", "zz"])
        for name, size in (("time", 6), ("space", 2)):
            file[name] = np.arange(size) / 25 if name == "time" else np.array([b"x", b"y"])
        for name in ("time", "space", "individual"):
            file[name].make_scale(name)
        for axis, name in enumerate(("time", "space", "individual")):
            file["position"].dims[axis].attach_scale(file[name])
        file["role"].dims[0].attach_scale(file["individual"])
    tracks = read(tmp_path / "t.nc")
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert list(tracks["individual"].values) == ["ä", "bee", "c"]
    assert tracks["role"].dtype.kind == "U"
    assert tracks["role"].values.tolist() == ["x", "", "zz"]
    write(tracks, tmp_path / "u.nc")
    assert_same(read(tmp_path / "u.nc"), read(tmp_path / "u.nc"))


def test_it_is_compressed(tmp_path):
    still = make_tracks(np.zeros((1000, 20, 2)), fps=10)
    write(still, tmp_path / "t.nc")
    assert (tmp_path / "t.nc").stat().st_size < still["position"].nbytes / 10


def test_writing_leaves_no_half_file(tmp_path, monkeypatch):
    path = tmp_path / "t.nc"
    write(full_tracks(), path)
    before = path.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        write(full_tracks(), path)

    def fail(*_, **__):
        raise RuntimeError("the disk is on fire")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", fail)
    with pytest.raises(WorkError, match="the disk is on fire"):
        write(full_tracks(), path, overwrite=True)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["t.nc"]


def test_what_is_no_tracks_is_not_written(tmp_path):
    dataset = xr.Dataset({"height": ("time", [1.0, 2.0])})
    with pytest.raises(InputError, match="no variable called position"):
        write(dataset, tmp_path / "t.nc")
    write_dataset(dataset, tmp_path / "t.nc")
    with pytest.raises(InputError, match=r"neither position .* nor trajectories"):
        read(tmp_path / "t.nc")


def movement_dataset(*, plural, keypoints=("centroid",), seconds=True, fps=25):
    """Return what movement builds from positions: (time, space, keypoint, individual)."""
    s = "s" * plural
    points = np.stack([np.swapaxes(MOTION, 1, 2) + 10 * k for k in range(len(keypoints))], 2)
    dims = ("time", "space", f"keypoint{s}", f"individual{s}")
    return xr.Dataset(
        {
            "position": (dims, points),
            "confidence": (("time", *dims[2:]), np.full(points.shape[:1] + points.shape[2:], 0.5)),
        },
        {
            "time": np.arange(6) / fps if seconds else np.arange(6),
            "space": ["x", "y"],
            dims[2]: list(keypoints),
            dims[3]: ["id_0", "id_1", "id_2"],
        },
        {
            "source_software": "SLEAP",
            "ds_type": "poses",
            "time_unit": "seconds" if seconds else "frames",
            **({"fps": fps} if seconds else {}),
        },
    )


@pytest.mark.parametrize("plural", [True, False])
def test_movement(tmp_path, plural):
    movement_dataset(plural=plural).to_netcdf(tmp_path / "m.nc", engine="h5netcdf")
    tracks = read(tmp_path / "m.nc")
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["fps"] == 25
    assert tracks.attrs["keypoint"] == "centroid"
    assert tracks.attrs["source_software"] == "SLEAP"
    assert list(tracks["individual"].values) == ["id_0", "id_1", "id_2"]
    assert tracks["confidence"].dims == ("time", "individual")


def test_movement_keypoints(tmp_path):
    path = tmp_path / "m.nc"
    movement_dataset(plural=True, keypoints=("nose", "tail", "fin")).to_netcdf(
        path, engine="h5netcdf"
    )
    # The keypoints lie at 0, 10 and 20 from the motion, in x and in y.
    tracks = read(path)
    np.testing.assert_allclose(positions(tracks), MOTION + 10, rtol=1e-14)
    assert tracks.attrs["keypoint"] == "mean of nose, tail, fin"
    np.testing.assert_array_equal(positions(read(path, keypoint="fin")), MOTION + 20)
    with pytest.raises(InputError, match="it has no keypoint 'ear', but nose, tail, fin"):
        read(path, keypoint="ear")
    movement_dataset(plural=False, keypoints=("nose", "centroid")).to_netcdf(
        path, engine="h5netcdf"
    )
    np.testing.assert_array_equal(positions(read(path)), MOTION + 10)
    np.testing.assert_allclose(positions(read(path, keypoint="mean")), MOTION + 5, rtol=1e-14)


def test_movement_in_frames(tmp_path):
    movement_dataset(plural=True, seconds=False).to_netcdf(tmp_path / "m.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=r"its time is in frames.*Add fps="):
        read(tmp_path / "m.nc")
    tracks = read(tmp_path / "m.nc", fps=50)
    np.testing.assert_allclose(tracks["time"], np.arange(6) / 50)
    assert tracks.attrs["fps"] == 50
    assert "fps_in_file" not in tracks.attrs


def test_the_callers_rate_rules(tmp_path):
    write(make_tracks(MOTION, fps=25, time=2 + np.arange(6) / 25), tmp_path / "t.nc")
    tracks = read(tmp_path / "t.nc", fps=50)
    assert tracks.attrs["fps"] == 50
    assert tracks.attrs["fps_in_file"] == 25
    np.testing.assert_allclose(tracks["time"], 2 + np.arange(6) / 50)
    assert_same(read(tmp_path / "t.nc", fps=25), read(tmp_path / "t.nc"))


def test_a_keypoint_of_tracks_without_any(tmp_path):
    write(full_tracks(), tmp_path / "t.nc")
    with pytest.raises(InputError, match="it has no keypoints"):
        read(tmp_path / "t.nc", keypoint="nose")


def test_individuals_that_were_never_tracked_stay(tmp_path):
    motion = MOTION.copy()
    motion[:, 1] = np.nan
    write(make_tracks(motion, fps=25), tmp_path / "t.nc")
    assert read(tmp_path / "t.nc").sizes["individual"] == 3
    assert read(tmp_path / "t.nc", empty="drop").attrs["left_out_individuals"] == "1"


def test_a_file_that_points_elsewhere(tmp_path):
    (tmp_path / "secret").write_bytes(bytes(400))
    with h5py.File(tmp_path / "t.nc", "w") as file:
        file.create_dataset(
            "position", (5, 2, 3), "f8", external=[(str(tmp_path / "secret"), 0, 400)]
        )
    with pytest.raises(InputError, match="the values of position lie in another file"):
        read(tmp_path / "t.nc")
    layout = h5py.VirtualLayout((5, 2, 3), "f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (5, 2, 3))
    with h5py.File(tmp_path / "t.nc", "w") as file:
        file.create_virtual_dataset("position", layout)
    with pytest.raises(InputError, match="the values of position lie in another file"):
        read(tmp_path / "t.nc")
