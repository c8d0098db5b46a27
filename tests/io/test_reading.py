"""One door: formats are told by content, options are checked, the caller's wishes are kept."""

import shutil

import numpy as np
import pandas as pd
import pytest
from io_samples import (
    MOTION,
    idtrackerai_dict,
    long_text,
    positions,
    wide_text,
    write_idtracker,
    write_idtrackerai_csv,
    write_idtrackerai_h5,
    write_idtrackerai_parquet,
    write_idtrackerai_tidy,
    write_trex,
)

from swarmssm.errors import InputError
from swarmssm.io import FORMATS, detect_format, read, write
from swarmssm.tracks import make_tracks


def write_netcdf(path):
    write(make_tracks(MOTION, fps=25), path)


def write_text(text):
    return lambda path: path.write_text(text)


def write_npz(path):
    with path.open("wb") as stream:
        np.savez(stream, xy=MOTION, fps=25)


def write_npy(path):
    with path.open("wb") as stream:
        np.save(stream, MOTION)


def write_pickled(path):
    with path.open("wb") as stream:
        np.save(stream, idtrackerai_dict())


def write_parquet(path):
    frame = pd.DataFrame(MOTION.reshape(6, -1), columns=["x1", "y1", "x2", "y2", "x3", "y3"])
    frame.to_parquet(path)


def write_trex_file(path):
    shutil.copyfile(write_trex(path.parent / "made") / "video_fish0.npz", path)


FILES = [
    ("netcdf", write_netcdf),
    ("trex", write_trex_file),
    ("trex-csv", write_text("frame,X#wcentroid,Y#wcentroid\n0,1,2\n1,2,3\n")),
    ("idtrackerai", lambda path: write_idtrackerai_h5(path, idtrackerai_dict())),
    ("idtrackerai", lambda path: write_idtrackerai_parquet(path, idtrackerai_dict())),
    ("idtrackerai", write_pickled),
    ("idtracker", write_idtracker),
    ("table", write_text(wide_text())),
    ("table", write_text(long_text(sep="\t"))),
    ("table", write_parquet),
    ("arrays", write_npz),
    ("arrays", write_npy),
]


@pytest.mark.parametrize(("name", "writer"), FILES)
def test_a_file_is_told_by_its_content(tmp_path, name, writer):
    options = {"allow_pickle": True} if writer is write_pickled else {}
    path = tmp_path / "tracks"
    writer(path)
    said = positions(read(path, name, fps=25, **options))
    for suffix in ("", ".csv", ".npz", ".nc", ".txt", ".h5"):
        path = path.rename(tmp_path / f"tracks{suffix}")
        assert detect_format(path) == name
        np.testing.assert_array_equal(positions(read(path, fps=25, **options)), said)


def test_a_folder_is_told_by_its_content(tmp_path):
    for name in ("trex", "csv", "session", "inside", "classic", "tidy"):
        (tmp_path / name).mkdir()
    write_trex(tmp_path / "trex")
    assert detect_format(tmp_path / "trex") == "trex"
    (tmp_path / "csv" / "v_fish0.csv").write_text("frame,X (cm),Y (cm),num_pixels\n0,1,2,3\n")
    assert detect_format(tmp_path / "csv") == "trex-csv"
    write_idtrackerai_csv(tmp_path / "session" / "trajectories_csv", idtrackerai_dict())
    assert detect_format(tmp_path / "session" / "trajectories_csv") == "idtrackerai"
    assert detect_format(tmp_path / "session") == "idtrackerai"
    file = tmp_path / "session" / "trajectories_csv" / "trajectories.csv"
    assert detect_format(file) == "idtrackerai"
    assert read(file).attrs["fps"] == 28
    tidy = write_idtrackerai_tidy(tmp_path / "tidy", idtrackerai_dict())
    assert detect_format(tidy) == "idtrackerai"
    write_idtracker(tmp_path / "classic" / "trajectories.txt")
    assert detect_format(tmp_path / "classic") == "idtracker"


def test_every_format_is_described_and_has_a_reader(tmp_path):
    assert set(FORMATS) == {name for name, _ in FILES}
    for name in FORMATS:
        with pytest.raises(InputError, match="there is no such file or folder"):
            read(tmp_path / "absent", name)


def test_an_unknown_format(tmp_path):
    write_npz(tmp_path / "t")
    with pytest.raises(InputError, match="format: 'sleap' is unknown; choose auto or netcdf"):
        read(tmp_path / "t", "sleap")


