"""Files that cannot be read: one sentence that names the file, and nothing else."""

import contextlib
import os
import struct
import tempfile
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from io_samples import (
    MOTION,
    idtrackerai_dict,
    long_text,
    trex_arrays,
    write_idtrackerai_h5,
    write_idtrackerai_parquet,
    write_trex,
)

from swarmssm.errors import InputError
from swarmssm.io import FORMATS, read, write
from swarmssm.io.opening import reading
from swarmssm.tracks import make_tracks


def refused(path, sentence, **options):
    with pytest.raises(InputError, match=sentence) as caught:
        read(path, **options)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 500
    assert "\n" not in str(caught.value)


@contextlib.contextmanager
def no_privileges():
    """Be nobody for a moment: the superuser may read everything."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_absent(tmp_path):
    refused(tmp_path / "no.csv", "there is no such file or folder. Check the name")
    refused(tmp_path / ("a" * 300), "cannot be read")
    with pytest.raises(InputError, match="cannot be read"):
        read("a\0b")


@pytest.mark.parametrize("format", ["auto", *FORMATS])
def test_a_folder_of_nothing(tmp_path, format):
    refused(tmp_path, "no tracks were found|it holds no|this is a folder", format=format)


def test_a_folder_of_something_else(tmp_path):
    for name in ("a.txt", "b.npz", "c.csv"):
        (tmp_path / name).mkdir() if name[0] == "a" else None
    np.savez(tmp_path / "b.npz", weights=np.zeros(3))
    (tmp_path / "c.csv").write_text("day,weather\n1,sun\n")
    refused(tmp_path, r"no tracks were found in this folder \(it holds a.txt, b.npz, c.csv\)")


@pytest.mark.parametrize("format", ["auto", *FORMATS])
def test_an_empty_file(tmp_path, format):
    (tmp_path / "t.csv").touch()
    refused(tmp_path / "t.csv", "is empty|not a whole", format=format)


@pytest.fixture
def open_folder():
    """Return a folder that anyone may look into; pytest's own are private."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


def test_permission_denied(open_folder):
    path = open_folder / "t.csv"
    path.write_text(long_text())
    path.chmod(0)
    with no_privileges(), pytest.raises(InputError, match=r"cannot be read \(Permission denied\)"):
        read(path, fps=5)


def test_a_folder_that_may_not_be_listed(open_folder):
    folder = write_trex(open_folder / "data")
    folder.chmod(0)
    for path in (folder, folder / "video_fish0.npz"):
        with no_privileges(), pytest.raises(InputError, match=r"cannot be read \(Permission deni"):
            read(path)
    folder.chmod(0o700)


