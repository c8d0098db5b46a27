"""TRex's csv files."""

import numpy as np
import pytest
from io_samples import MOTION, positions

from swarmssm.errors import InputError
from swarmssm.io import read

HEADER = "frame,X#wcentroid (cm),Y#wcentroid (cm),SPEED#wcentroid (cm/s),num_pixels,frame,time"


def write(folder, *, header=HEADER, video="test", members=3):
    for member in range(members):
        lines = [header]
        for frame, (x, y) in enumerate(MOTION[:, member]):
            xy = "inf,inf,inf" if np.isnan(x) else f"{x:g},{y:g},3"
            lines.append(f"{frame},{xy},264,{frame},{frame / 25:.2f}")
        (folder / f"{video}_fish{member}.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_motion_comes_back(tmp_path):
    tracks = read(write(tmp_path))
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["fps"] == 25
    assert tracks.attrs["unit"] == "cm"
    assert tracks.attrs["source_software"] == "TRex"


def test_a_single_file_and_a_table_beside(tmp_path):
    write(tmp_path)
    (tmp_path / "notes.csv").write_text("what,when\nfed,noon\n")
    np.testing.assert_array_equal(positions(read(tmp_path / "test_fish2.csv"))[:, 0], MOTION[:, 2])
    assert read(tmp_path).sizes["individual"] == 3
    write(tmp_path, video="other", members=1)
    with pytest.raises(InputError, match=r"2 recordings, other \(1 files\), test \(3 files\)"):
        read(tmp_path)
    assert read(tmp_path, video="test").sizes["individual"] == 3


def test_options(tmp_path):
    write(tmp_path, header=HEADER.replace("#wcentroid", ""))
    with pytest.raises(InputError, match="no column X#pcentroid"):
        read(tmp_path, centroid="pcentroid")
    with pytest.raises(InputError, match="'tail' is unknown; choose one of wcentroid"):
        read(tmp_path, centroid="tail")
    assert read(tmp_path).attrs["centroid"] == "head"
    with pytest.raises(InputError, match="trex-csv has no option visual_field"):
        read(tmp_path, visual_field=True)


def test_a_text_cell_is_named(tmp_path):
    write(tmp_path)
    path = tmp_path / "test_fish1.csv"
    path.write_text(path.read_text().replace("\n3,13,", "\n3,oops,"))
    with pytest.raises(InputError, match=r"test_fish1.csv: line 5, column 'X#.*': 'oops' is not a"):
        read(tmp_path)


def test_frames_that_fall_are_named_by_line(tmp_path):
    write(tmp_path)
    path = tmp_path / "test_fish0.csv"
    path.write_text(path.read_text().replace("\n4,", "\n2,"))
    with pytest.raises(InputError, match="the frame in line 6 is 2; frames must be whole"):
        read(tmp_path)


def test_real_files_without_y_say_so(shared_data):
    folder = shared_data / "guppies_trex8" / "trex_csv"
    for path in (folder, folder / "test_fish0.csv"):
        with pytest.raises(InputError) as caught:
            read(path)
        sentence = str(caught.value)
        assert "test_fish0.csv: it has X#wcentroid but no Y#wcentroid" in sentence
        assert '["Y",["RAW","WCENTROID"]] to output_fields' in sentence


def test_real_columns_with_a_y(shared_data, tmp_path):
    """Put the missing column into the real files: everything else is then read as it is."""
    folder = shared_data / "guppies_trex8"
    with np.load(folder / "guppies_trex8.npz") as stacked:
        x, frames = stacked["trex_x_px"], stacked["frame"]
    for path in (folder / "trex_csv").glob("*.csv"):
        lines = path.read_text().splitlines()
        rows = [line.split(",") for line in lines]
        column = rows[0].index("X#wcentroid (cm)")
        y = ["Y#wcentroid (cm)", *("inf" if r[column] == "inf" else "7" for r in rows[1:])]
        text = "\n".join(f"{line},{cell}" for line, cell in zip(lines, y, strict=True))
        (tmp_path / path.name).write_text(text)
    tracks = read(tmp_path, fps=25)
    assert dict(tracks.sizes) == {"time": 200, "space": 2, "individual": 8}
    np.testing.assert_array_equal(tracks["frame"], frames)
    # 141 of 1600 positions are missing, says the README of the set.
    assert int(tracks["position"].isnull().all("space").sum()) == 141
    np.testing.assert_array_equal(positions(tracks)[..., 0], np.where(np.isfinite(x), x, np.nan))
