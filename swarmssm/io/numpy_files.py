"""Arrays from ``.npz`` and ``.npy`` files whose headers are not to be trusted.

``numpy.load`` allocates what a header claims, and offers to unpickle. Here an array is read only
if its header, the archive's directory and the file on disk agree on its size, and never unpickled.
"""

import functools
import io
import math
import zipfile
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.io.opening import check_claim, reading

__all__ = ["NPY_MAGIC", "NumpyArchive", "holds_objects", "read_npy"]

NPY_MAGIC = b"\x93NUMPY"
#: As in numpy: longer ones could crash Python's parser.
MAX_HEADER = 10_000
NumpyArray = npt.NDArray[Any]


class NumpyArchive:
    """The arrays of one ``.npz`` file, read on demand; a context manager.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        If it cannot be opened or is not a whole npz file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with reading(path, "npz file"):
            self._zip = zipfile.ZipFile(path)
            members = self._zip.infolist()
        self._members = {
            info.filename.removesuffix(".npy"): info
            for info in members
            if info.filename.endswith(".npy")
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._zip.close()

    def __contains__(self, key: str) -> bool:
        return key in self._members

    @property
    def keys(self) -> list[str]:
        """Names of the arrays, in the order of the file."""
        return list(self._members)

    def shape(self, key: str) -> tuple[int, ...]:
        """Return the claimed shape of an array without reading it."""
        with reading(self.path, "npz file"), self._zip.open(self._members[key]) as stream:
            return _read_header(stream)[0]

    def read(self, key: str) -> NumpyArray:
        """Return one array.

        Raises
        ------
        InputError
            If it is damaged, cut short, too large for its file, or holds pickled objects.
        """
        info = self._members[key]
        with reading(self.path, "npz file"), self._zip.open(info) as stream:
            return _read_array(stream, info.file_size, self.path, key)

    def numbers(self, key: str, ndim: int | None = None) -> npt.NDArray[np.float64]:
        """Return one array as float64.

        Raises
        ------
        InputError
            As :meth:`read`, and if it does not hold real numbers or has not ``ndim`` dimensions.
        """
        values = self.read(key)
        if values.dtype.kind not in "fiub":
            raise InputError(f"{self.path}: array {key} holds {values.dtype}, not numbers.")
        if ndim is not None and values.ndim != ndim:
            raise InputError(
                f"{self.path}: array {key} has the shape {values.shape}; "
                f"it must have {ndim} dimension{'s' * (ndim != 1)}."
            )
        with np.errstate(over="ignore"):
            return values.astype(np.float64)

    def scalar(self, key: str) -> float:
        """Return the only number of an array of one entry.

        Raises
        ------
        InputError
            As :meth:`numbers`, and if it holds more or fewer than one.
        """
        values = self.numbers(key)
        if values.size != 1:
            raise InputError(
                f"{self.path}: array {key} must hold one number, and has the shape {values.shape}."
            )
        return float(values.reshape(-1)[0])


def holds_objects(path: Path) -> bool:
    """Return whether an ``.npy`` file holds pickled objects instead of plain values.

    Raises
    ------
    InputError
        If its header is damaged.
    """
    with reading(path, "npy file"), path.open("rb") as stream:
        return bool(_read_header(stream)[2].hasobject)


def read_npy(path: Path, *, in_place: bool = False) -> NumpyArray:
    """Return the array of an ``.npy`` file.

    Parameters
    ----------
    path
        The file.
    in_place
        Map it into memory instead of reading it: for files larger than memory.

    Raises
    ------
    InputError
        If it is damaged, cut short, or holds pickled objects.
    """
    with reading(path, "npy file"), path.open("rb") as stream:
        if not in_place:
            return _read_array(stream, path.stat().st_size, path, "")
        shape, fortran, dtype = _read_header(stream)
        _check_plain(path, "", dtype)
        if math.prod(shape) * dtype.itemsize != path.stat().st_size - stream.tell():
            raise ValueError("header and file disagree on the size")
        order = "F" if fortran else "C"
        return np.memmap(path, dtype, "r", stream.tell(), shape, order)  # type: ignore[call-overload, no-any-return]


def _read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, whether in Fortran order, and dtype."""
    version = np.lib.format.read_magic(stream)
    prefix = stream.read(2 if version == (1, 0) else 4)
    length = int.from_bytes(prefix, "little")
    if length > MAX_HEADER:
        raise ValueError("a header that is too long")
    return _parsed_header(version, prefix + stream.read(length))


@functools.lru_cache(maxsize=256)
def _parsed_header(
    version: tuple[int, int], header: bytes
) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Parse a header; in a folder of many files of one kind few differ."""
    stream = io.BytesIO(header)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(stream)
    # Version 3 differs from 2 only in that names of fields may be any text.
    return np.lib.format.read_array_header_2_0(stream)


def _check_plain(path: Path, name: str, dtype: np.dtype[Any]) -> None:
    if dtype.hasobject:
        which = f"array {name}" if name else "the array"
        raise InputError(
            f"{path}: {which} holds pickled objects, which can run any code when they are read. "
            "Save plain numbers."
        )


def _read_array(stream: IO[bytes], size: int, path: Path, name: str) -> NumpyArray:
    """Read one array from a stream of ``size`` bytes."""
    shape, fortran, dtype = _read_header(stream)
    _check_plain(path, name, dtype)
    claimed = check_claim(path, name, shape, dtype.itemsize)
    if claimed != size - stream.tell():
        raise ValueError("header and file disagree on the size")
    if claimed == 0:
        return np.zeros(shape, dtype)
    data = stream.read(claimed)
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
