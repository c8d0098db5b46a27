"""Pickled dictionaries of arrays, read without letting the pickle run anything.

A pickle is a program: it names functions and calls them. Here the only names understood are those
that numpy's arrays, a few containers and paths need, and each stands for something harmless of our
own that builds the array itself; any other name ends the reading.
"""

import collections
import io
import math
import pickle
import pickletools
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.io.numpy_files import NPY_MAGIC
from swarmssm.io.opening import reading, shorten

__all__ = ["is_pickle", "load_pickled_dict"]

#: Opcodes that point to what lies outside of the pickle.
REFUSED_OPCODES = {"NEXT_BUFFER", "EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID"}
SIMPLE_KINDS = "biufcSU"


def is_pickle(start: bytes) -> bool:
    """Return whether bytes begin as a pickle of protocol 2 to 5 does."""
    return len(start) > 1 and start[0] == 0x80 and 2 <= start[1] <= 5


def load_pickled_dict(path: Path) -> dict[str, Any]:
    """Return the dictionary of a ``.pickle`` file, or of an ``.npy`` file that holds only it.

    Parameters
    ----------
    path
        The file. It is not trusted.

    Returns
    -------
    The dictionary; arrays in it, and in dictionaries directly in it, are numpy arrays.

    Raises
    ------
    InputError
        If it is damaged, names anything but arrays and containers, or holds no dictionary.
    """
    with reading(path, "pickle"):
        data = path.read_bytes()
        if data.startswith(NPY_MAGIC):
            stream = io.BytesIO(data)
            if np.lib.format.read_magic(stream) == (1, 0):
                np.lib.format.read_array_header_1_0(stream)
            else:
                np.lib.format.read_array_header_2_0(stream)
            data = data[stream.tell() :]
        _check_opcodes(path, data)
        unpickler = _Unpickler(io.BytesIO(data), path)
        content = unpickler.load()
        if isinstance(content, _Array):
            values = content.values
            content = values[0] if isinstance(values, list) and len(values) == 1 else None
        if not isinstance(content, dict):
            raise InputError(f"{path}: its pickle holds no dictionary, as idtracker.ai writes one.")
        return {str(key): _resolved(value, depth=1) for key, value in content.items()}


def _check_opcodes(path: Path, data: bytes) -> None:
    """Walk through the pickle without running it.

    A text or number longer than the pickle ends the walk; an entry of the memo beyond its length
    would make Python ask for memory up to there.
    """
    for opcode, argument, _ in pickletools.genops(data):
        too_far = "PUT" in opcode.name and isinstance(argument, int) and argument > len(data)
        if opcode.name in REFUSED_OPCODES or too_far:
            raise InputError(f"{path}: its pickle has the opcode {opcode.name}; it is not trusted.")


class _Array:
    """Stands for an array while the pickle is read; filled by the state that follows."""

    __slots__ = ("values",)

    def __init__(self) -> None:
        self.values: Any = None

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, fortran, data = state
        if isinstance(dtype, _Dtype) and dtype.spec == "O8":
            if not isinstance(data, list) or math.prod(shape) != len(data):
                raise pickle.UnpicklingError("an array of objects without its list")
            self.values = data
        else:
            self.values = _from_bytes(dtype, shape, data, "F" if fortran else "C")


class _Dtype:
    """Stands for a dtype of plain numbers or text while the pickle is read."""

    __slots__ = ("order", "spec")

    def __init__(self, spec: str) -> None:
        self.spec = spec
        self.order = "="

    def __setstate__(self, state: Any) -> None:
        if any(part is not None for part in state[2:5]):
            raise pickle.UnpicklingError("a dtype with fields")
        self.order = str(state[1])


class _Name:
    """What a name in the pickle stands for; has nothing that the pickle could set."""

    __slots__ = ()


class _Ndarray(_Name):
    __slots__ = ()


class _DtypeOf(_Name):
    __slots__ = ()

    def __call__(self, spec: Any, *_: Any) -> _Dtype:
        return _Dtype(str(spec))


