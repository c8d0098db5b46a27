"""Whatever bytes a file holds, the answer is tracks or one sentence of InputError.

Warnings are errors in this suite, so that a reader that warns fails here too. ``SWARMSSM_FUZZ=50``
in the environment looks at fifty times as many files.
"""

import functools
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from io_samples import (
    MOTION,
    idtrackerai_dict,
    long_text,
    trex_arrays,
    visual_field_arrays,
    wide_text,
    write_idtracker,
    write_idtrackerai_csv,
    write_idtrackerai_h5,
    write_idtrackerai_parquet,
    write_idtrackerai_tidy,
    write_trex,
    write_visual_field,
)

from swarmssm.errors import InputError
from swarmssm.io import read, write
from swarmssm.io.text import TextTable
from swarmssm.tracks import make_tracks, validate_tracks

THOROUGHNESS = int(os.environ.get("SWARMSSM_FUZZ", "1"))


def check(path, **options):
    """Read a file; refuse any answer but tracks or a sentence."""
    try:
        tracks = read(path, **options)
    except InputError as error:
        sentence = str(error)
        assert "\n" not in sentence
        assert len(sentence) < 1000
        return
    assert isinstance(tracks, xr.Dataset)
    xr.testing.assert_identical(validate_tracks(tracks), tracks)


def answer(path, fps):
    """Return tracks as comparable values, or the sentence."""
    try:
        return repr(read(path, fps=fps).to_dict())
    except InputError as error:
        return str(error)


def write_csv_of_trex(path):
    rows = "".join(f"{f},{f}.5,{f},264,{f / 25}\n" for f in range(6))
    path.write_text(f"frame,X#wcentroid (cm),Y#wcentroid (cm),num_pixels,time\n{rows}")


def save(function, *arrays, **named):
    """Return a writer that uses one of numpy's, whatever the name of the file."""

    def writer(path):
        with path.open("wb") as stream:
            function(stream, *arrays, **named)

    return writer


BINARY = {
    "npz": save(np.savez, xy=MOTION, fps=5.0, frame=np.arange(6), id=[1, 2, 3]),
    "npz-deflated": save(np.savez_compressed, X=np.ones((2, 6, 3, 4)), dt=0.1),
    "npy": save(np.save, MOTION),
    "trex": save(np.savez, **trex_arrays(0, version=2)),
    "netcdf": lambda p: write(make_tracks(MOTION, fps=25, attrs={"note": "a"}), p, overwrite=True),
    "idtrackerai-h5": lambda p: write_idtrackerai_h5(p, idtrackerai_dict()),
    "idtrackerai-npy": save(np.save, idtrackerai_dict()),
    "idtrackerai-parquet": lambda p: write_idtrackerai_parquet(p, idtrackerai_dict()),
}
TEXT = {
    "long": lambda p: p.write_text("trial,time," + long_text().replace("\n", "\n1,0.5,")[:-6]),
    "wide": lambda p: p.write_text(wide_text()),
    "idtracker": write_idtracker,
    "trex-csv": write_csv_of_trex,
    "time": lambda p: p.write_text("time,x1,y1\n0,1,2\n0.1,2,3\n0.2,3,4\n"),
}
FOLDERS = {
    "trex": write_trex,
    "trex-fields": lambda p: write_visual_field(
        write_trex(p), "fish0", visual_field_arrays(0, [[1], [2]], [0, 1], rays=8)
    ),
    "trex-split-fields": lambda p: write_visual_field(
        write_trex(p), "fish0", visual_field_arrays(0, [[1], [2]], [0, 1], rays=8), split=True
    ),
    "idtrackerai-csv": lambda p: write_idtrackerai_csv(p / "trajectories_csv", idtrackerai_dict()),
    "idtrackerai-tidy": lambda p: write_idtrackerai_tidy(p, idtrackerai_dict()),
}


