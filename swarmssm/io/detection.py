"""Telling formats apart by what is in a file or folder, whatever its name."""

import contextlib
from pathlib import Path

from swarmssm.errors import InputError
from swarmssm.io.arrays import POSITION_KEYS
from swarmssm.io.assembly import named_list
from swarmssm.io.hdf5 import HDF5_MAGIC, open_hdf5
from swarmssm.io.idtracker import FILE_NAMES, is_idtracker_header
from swarmssm.io.idtrackerai import PARQUET_KEY, TIDY_COLUMNS, find_session_file
from swarmssm.io.numpy_files import NPY_MAGIC, NumpyArchive, holds_objects
from swarmssm.io.opening import first_bytes
from swarmssm.io.parquet import PARQUET_MAGIC, ParquetTable
from swarmssm.io.pickled import is_pickle
from swarmssm.io.text import TextTable
from swarmssm.io.trex import is_trex_archive
from swarmssm.io.trex_csv import is_trex_header
from swarmssm.io.trex_files import is_companion
from swarmssm.io.trex_visual_field import FIELD

__all__ = ["detect_format"]

ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
#: First bytes of what users name by mistake, and what to do instead.
OTHERS = {
    b"\x1f\x8b": "it is compressed with gzip; unpack it first",
    b"BZh": "it is compressed with bzip2; unpack it first",
    b"CDF\x01": "it is NetCDF of version 3; save it as NetCDF-4",
    b"CDF\x02": "it is NetCDF of version 3; save it as NetCDF-4",
    b"CDF\x05": "it is NetCDF of version 3; save it as NetCDF-4",
    b"%PDF": "it is a PDF; name the file of the tracks",
    b"\xd0\xcf\x11\xe0": "it is an Excel file; save the table as csv",
    b"MATLAB": "it is a Matlab file; save the positions as csv",
    b"RIFF": "it is a video; track it first, and name the tracks",
    b"PV": "it is a video of TRex; track it first, and name the folder of the npz files",
}


def detect_format(path: Path) -> str:
    """Return the format of a file or folder that exists.

    Parameters
    ----------
    path
        The file or folder.

    Returns
    -------
    A key of :data:`swarmssm.io.reading.FORMATS`.

    Raises
    ------
    InputError
        If it holds tracks in none of the formats, saying what it looks like.
    """
    return _of_folder(path) if path.is_dir() else _of_file(path)


def _of_folder(path: Path) -> str:
    npz = [file for file in sorted(path.glob("*.npz")) if not is_companion(file)]
    if any(is_trex_archive(file) for file in npz):
        return "trex"
    if find_session_file(path) is not None:
        return "idtrackerai"
    if any((path / name).is_file() for name in FILE_NAMES):
        return "idtracker"
    for file in sorted(path.glob("*.csv")):
        if not is_companion(file) and is_trex_header(TextTable(file).names):
            return "trex-csv"
    if any(FIELD.fullmatch(file.stem) for file in path.glob("*.npz")):
        return "trex"
    inner = ""
    with contextlib.suppress(InputError):
        inner = _of_folder(path / "data") if (path / "data").is_dir() else ""
    if inner.startswith("trex"):
        raise InputError(f"{path}: TRex's files lie in its folder data. Name {path / 'data'}.")
    held = named_list(sorted(file.name for file in path.iterdir()), 4) or "nothing"
    raise InputError(
        f"{path}: no tracks were found in this folder (it holds {held}). Name the file of the "
        "tracks, or the folder into which TRex or idtracker.ai exported."
    )


def _of_file(path: Path) -> str:
    start = first_bytes(path)
    if start.startswith(ZIP_MAGICS):
        return _of_archive(path)
    if start.startswith(NPY_MAGIC):
        return "idtrackerai" if holds_objects(path) else "arrays"
    if is_pickle(start):
        return "idtrackerai"
    if start.startswith(HDF5_MAGIC):
        with open_hdf5(path, "HDF5 file") as file:
            keys = [str(key) for key in file]
        if "trajectories" in keys:
            return "idtrackerai"
        if "position" in keys:
            return "netcdf"
        raise InputError(
            f"{path}: this HDF5 file has neither position (NetCDF of tracks) nor trajectories "
            f"(idtracker.ai), but {named_list(keys) or 'nothing'}."
        )
    if start.startswith(PARQUET_MAGIC):
        return "idtrackerai" if PARQUET_KEY in ParquetTable(path).metadata else "table"
    for magic, words in OTHERS.items():
        if start.startswith(magic):
            raise InputError(f"{path}: this is not a file of tracks: {words}.")
    return _of_text(path)


def _of_archive(path: Path) -> str:
    with NumpyArchive(path) as archive:
        keys = archive.keys
    if is_trex_archive(path):
        return "trex"
    if any(key in keys for key in POSITION_KEYS):
        return "arrays"
    if FIELD.fullmatch(path.stem) or is_companion(path):
        raise InputError(
            f"{path}: this file of TRex holds no tracks, but what belongs to them. Name its folder."
        )
    raise InputError(
        f"{path}: it holds the arrays {named_list(keys) or '(none)'}, and no tracks are recognised "
        "among them. Name positions xy, with the shape (time, individual, 2)."
    )


def _of_text(path: Path) -> str:
    names = TextTable(path).names
    if is_trex_header(names):
        return "trex-csv"
    if is_idtracker_header(names):
        return "idtracker"
    if names == TIDY_COLUMNS and path.with_name("attributes_tidy.json").is_file():
        return "idtrackerai"
    if path.name == "trajectories.csv" and path.with_name("attributes.json").is_file():
        return "idtrackerai"
    return "table"