class _Reconstruct(_Name):
    """An empty array, whose state follows."""

    __slots__ = ()

    def __call__(self, *_: Any) -> _Array:
        return _Array()


class _FromBuffer(_Name):
    """An array, as protocol 5 writes it."""

    __slots__ = ()

    def __call__(self, data: Any, dtype: Any, shape: Any, order: str) -> _Array:
        array = _Array()
        array.values = _from_bytes(dtype, shape, data, order)
        return array


class _Scalar(_Name):
    __slots__ = ()

    def __call__(self, dtype: Any, data: Any) -> Any:
        return _from_bytes(dtype, (), data, "C")[()]


class _Encode(_Name):
    """Bytes, as protocol 2 writes them."""

    __slots__ = ()

    def __call__(self, text: str, encoding: str) -> bytes:
        if encoding != "latin1":
            raise pickle.UnpicklingError("an encoding that no array needs")
        return text.encode("latin1")


class _NoBytes(_Name):
    """Empty bytes, as protocol 2 writes them."""

    __slots__ = ()

    def __call__(self) -> bytes:
        return b""


class _PathOf(_Name):
    __slots__ = ()

    def __call__(self, *parts: str) -> str:
        return str(PurePosixPath(*parts))


NAMES: dict[tuple[str, str], Any] = {
    ("numpy.core.multiarray", "_reconstruct"): _Reconstruct(),
    ("numpy.core.multiarray", "scalar"): _Scalar(),
    ("numpy.core.numeric", "_frombuffer"): _FromBuffer(),
    ("numpy", "ndarray"): _Ndarray(),
    ("numpy", "dtype"): _DtypeOf(),
    ("_codecs", "encode"): _Encode(),
    ("collections", "OrderedDict"): collections.OrderedDict,
    ("builtins", "bytes"): _NoBytes(),
    ("builtins", "set"): set,
    ("builtins", "frozenset"): frozenset,
    ("builtins", "complex"): complex,
    ("pathlib", "PosixPath"): _PathOf(),
    ("pathlib", "WindowsPath"): _PathOf(),
}


#: Where Python 2 and 3.13, and numpy 2, keep these names.
MOVED = {
    "__builtin__": "builtins",
    "pathlib._local": "pathlib",
    "numpy._core.multiarray": "numpy.core.multiarray",
    "numpy._core.numeric": "numpy.core.numeric",
}


class _Unpickler(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, path: Path) -> None:
        super().__init__(stream)
        self._path = path

    def find_class(self, module: str, name: str) -> Any:
        """Return what we have for a name, never what it names."""
        home = MOVED.get(module, module)
        if (home, name) not in NAMES:
            raise InputError(
                f"{self._path}: its pickle calls {shorten(f'{module}.{name}')}, which no file of "
                "trajectories needs. It was not run; get the recording as h5 or csv."
            )
        return NAMES[home, name]


def _from_bytes(dtype: Any, shape: Any, data: Any, order: str) -> npt.NDArray[Any]:
    """Return an array from its bytes, whose number must be right."""
    if not isinstance(dtype, _Dtype) or dtype.order not in ("<", ">", "=", "|"):
        raise pickle.UnpicklingError("an array without a dtype")
    kind = np.dtype(dtype.spec)
    if kind.kind not in SIMPLE_KINDS or not kind.itemsize:
        raise pickle.UnpicklingError("an array of no plain numbers")
    if math.prod(shape) * kind.itemsize != len(data):
        raise pickle.UnpicklingError("an array of the wrong size")
    if dtype.order == ">":
        kind = kind.newbyteorder(">")
    return np.frombuffer(data, kind).reshape(tuple(shape), order="F" if order == "F" else "C")


def _resolved(value: Any, depth: int) -> Any:
    """Return a value with real arrays in it."""
    if isinstance(value, _Array):
        return value.values
    if isinstance(value, dict) and depth:
        return {key: _resolved(item, depth - 1) for key, item in value.items()}
    return value