@functools.cache
def sample(writer):
    """Return the bytes that a writer writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        writer(path)
        return path.read_bytes()


@st.composite
def damaged(draw, whole):
    """Return bytes of which a few are others, or the end is missing."""
    data = bytearray(whole)
    places = st.integers(0, len(data) - 1)
    for place in draw(st.lists(places, max_size=8)):
        data[place] = draw(st.sampled_from([0, 1, 127, 128, 255]) | st.integers(0, 255))
    if draw(st.integers(0, 4)) == 0:
        del data[draw(places) :]
    return bytes(data)


TOKENS = ["", ",", ";", "\t", "\n", '"', "'", "nan", "inf", "-1", "1e308", "1e999", "9" * 30, "x1"]
TOKENS += ["é", "\0", "\r", "-", "0", "1.5", "2020-01-01", "time", "frame", "id", "#", "\ufeff"]


@st.composite
def edited(draw, whole):
    """Return a text with some pieces cut out and others put in."""
    text = whole.decode()
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        stop = start + draw(st.integers(0, 8))
        text = text[:start] + draw(st.sampled_from(TOKENS)) + text[stop:]
    return text.encode(draw(st.sampled_from(["utf-8", "utf-16", "utf-8-sig"])))


FPS = st.sampled_from([None, 25.0])


@given(st.binary(max_size=300), FPS)
@settings(max_examples=100 * THOROUGHNESS)
def test_random_bytes(tmp_path_factory, data, fps):
    path = tmp_path_factory.getbasetemp() / "random.csv"
    path.write_bytes(data)
    check(path, fps=fps)


@pytest.mark.parametrize(
    "magic", [b"PK\x03\x04", b"\x93NUMPY", b"\x89HDF\r\n\x1a\n", b"PAR1", b"\x80\x04"]
)
@given(data=st.binary(max_size=200))
@settings(max_examples=15 * THOROUGHNESS)
def test_random_bytes_after_a_signature(tmp_path_factory, magic, data):
    path = tmp_path_factory.getbasetemp() / "random.bin"
    path.write_bytes(magic + data)
    check(path, fps=25)


@pytest.mark.parametrize("kind", list(BINARY))
@given(data=st.data())
@settings(max_examples=30 * THOROUGHNESS)
def test_damaged_binary_files(tmp_path_factory, kind, data):
    whole = sample(BINARY[kind])
    path = tmp_path_factory.getbasetemp() / "damaged"
    path.write_bytes(data.draw(damaged(whole)))
    options = {"allow_pickle": True, "format": "idtrackerai"} if kind == "idtrackerai-npy" else {}
    check(path, fps=25, **options)


@pytest.mark.parametrize("kind", list(TEXT))
@given(data=st.data(), fps=FPS)
@settings(max_examples=50 * THOROUGHNESS)
def test_edited_texts(tmp_path_factory, kind, data, fps):
    whole = sample(TEXT[kind])
    path = tmp_path_factory.getbasetemp() / "edited.txt"
    path.write_bytes(data.draw(edited(whole)))
    check(path, fps=fps)
    fast = answer(path, fps)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TextTable, "_load_at_once", lambda *_: None)
        assert answer(path, fps) == fast


@pytest.mark.parametrize("kind", list(FOLDERS))
@given(data=st.data())
@settings(max_examples=20 * THOROUGHNESS)
def test_a_damaged_file_in_a_folder(kind, data):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        FOLDERS[kind](folder)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        path = data.draw(st.sampled_from(files))
        whole = path.read_bytes()
        if path.suffix in (".csv", ".json"):
            path.write_bytes(data.draw(edited(whole) | damaged(whole)))
        else:
            path.write_bytes(data.draw(damaged(whole)))
        check(folder, fps=25)


numbers = st.floats(width=64) | st.sampled_from([0.0, 1.0, 2.0, 3.0, 0.1, 1e-300, 1e300, -1.0])


@given(
    st.lists(numbers, min_size=1, max_size=6), st.lists(numbers, min_size=1, max_size=6), numbers
)
@settings(max_examples=50 * THOROUGHNESS)
def test_any_numbers_in_the_arrays(tmp_path_factory, frames, times, fps):
    rows = min(len(frames), len(times))
    path = tmp_path_factory.getbasetemp() / "numbers.npz"
    arrays = {"frame": frames[:rows], "time_s": times[:rows], "fps": fps}
    xy = np.full((rows, 2, 2), frames[0])
    for chosen in (["frame", "fps"], ["time_s"], ["time_s", "fps"], list(arrays)):
        np.savez(path, xy=xy, **{name: np.array(arrays[name]) for name in chosen})
        check(path)
