"""Pickles are read without running what they name."""

import collections
import os
import pickle
from pathlib import PurePosixPath, PureWindowsPath

import numpy as np
import pytest
from io_samples import idtrackerai_dict

from swarmssm.errors import InputError
from swarmssm.io import read
from swarmssm.io.pickled import is_pickle, load_pickled_dict

ARRAYS = {
    "f8": np.arange(6.0).reshape(2, 3),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "big": np.arange(4, dtype=">i4"),
    "bool": np.array([True, False]),
    "text": np.array(["a", "bc"]),
    "none": np.zeros((0, 3)),
    "scalar": np.float64(2.5),
    "integer": np.int64(7),
    "plain": [1, "a", None, {"b": (1, 2)}, {3}, frozenset({4}), b"x", 2j],
    "ordered": collections.OrderedDict(a=1),
}


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_what_trackers_write_comes_back(tmp_path, protocol):
    (tmp_path / "p").write_bytes(pickle.dumps({**ARRAYS, "in": {"f8": ARRAYS["f8"]}}, protocol))
    assert is_pickle((tmp_path / "p").read_bytes())
    loaded = load_pickled_dict(tmp_path / "p")
    for name, value in ARRAYS.items():
        if isinstance(value, np.ndarray):
            assert loaded[name].dtype == value.dtype
            np.testing.assert_array_equal(loaded[name], value)
        else:
            assert loaded[name] == value
    np.testing.assert_array_equal(loaded["in"]["f8"], ARRAYS["f8"])


def test_a_pickle_file_of_a_session(tmp_path):
    (tmp_path / "trajectories.pickle").write_bytes(pickle.dumps(idtrackerai_dict()))
    assert read(tmp_path, allow_pickle=True).sizes["individual"] == 3
    with pytest.raises(InputError, match="this is a pickle"):
        read(tmp_path / "trajectories.pickle")


def test_npy_files(tmp_path):
    said = idtrackerai_dict()
    np.save(tmp_path / "t.npy", said)
    loaded = load_pickled_dict(tmp_path / "t.npy")
    assert loaded.keys() == said.keys()
    np.testing.assert_array_equal(loaded["trajectories"], said["trajectories"])
    np.testing.assert_array_equal(loaded["areas"]["mean"], said["areas"]["mean"])


class Call:
    """Pickles as a call of anything."""

    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


def touch(path):
    return Call(os.system, f"touch {path}")


@pytest.mark.parametrize(
    "evil",
    [
        touch,
        lambda path: Call(open, str(path), "w"),
        lambda path: Call(eval, f"open({str(path)!r}, 'w')"),
        lambda path: Call(getattr, {}, "get"),
        lambda path: Call(np.ndarray.tofile, np.zeros(3), str(path)),
        lambda path: Call(np.lib.format.open_memmap, str(path), "w+", "f8", (3,)),
        lambda path: Call(bytearray, 2**40),
        lambda path: Call(np.zeros, 2**40),
        lambda path: np.array([touch(path)], dtype=object),
    ],
)
@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_code_is_not_run(tmp_path, evil, protocol):
    target = tmp_path / "made"
    (tmp_path / "p").write_bytes(
        pickle.dumps({"trajectories": evil(target), "frames_per_second": 5}, protocol)
    )
    with pytest.raises(InputError, match=r"its pickle calls '.*', which no file of trajectories"):
        load_pickled_dict(tmp_path / "p")
    assert not target.exists()


def test_npy_files_of_version_2(tmp_path):
    header = np.array({"a": 1}, dtype=object)
    with (tmp_path / "t.npy").open("wb") as stream:
        np.lib.format.write_array(stream, header, version=(2, 0))
    assert load_pickled_dict(tmp_path / "t.npy") == {"a": 1}


def test_paths_become_text(tmp_path):
    class PosixPath(PurePosixPath):
        pass

    PosixPath.__module__ = PosixPath.__qualname__ = "pathlib"
    text = pickle.dumps({"a": PurePosixPath("/b/c"), "w": PureWindowsPath("c:/d")}, 4)
    text = text.replace(b"\x8c\x0dPurePosixPath", b"\x8c\x09PosixPath")
    text = text.replace(b"\x8c\x0fPureWindowsPath", b"\x8c\x0bWindowsPath")
    # The frame's length is now wrong; without the frame there is none to be wrong.
    text = text[:2] + text[11:]
    (tmp_path / "p").write_bytes(text)
    loaded = load_pickled_dict(tmp_path / "p")
    assert loaded["a"] == "/b/c"
    assert isinstance(loaded["w"], str)


@pytest.mark.parametrize(
    "content",
    [
        pickle.dumps([1, 2]),
        b"\x80\x04}r\xff\xff\xff\xff.",  # memo entry 4294967295
        b"\x80\x05\x96\xff\xff\xff\xff\xff\x00\x00\x00.",  # bytearray of 2**40 bytes
        b"\x80\x04P12\n.",  # persistent id
        b"\x80\x04\x95",
        b"\x80\x04.",
        pickle.dumps({"a": np.zeros(3)}).replace(b"\x03\x85", b"\x09\x85"),  # shape (9,)
        pickle.dumps({"a": np.zeros(3, dtype=[("x", "f8")])}),
        pickle.dumps({"a": np.zeros(3, dtype="V4")}),
        pickle.dumps({"a": np.array([1, "b"], dtype=object)}).replace(b"K\x02\x85", b"K\x03\x85"),
        pickle.dumps({"a": b"\xff"}, 2).replace(b"latin1", b"utf-16"),
        pickle.dumps({"a": np.zeros(3)}).replace(b"f8", b"X8"),
        pickle.dumps({"a": Call(np._core.numeric._frombuffer, b"12345678", "f8", (1,), "C")}),
    ],
)
def test_damaged_or_strange(tmp_path, content):
    (tmp_path / "p").write_bytes(content)
    with pytest.raises(InputError, match=r"not a whole pickle|its pickle h"):
        load_pickled_dict(tmp_path / "p")
