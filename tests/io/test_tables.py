"""Plain tables: long and wide, in text of any kind and in parquet."""

import numpy as np
import pandas as pd
import pytest
from io_samples import MOTION, long_text, positions, wide_text

from swarmssm.errors import InputError
from swarmssm.io import read


@pytest.fixture
def table(tmp_path):
    """Write a text and return its path."""

    def table(text, name="t.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(text.encode(encoding))
        return path

    return table


@pytest.mark.parametrize("sep", [",", ";", "\t", " "])
@pytest.mark.parametrize("text", [wide_text, long_text])
def test_long_and_wide_with_every_separator(table, text, sep):
    motion = np.nan_to_num(MOTION, nan=3.5) if sep == " " else MOTION
    tracks = read(table(text(motion, sep=sep)), fps=5)
    np.testing.assert_array_equal(positions(tracks), motion)
    assert list(tracks["individual"].values) == ["0", "1", "2"]
    np.testing.assert_array_equal(tracks["frame"], np.arange(6))
    np.testing.assert_allclose(tracks["time"], np.arange(6) / 5)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32", "cp1252"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_encodings_and_line_ends(table, encoding, line_end):
    text = long_text().replace("id", "individual").replace("x,y", "x (µm),y (µm)")
    tracks = read(table(text.replace("\n", line_end), encoding=encoding), fps=5)
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["unit"] == "µm"


def test_a_table_of_a_german_excel(table):
    text = "sep=;\n" + long_text(MOTION, sep=";").replace(".", ",")
    np.testing.assert_array_equal(positions(read(table(text), fps=5)), MOTION)


@pytest.mark.parametrize(
    "header",
    [
        "frame,x1,y1,x2,y2",
        "Frame,X_1,Y_1,X_2,Y_2",
        "frame_number,x.1,y.1,x.2,y.2",
        "frame,1_x,1_y,2_x,2_y",
        "frame,x 1 (cm),y 1 (cm),x 2 (cm),y 2 (cm)",
        "frame,pos_x_1,pos_y_1,pos_x_2,pos_y_2",
        "frame,1_x_cm,1_y_cm,2_x_cm,2_y_cm",
    ],
)
def test_ways_to_name_the_columns_of_a_wide_table(table, header):
    tracks = read(table(f"{header}\n0,1,2,3,4\n1,5,6,7,8\n"), fps=5)
    assert positions(tracks).tolist() == [[[1, 2], [3, 4]], [[5, 6], [7, 8]]]
    assert list(tracks["individual"].values) == ["1", "2"]
    assert tracks.attrs["unit"] == ("cm" if "cm" in header else "")


def test_individuals_keep_the_order_of_the_columns_and_their_names(table):
    tracks = read(table("Zoe_x,Zoe_y,adam_x,adam_y\n1,2,3,4\n5,6,7,8\n"), fps=5)
    assert list(tracks["individual"].values) == ["Zoe", "adam"]
    assert "frame" not in tracks.coords


@pytest.mark.parametrize(
    "header",
    [
        "frame,id,x,y",
        "FRAME,Track,X,Y",
        "frame,individual,x (px),y (px)",
        "frame_id,fish,pos_x,pos_y",
        "frame,animal_id,x_px,y_px",
        "frame,Track ID,Position X,Position Y",
    ],
)
def test_ways_to_name_the_columns_of_a_long_table(table, header):
    text = long_text().replace("frame,id,x,y", header)
    tracks = read(table(text), fps=5)
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["unit"] == ("px" if "px" in header else "")


def test_rows_of_a_long_table_come_in_any_order(table):
    header, *rows = long_text().splitlines()
    order = np.random.default_rng(0).permutation(len(rows))
    text = "\n".join([header, *(rows[k] for k in order)])
    np.testing.assert_array_equal(positions(read(table(text), fps=5)), MOTION)


def test_labels_that_are_numbers_are_ordered_as_such(table):
    text = "frame,id,x,y\n" + "".join(f"{f},{i},{i},{f}\n" for i in (10, 9, 2) for f in (0, 1))
    tracks = read(table(text), fps=5)
    assert list(tracks["individual"].values) == ["2", "9", "10"]
    assert positions(tracks)[0, :, 0].tolist() == [2, 9, 10]


def test_velocity_probability_and_what_is_left_out(table):
    text = "frame,id,x,y,vx,vy,probability,species,head_x\n"
    text += "".join(f"{f},0,{f},1,5,6,0.{f + 1},fish,9\n" for f in range(3))
    tracks = read(table(text), fps=5)
    assert tracks["velocity"].to_numpy()[:, :, 0].tolist() == [[5, 6]] * 3
    assert tracks["id_probability"].to_numpy()[:, 0].tolist() == [0.1, 0.2, 0.3]
    assert tracks.attrs["left_out_columns"] == "species, head_x"


def test_three_dimensions(table):
    text = "frame,id,x,y,z\n" + "".join(f"{f},a,{f},1,{-f}\n" for f in range(3))
    tracks = read(table(text), fps=5)
    assert positions(tracks)[:, 0].tolist() == [[0, 1, 0], [1, 1, -1], [2, 1, -2]]
    assert list(tracks["space"].values) == ["x", "y", "z"]


def test_a_single_animal_needs_no_column_of_individuals(table):
    tracks = read(table("time,x,y\n0,1,2\n0.5,3,4\n"))
    assert positions(tracks).tolist() == [[[1, 2]], [[3, 4]]]
    assert tracks.attrs["fps"] == 2


@pytest.mark.parametrize(
    ("column", "cell", "fps"),
    [
        ("time", "{:.3f}", 28),  # 1 / 28 s is no whole number of milliseconds
        ("time_ms", "{:.0f}", 28),
        ("time [ms]", "{:.0f}", 28),
        ("t", "{:.9f}", 29.97),
        ("timestamp", "2020-02-03T04:05:{:09.6f}", 25),
    ],
)
def test_the_rate_that_times_tell(table, column, cell, fps):
    scale = 1000 if "ms" in column else 1
    rows = "".join(f"{cell.format(f / fps * scale)},{f},{-f}\n" for f in range(1000))
    tracks = read(table(f"{column},x1,y1\n{rows}"))
    assert tracks.attrs["fps"] == pytest.approx(fps, rel=1e-9)
    assert tracks.attrs["fps_source"] == "time"
    assert tracks.sizes["time"] == 1000


def test_dates_and_times_of_day(table):
    rows = "".join(f"2015-09-10,23:59:{58 + f:02d},a,{f},1\n" for f in (0, 1))
    rows += "2015-09-11,00:00:00,a,2,1\n"
    tracks = read(table("date,time,id,x,y\n" + rows))
    assert tracks.attrs["fps"] == 1
    assert positions(tracks)[:, 0, 0].tolist() == [0, 1, 2]


def test_holes_become_rows_of_nan(table):
    tracks = read(table("frame,x1,y1\n10,0,0\n11,1,1\n14,4,4\n"), fps=2)
    x = positions(tracks)[:, 0, 0]
    np.testing.assert_array_equal(x, [0, 1, np.nan, np.nan, 4])
    assert tracks["frame"].values.tolist() == [10, 11, 12, 13, 14]
    assert tracks["time"].values.tolist() == [5, 5.5, 6, 6.5, 7]
    tracks = read(table("time,x1,y1\n1,0,0\n1.5,1,1\n2,2,2\n3.5,5,5\n"))
    np.testing.assert_array_equal(positions(tracks)[:, 0, 0], [0, 1, 2, np.nan, np.nan, 5])
    assert tracks["time"].values.tolist() == [1, 1.5, 2, 2.5, 3, 3.5]


def test_every_fifth_frame_is_no_hole(table):
    text = "frame,x1,y1\n" + "".join(f"{f},{f},0\n" for f in (100, 105, 110, 120))
    tracks = read(table(text), fps=30)
    assert tracks.attrs["fps"] == 6
    np.testing.assert_array_equal(positions(tracks)[:, 0, 0], [100, 105, 110, np.nan, 120])
    assert tracks["frame"].values.tolist() == [100, 105, 110, 115, 120]
    np.testing.assert_allclose(tracks["time"], np.arange(100, 121, 5) / 30)


def test_a_time_in_frames_is_a_frame_number(table):
    tracks = read(table("time (frames),x1,y1\n3,1,2\n4,1,2\n"), fps=10)
    assert tracks["frame"].values.tolist() == [3, 4]
    assert tracks["time"].values.tolist() == [0.3, 0.4]


def test_frames_and_times_together_tell_the_rate(table):
    text = "frame,time,x1,y1\n" + "".join(f"{f},{f / 40},{f},0\n" for f in (0, 1, 2, 6))
    tracks = read(table(text))
    assert tracks.attrs["fps"] == 40
    assert tracks.sizes["time"] == 7


def test_times_that_jitter_are_kept_beside_the_grid(table):
    stamps = np.arange(50) / 10 + np.random.default_rng(0).uniform(-0.01, 0.01, 50)
    text = "time,x1,y1\n" + "".join(f"{s:.4f},1,{k}\n" for k, s in enumerate(stamps))
    tracks = read(table(text))
    assert tracks.attrs["fps"] == 10
    np.testing.assert_allclose(np.diff(tracks["time"]), 0.1)
    np.testing.assert_allclose(tracks["recorded_time"], stamps, atol=5e-5)


def test_the_callers_rate_rules(table):
    path = table("time,x1,y1\n" + "".join(f"{f},{f},0\n" for f in (0, 1, 2, 4)))
    tracks = read(path, fps=30)
    assert tracks.attrs["fps"] == 30
    assert tracks.attrs["fps_in_file"] == 1
    np.testing.assert_allclose(tracks["time"], np.arange(5) / 30)
    assert "fps_in_file" not in read(path, fps=1).attrs


TRIALS = "trial,frame,id,x,y\n" + "".join(
    f"{trial},{frame},{member},{trial}{frame},{frame}\n"
    for trial, frames in ((1, range(4)), (2, range(50, 53)))
    for frame in frames
    for member in "ab"
)


def test_trials_are_padded_at_the_end(table):
    tracks = read(table(TRIALS), fps=10)
    assert dict(tracks.sizes) == {"trial": 2, "time": 4, "space": 2, "individual": 2}
    assert list(tracks["trial"].values) == ["1", "2"]
    x = positions(tracks)[..., 0, 0]
    np.testing.assert_array_equal(x, [[10, 11, 12, 13], [250, 251, 252, np.nan]])
    assert tracks["time"].values[0] == 0


def test_trials_with_other_individuals(table):
    kept = [line for line in TRIALS.splitlines() if not (line[0] == "2" and ",b," in line)]
    path = table("\n".join(kept))
    with pytest.raises(InputError, match=r"trial '2' has 1 of 2 individuals, without b"):
        read(path, fps=10)
    tracks = read(path, fps=10, pad_trials=True)
    assert np.isnan(positions(tracks)[1, :, 1]).all()
    assert np.isfinite(positions(tracks)[0, :, 1]).all()


def test_trials_of_a_wide_table(table):
    tracks = read(table("trial,x1,y1\nA,1,2\nA,3,4\nB,5,6\nB,7,8\n"), fps=10)
    assert positions(tracks)[:, :, 0].tolist() == [[[1, 2], [3, 4]], [[5, 6], [7, 8]]]


def test_trials_of_differing_rate(table):
    with pytest.raises(InputError, match="trial B has 5 frames per second and the first one 10"):
        read(table("trial,time,x1,y1\nA,0,1,2\nA,.1,3,4\nB,0,5,6\nB,.2,7,8\n"))


def test_times_that_jitter_in_one_trial_only(table):
    late = [0, 0.11, 0.2, 0.3]
    rows = [f"A,{k / 10},1,2" for k in range(4)] + [f"B,{s},1,2" for s in late]
    tracks = read(table("trial,time,x1,y1\n" + "\n".join(rows)))
    assert dict(tracks.sizes) == {"trial": 2, "time": 4, "space": 2, "individual": 1}
    np.testing.assert_allclose(tracks["recorded_time"], [[0, 0.1, 0.2, 0.3], late])


@pytest.mark.parametrize("form", ["long", "wide"])
def test_parquet(tmp_path, form):
    i, t = np.meshgrid(np.arange(3), np.arange(6))
    if form == "long":
        frame = pd.DataFrame({"time": t.ravel() / 5, "id": i.ravel()})
        frame["x"], frame["y"] = MOTION.reshape(-1, 2).T
    else:
        names = [f"{axis}{n}" for n in range(3) for axis in "xy"]
        frame = pd.DataFrame(MOTION.reshape(6, -1), columns=names)
        frame.insert(0, "time", np.arange(6) / 5)
    frame.to_parquet(tmp_path / "tracks.data")
    tracks = read(tmp_path / "tracks.data")
    np.testing.assert_array_equal(positions(tracks), MOTION)
    assert tracks.attrs["fps"] == 5
    assert list(tracks["individual"].values) == ["0", "1", "2"]


def test_parquet_with_moments_and_names(tmp_path):
    moments = pd.date_range("2020-01-01", periods=4, freq="250ms")
    frame = pd.DataFrame({"time": moments, "id": "goat", "x": [1, 2, None, 4], "y": 5.0})
    frame.to_parquet(tmp_path / "t.parquet")
    tracks = read(tmp_path / "t.parquet")
    assert tracks.attrs["fps"] == 4
    np.testing.assert_array_equal(positions(tracks)[:, 0, 0], [1, 2, np.nan, 4])
    frame["id"] = [1.0, 1.0, 1.0, 1.0]
    frame.to_parquet(tmp_path / "t.parquet")
    assert list(read(tmp_path / "t.parquet")["individual"].values) == ["1"]
    frame["id"] = [1.0, 1.0, None, 1.0]
    frame.to_parquet(tmp_path / "t.parquet")
    with pytest.raises(InputError, match="row 2 has no individual"):
        read(tmp_path / "t.parquet")
    frame["id"] = "goat"
    frame["x"] = ["a", "b", "c", "d"]
    frame.to_parquet(tmp_path / "t.parquet")
    with pytest.raises(InputError, match=r"column 'x' holds (large_)?string, not numbers"):
        read(tmp_path / "t.parquet")
    frame["x"] = [1, 2, np.inf, 4]
    frame.to_parquet(tmp_path / "t.parquet")
    with pytest.raises(InputError, match="row 2, column 'x' is inf"):
        read(tmp_path / "t.parquet")


def test_a_large_table_is_read_in_blocks(table):
    """45 000 rows are three blocks; the cell that is wrong lies in the last."""
    rows = [f"{f},{f}.25,{-f}" for f in range(45_000)]
    tracks = read(table("frame,x1,y1\n" + "\n".join(rows)), fps=10)
    np.testing.assert_array_equal(positions(tracks)[:, 0, 0], np.arange(45_000) + 0.25)
    rows[44_990] = "44990,zero,0"
    with pytest.raises(InputError, match="line 44992, column 'x1': 'zero'"):
        read(table("frame,x1,y1\n" + "\n".join(rows)), fps=10)


def test_numbers_come_back_to_the_last_bit(table):
    values = np.random.default_rng(1).normal(size=(100, 2)) * 10.0 ** np.arange(-49, 51)[:, None]
    values = np.clip(values, -1e11, 1e11)
    rows = "\n".join(f"{x!r},{y!r}" for x, y in values.tolist())
    np.testing.assert_array_equal(positions(read(table(f"x1,y1\n{rows}"), fps=1))[:, 0], values)