def test_neither_file_nor_folder(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    refused(tmp_path / "pipe", "this is neither a file nor a folder")
    refused("/dev/zero", "this is neither a file nor a folder")


@pytest.mark.parametrize(
    ("start", "sentence"),
    [
        (b"\x1f\x8b\x08\x00", "compressed with gzip; unpack it"),
        (b"CDF\x01\x00\x00", "NetCDF of version 3"),
        (b"%PDF-1.4", "it is a PDF"),
        (b"MATLAB 5.0 MAT-file", "save the positions as csv"),
        (b"RIFF....AVI ", "it is a video; track it first"),
        (b"PV7...", "a video of TRex; track it first"),
        (b"\xd0\xcf\x11\xe0", "an Excel file; save the table as csv"),
    ],
)
def test_what_is_named_by_mistake(tmp_path, start, sentence):
    (tmp_path / "tracks.csv").write_bytes(start + bytes(100))
    refused(tmp_path / "tracks.csv", sentence)


def test_a_zip_that_is_no_npz(tmp_path):
    with zipfile.ZipFile(tmp_path / "book.xlsx", "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    refused(tmp_path / "book.xlsx", r"holds the arrays \(none\), and no tracks are recognised")


def write_samples(folder):
    np.savez(folder / "xy.npz", xy=MOTION, fps=5)
    np.savez_compressed(folder / "xyz.npz", xy=MOTION, fps=5)
    np.savez(folder / "v_fish0.npz", **trex_arrays(0))
    np.save(folder / "a.npy", MOTION)
    np.save(folder / "i.npy", idtrackerai_dict())
    write(make_tracks(MOTION, fps=25), folder / "t.nc")
    write_idtrackerai_h5(folder / "t.h5", idtrackerai_dict())
    write_idtrackerai_parquet(folder / "t.parquet", idtrackerai_dict())


def test_cut_short_anywhere(tmp_path):
    """Whatever is cut off, down to the last byte, the file is refused."""
    write_samples(tmp_path)
    for path in sorted(tmp_path.iterdir()):
        options = {"fps": 25, "allow_pickle": True} if path.name == "i.npy" else {"fps": 25}
        whole = path.read_bytes()
        assert read(path, **options) is not None
        for size in {1, 7, 40, len(whole) // 3, len(whole) // 2, len(whole) - 1}:
            path.write_bytes(whole[:size])
            plain = {"fps": 25} if size < 20 else options
            refused(path, "not a whole|not a text file|no columns|no header|no such|hold", **plain)


def npy_header(shape, descr="<f8"):
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.parametrize("shape", ["(1000000000000, 3, 2)", "(-6, 3, 2)", "(6, 3, 99999999999)"])
def test_giant_claims_in_numpy_files(tmp_path, shape):
    data = npy_header(shape) + MOTION.tobytes()
    (tmp_path / "a.npy").write_bytes(data)
    refused(tmp_path / "a.npy", "cannot hold|claims the shape", fps=5)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("xy.npy", data)
    refused(tmp_path / "a.npz", "cannot hold|claims the shape", fps=5)


def test_a_header_that_the_file_does_not_bear_out(tmp_path):
    for shape in ("(7, 3, 2)", "(5, 3, 2)"):
        (tmp_path / "a.npy").write_bytes(npy_header(shape) + MOTION.tobytes())
        refused(tmp_path / "a.npy", "not a whole npy file", fps=5)


def test_objects_in_plain_arrays(tmp_path):
    np.savez(tmp_path / "a.npz", xy=np.array([{}], dtype=object), fps=5)
    refused(tmp_path / "a.npz", "array xy holds pickled objects, which can run any code")


@pytest.mark.parametrize("chunks", [None, (1024, 3, 2)])
def test_giant_claims_in_hdf5(tmp_path, chunks):
    """HDF5 does not store what was never written, so that a small file may claim anything."""
    for name, key in (("t.h5", "trajectories"), ("t.nc", "position")):
        with h5py.File(tmp_path / name, "w") as file:
            file.create_dataset(key, (10**11, 3, 2), "f8", chunks=chunks)
        refused(tmp_path / name, rf"array {key} claims 4.8e\+03 GB, which a file of \d+ bytes")


def test_more_than_the_memory(tmp_path, monkeypatch):
    np.savez(tmp_path / "a.npz", xy=MOTION, fps=5)
    monkeypatch.setattr(os, "sysconf", lambda _: 10)
    refused(tmp_path / "a.npz", r"would take .* GB, and this machine has 1e-07 GB")


def test_a_system_that_does_not_tell_its_memory(tmp_path, monkeypatch):
    def sysconf(_):
        raise ValueError("unrecognized configuration name")

    np.savez(tmp_path / "a.npz", xy=MOTION, fps=5)
    monkeypatch.setattr(os, "sysconf", sysconf)
    assert read(tmp_path / "a.npz").sizes["time"] == 6


def test_damage_inside_is_found_by_checksums(tmp_path):
    np.savez(tmp_path / "a.npz", xy=MOTION, fps=5)
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[data.index(MOTION.tobytes()[:16]) + 40] ^= 1
    (tmp_path / "a.npz").write_bytes(data)
    refused(tmp_path / "a.npz", "not a whole npz file")


def test_a_damaged_text_collection_does_not_hang(tmp_path):
    """The HDF5 library turns for ever in a collection with an object of size 0."""
    path = tmp_path / "t.nc"
    write(make_tracks(MOTION, fps=25, attrs={"note": "text"}), path)
    data = bytearray(path.read_bytes())
    collection = data.index(b"GCOL")
    index, _, _, size = struct.unpack_from("<HHIQ", data, collection + 16)
    assert index > 0
    for new_index, new_size in ((0, 0), (0, 8), (index, 2**40), (index, size + 1000)):
        struct.pack_into("<HHIQ", data, collection + 16, new_index, 1, 0, new_size)
        path.write_bytes(data)
        refused(path, "not a whole HDF5 file")


def test_texts_that_claim_more_than_the_file(tmp_path):
    with h5py.File(tmp_path / "t.nc", "w") as file:
        file["position"] = np.zeros((5, 2, 3))
        file.create_dataset("names", (10**6,), h5py.string_dtype(), chunks=True)
    refused(tmp_path / "t.nc", "not a whole HDF5 file")


def test_an_attribute_that_claims_more_than_the_file(tmp_path):
    path = tmp_path / "t.nc"
    with h5py.File(path, "w") as file:
        file["position"] = np.zeros((5, 2, 3))
        file.attrs["counts"] = np.arange(7, dtype=np.int64)
    data = bytearray(path.read_bytes())
    # Version 1, one dimension: its size and, twice as it may not grow, its largest size.
    space = data.index(struct.pack("<BBB5xQQ", 1, 1, 1, 7, 7))
    struct.pack_into("<QQ", data, space + 8, 7 * 10**6, 7 * 10**6)
    path.write_bytes(data)
    refused(path, "not a whole HDF5 file")


def test_types_that_a_damaged_text_turns_into(tmp_path):
    """The HDF5 library crashes on a text that damage has made a sequence: none is read."""
    for name in ("attribute", "dataset"):
        with h5py.File(tmp_path / "t.nc", "w") as file:
            file["position"] = np.zeros((5, 2, 3))
            sequence = h5py.vlen_dtype(np.int8)
            if name == "attribute":
                note = np.empty(1, dtype=object)
                note[0] = np.zeros(3, np.int8)
                file.attrs.create("note", note, dtype=sequence)
            else:
                file.create_dataset("note", (1,), sequence)
        refused(tmp_path / "t.nc", "not a whole HDF5 file")


def test_whatever_a_library_raises_is_a_sentence(tmp_path):
    path = tmp_path / "t.nc"
    for raised, sentence in (
        (MemoryError(), "it needs more memory than this machine has"),
        (OSError(5, "Input/output error"), r"cannot be read \(Input/output error\)"),
        (OSError("no number"), "this is not a whole file of a kind; it is cut short or damaged"),
        (KeyError("x"), "this is not a whole file of a kind"),
        (InputError("said already"), "^said already$"),
    ):
        with pytest.raises(InputError, match=sentence), reading(path, "file of a kind"):
            raise raised
    with pytest.raises(KeyboardInterrupt), reading(path, "file of a kind"):
        raise KeyboardInterrupt


def test_one_bad_file_of_many_is_named(tmp_path):
    write_trex(tmp_path)
    path = tmp_path / "video_fish1.npz"
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match=r"video_fish1.npz: this is not a whole npz file"):
        read(tmp_path)


def test_no_sentence_comes_with_a_warning(tmp_path, recwarn):
    (tmp_path / "a.npy").write_bytes(npy_header("(6L, 3L, 2L)") + MOTION.tobytes())
    read(tmp_path / "a.npy", fps=5)
    np.savez(tmp_path / "b.npz", xy=np.full((6, 3, 2), 1e300), fps=5)
    refused(tmp_path / "b.npz", r"x = 1e\+300")
    assert not recwarn.list