@pytest.mark.parametrize("name", list(FORMATS))
def test_a_file_of_another_format_than_was_said(tmp_path, name):
    """Each reader refuses each other's file with a sentence; but a table is a table."""
    tabular = {"table", "idtracker", "trex-csv", "idtrackerai"}
    for number, (other, writer) in enumerate(FILES):
        path = tmp_path / f"file{number}"
        writer(path)
        binary = path.read_bytes()[:4] in (b"PK\x03\x04", b"\x89HDF", b"\x93NUM")
        if name == other or (name in tabular and not binary):
            continue
        with pytest.raises(InputError) as caught:
            read(path, name, fps=25)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"centroid": "head"}, "the format arrays has no option centroid"),
        ({"visual_field": False}, "the format arrays has no option visual_field"),
        ({"keypoint": "nose"}, "the format arrays has no option keypoint"),
        ({"allow_pickle": True}, "the format arrays has no option allow_pickle"),
        ({"pad_trials": True}, "the format arrays has no option pad_trials"),
        ({"video": "a"}, "the format arrays has no option video"),
        ({"empty": "ignore"}, "empty: 'ignore' is unknown; choose refuse, drop or keep"),
        ({"fps": 0}, "frames per second must lie between 0 and 1e"),
        ({"fps": -1}, "frames per second must lie between"),
        ({"fps": float("nan")}, "frames per second must lie between"),
        ({"fps": float("inf")}, "frames per second must lie between"),
        ({"fps": 1e7}, "frames per second must lie between"),
    ],
)
def test_options_are_checked(tmp_path, options, sentence):
    write_npz(tmp_path / "t")
    with pytest.raises(InputError, match=sentence):
        read(tmp_path / "t", **options)


def test_the_unit_can_be_given(tmp_path):
    np.savez(tmp_path / "t.npz", X=np.concatenate([MOTION, MOTION], -1), fps=5)
    tracks = read(tmp_path / "t.npz", unit="mm")
    assert tracks.attrs["unit"] == "mm"
    assert tracks["position"].attrs["units"] == "mm"
    assert tracks["velocity"].attrs["units"] == "mm/s"


def test_individuals_without_any_position(tmp_path):
    motion = MOTION.copy()
    motion[:, [0, 2]] = np.nan
    edges = np.zeros((6, 3, 3))
    np.savez(tmp_path / "t.npz", xy=motion, fps=5, id=["a", "b", "c"], A=edges)
    with pytest.raises(InputError, match=r'individuals a, c have no position .* empty="drop"'):
        read(tmp_path / "t.npz")
    assert read(tmp_path / "t.npz", empty="keep").sizes["individual"] == 3
    tracks = read(tmp_path / "t.npz", empty="drop")
    assert list(tracks["individual"].values) == ["b"]
    assert tracks["adjacency"].shape == (6, 1, 1)
    assert tracks.attrs["left_out_individuals"] == "a, c"


def test_one_individual_is_enough(tmp_path):
    np.savez(tmp_path / "t.npz", xy=MOTION[:, :1], fps=5)
    assert read(tmp_path / "t.npz").sizes["individual"] == 1


@pytest.mark.parametrize(
    ("writer", "options", "expected"),
    [
        (write_idtracker, {}, "down"),
        (write_trex_file, {}, "down"),
        (write_idtracker, {"y_axis": "up"}, "up"),
        (write_npz, {"fps": 25}, None),
        (write_npz, {"unit": "px"}, "down"),
        (write_npz, {"y_axis": "down"}, "down"),
        (write_netcdf, {}, None),
    ],
)
def test_where_y_grows_downwards(tmp_path, writer, options, expected):
    """The files of trackers count from the top left corner of the video."""
    path = tmp_path / "video_fish0.npz"
    writer(path)
    tracks = read(path, **({"fps": 25} | options))
    assert tracks.attrs.get("y_axis") == expected
    write(tracks, tmp_path / "kept.nc")
    assert read(tmp_path / "kept.nc").attrs.get("y_axis") == expected


def test_a_direction_of_y_that_is_none_is_named(tmp_path):
    write_netcdf(tmp_path / "a.nc")
    with pytest.raises(InputError, match="y_axis: it must be up or down, and it is 'left'"):
        read(tmp_path / "a.nc", y_axis="left")
    with pytest.raises(InputError, match="y_axis must be up or down"):
        make_tracks(MOTION, fps=25, attrs={"y_axis": 1})
