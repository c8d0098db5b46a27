"""HDF5 files whose headers are not to be trusted."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from swarmssm.errors import InputError
from swarmssm.io.opening import check_claim, reading

__all__ = ["HDF5_MAGIC", "open_hdf5"]

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


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
    with reading(path, kind), h5py.File(path, "r") as file:

        def check(name: str, item: object) -> None:
            if not isinstance(item, h5py.Dataset):
                return
            if item.external or item.is_virtual:
                raise InputError(
                    f"{path}: the values of {name} lie in another file. Copy them into this one."
                )
            check_claim(path, name, item.shape or (), item.dtype.itemsize)

        file.visititems(check)
        yield file
