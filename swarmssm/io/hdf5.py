"""HDF5 files whose headers are not to be trusted."""

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from swarmssm.errors import InputError
from swarmssm.io.opening import check_claim, reading

__all__ = ["HDF5_MAGIC", "open_hdf5"]

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
#: Start of a collection of texts and references of varying length (HDF5 file format, III.E):
#: signature, version 1, three reserved bytes; then its size.
COLLECTION = b"GCOL\x01\0\0\0"
COLLECTION_HEADER = struct.Struct("<8sQ")
#: Index, count of references, reserved, size of what follows (padded to 8); index 0 is free space,
#: whose size counts this header too.
OBJECT_HEADER = struct.Struct("<HHIQ")


@contextmanager
def open_hdf5(path: Path, kind: str) -> Iterator[h5py.File]:
    """Open an HDF5 file whose every array may be read.

    Whatever is raised while it is open becomes an :class:`~swarmssm.errors.InputError`.

    Parameters
    ----------
    path
        The file.
    kind
        What it should be, for the sentence.

    Raises
    ------
    InputError
        If it is damaged, one of its arrays claims more than the file can hold, or an array's
        values lie in another file (which could be any file of this machine).
    """
    with reading(path, kind):
        _check_collections(path)
        with h5py.File(path, "r") as file:
            _check_attributes(file)
            file.visititems(lambda name, item: _check_item(path, name, item))
            yield file


def _check_item(path: Path, name: str, item: h5py.Group | h5py.Dataset) -> None:
    _check_attributes(item)
    if not isinstance(item, h5py.Dataset):
        return
    if item.external or item.is_virtual:
        raise InputError(
            f"{path}: the values of {name} lie in another file. Copy them into this one."
        )
    check_claim(path, name, item.shape or (), item.dtype.itemsize)
    _check_type(item.id.get_type(), name)
    if item.dtype.hasobject and item.size > path.stat().st_size:
        raise ValueError("more texts than bytes")


def _check_attributes(item: h5py.Group | h5py.Dataset) -> None:
    for name in item.attrs:
        _check_type(item.attrs.get_id(name).get_type(), name)


def _check_type(kind: h5py.h5t.TypeID, name: str) -> None:
    """Refuse types that no file of tracks has, for which a damaged type is easily taken.

    The library (seen with 2.0.0) crashes on a text whose type is damaged so that it has become a
    sequence. Sequences are left to NetCDF's own lists of dimensions.
    """
    found = kind.get_class()
    if found in (h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.ENUM):
        return
    if found == h5py.h5t.STRING:
        sets = (h5py.h5t.CSET_ASCII, h5py.h5t.CSET_UTF8)
        pads = (h5py.h5t.STR_NULLTERM, h5py.h5t.STR_NULLPAD, h5py.h5t.STR_SPACEPAD)
        if kind.get_cset() in sets and kind.get_strpad() in pads:
            return
    elif found == h5py.h5t.VLEN:
        if name == "DIMENSION_LIST" and kind.get_super().get_class() == h5py.h5t.REFERENCE:
            return
    elif found in (h5py.h5t.COMPOUND, h5py.h5t.REFERENCE) and name == "REFERENCE_LIST":
        return
    raise ValueError("an array or attribute of a type that no tracks need")


def _check_collections(path: Path) -> None:
    """Refuse a damaged collection of texts, in which the HDF5 library would turn for ever.

    The library (seen with 2.0.0) walks from object to object by their sizes, and does not leave one
    of size 0, nor can Python interrupt it.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        start = data.find(COLLECTION)
        while start >= 0:
            _, size = COLLECTION_HEADER.unpack_from(data, start)
            place, stop = start + COLLECTION_HEADER.size, start + size
            if stop > len(data):
                raise ValueError("a collection that goes beyond the file")
            while place + OBJECT_HEADER.size <= stop:
                index, _, _, length = OBJECT_HEADER.unpack_from(data, place)
                step = OBJECT_HEADER.size + -(-length // 8) * 8 if index else length
                if step < OBJECT_HEADER.size or step % 8 or place + step > stop:
                    raise ValueError("an object of a collection with a wrong size")
                place += step
            start = data.find(COLLECTION, max(stop, start + 1))
