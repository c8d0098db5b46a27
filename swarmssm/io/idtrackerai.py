"""Tracks of idtracker.ai (versions 3 to 6), in each of the formats it writes.

Romero-Ferrero, F. et al. (2019). idtracker.ai: tracking all individuals in small or large
collectives of unmarked animals. Nature Methods 16:179-182.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.assembly import Piece, assemble
from swarmssm.io.attributes import plain_attribute
from swarmssm.io.clock import clock_of
from swarmssm.io.columns import roles_of
from swarmssm.io.hdf5 import HDF5_MAGIC, open_hdf5
from swarmssm.io.numpy_files import NPY_MAGIC
from swarmssm.io.opening import existing, first_bytes, reading
from swarmssm.io.parquet import PARQUET_MAGIC, ParquetTable
from swarmssm.io.pickled import is_pickle, load_pickled_dict
from swarmssm.io.rows import load_rows, pieces_of
from swarmssm.io.text import Table, TextTable

__all__ = ["PARQUET_KEY", "TIDY_COLUMNS", "find_session_file", "read_idtrackerai"]

#: In the order in which idtracker.ai itself looks for them.
STEMS = (
    "trajectories",
    "validated",
    "without_gaps",
    "with_gaps",
    "trajectories_validated",
    "trajectories_wo_gaps",
    "trajectories_wo_identification",
)
#: Those that need no unpickling first.
ENDINGS = (".h5", ".hdf5", "_csv", "_tidy.csv", ".parquet", ".npy", ".pickle")
PARQUET_KEY = b"idtrackerai_attributes"
TIDY_COLUMNS = ["frame", "time", "individual", "x", "y", "probability"]
#: Arrays that are read as variables, and settings that are read as what they are.
NO_ATTRIBUTES = {
    "trajectories",
    "id_probabilities",
    "areas",
    "frames_per_second",
    "identities_labels",
    "length_unit",
}


def read_idtrackerai(
    path: Path | str, fps: float | None = None, *, allow_pickle: bool = False
) -> xr.Dataset:
    """Read a session of idtracker.ai, in px.

    Parameters
    ----------
    path
        The folder ``session_...``, the folder ``trajectories`` in it, a folder
        ``trajectories_csv``, or a file: ``.h5``, ``.hdf5``, ``_tidy.csv``, ``.parquet``,
        ``.npy`` or ``.pickle``. Of several in a folder the first is taken in idtracker.ai's own
        order (``trajectories``, ``validated``, ``without_gaps`` ...), and HDF5 before text.
    fps
        Frames per second; default is what the session says.
    allow_pickle
        Whether to read ``.npy`` and ``.pickle``. Both are pickles, which can run any code; what
        could run is not run here but refused, so that only damage to what is read is left to fear.

    Returns
    -------
    Tracks with the variable ``id_probability (time, individual)``, areas of the animals where
    known, and the session's settings in ``attrs``.

    Raises
    ------
    InputError
        If there are no trajectories, they are a pickle and ``allow_pickle`` is false, or damaged.
    """
    place = existing(path)
    file = find_session_file(place) if place.is_dir() else place
    if file is None:
        raise InputError(
            f"{place}: it holds no trajectories of idtracker.ai. Name the session folder, or its "
            "folder trajectories."
        )
    if file.is_dir():
        return _from_csv_folder(file, fps)
    start = first_bytes(file)
    if start.startswith(HDF5_MAGIC):
        return _tracks_of(file, _load_hdf5(file), fps)
    if start.startswith(NPY_MAGIC) or is_pickle(start):
        if not allow_pickle:
            raise InputError(
                f"{file}: this is a pickle, and reading one can run code hidden in it. Export h5 "
                "or csv instead (trajectories_formats in idtracker.ai), or add allow_pickle=True."
            )
        return _tracks_of(file, load_pickled_dict(file), fps)
    if start.startswith(PARQUET_MAGIC):
        parquet = ParquetTable(file)
        said = _json(file, parquet.metadata.get(PARQUET_KEY, b"{}"))
        return _from_table(file, parquet, said, fps)
    if file.name == "trajectories.csv":
        return _from_csv_folder(file.parent, fps)
    companion = file.with_name("attributes_tidy.json")
    said = _json(companion, _bytes_of(companion)) if companion.is_file() else {}
    return _from_table(file, TextTable(file), said, fps)


def find_session_file(folder: Path) -> Path | None:
    """Return the file or csv folder that holds a session's trajectories, None if there is none."""
    if folder.name.endswith("_csv") or (folder / "attributes.json").is_file():
        return folder if (folder / "trajectories.csv").is_file() else None
    if (folder / "trajectories").is_dir():
        folder = folder / "trajectories"
    candidates = (folder / f"{stem}{ending}" for stem in STEMS for ending in ENDINGS)
    return next((file for file in candidates if file.exists()), None)


def _load_hdf5(path: Path) -> dict[str, Any]:
    """Return arrays and attributes of an HDF5 file, groups as dictionaries."""

    def content(group: h5py.Group) -> dict[str, Any]:
        found: dict[str, Any] = dict(group.attrs)
        for name in group:
            # Links to other files are not followed.
            if isinstance(group.get(name, getlink=True), h5py.HardLink):
                item = group[name]
                if isinstance(item, h5py.Dataset):
                    found[name] = item[()]
                elif group.name == "/":
                    found[name] = content(item)
        return found

    with open_hdf5(path, "h5 file") as file:
        return content(file)


def _from_csv_folder(folder: Path, fps: float | None) -> xr.Dataset:
    """Read ``trajectories.csv`` and what lies beside it."""
    file = folder / "attributes.json"
    said = _json(file, _bytes_of(file)) if file.is_file() else {}
    for name in ("areas", "id_probabilities"):
        file = folder / f"{name}.csv"
        if not file.is_file():
            continue
        table = TextTable(file)
        columns = [i for i, column in enumerate(table.names) if column != "time"]
        loaded = table.load(columns)
        if name == "areas":
            kinds = ("mean", "median", "std")
            said[name] = dict(zip(kinds, (loaded[c] for c in columns), strict=False))
        elif columns:
            said[name] = np.stack([loaded[c] for c in columns], axis=-1)
    file = folder / "trajectories.csv"
    return _from_table(file, TextTable(file), said, fps)


def _from_table(path: Path, table: Table, said: dict[str, Any], fps: float | None) -> xr.Dataset:
    """Read the positions of a table, wide or tidy."""
    if table.names == ["time", "trajectories1", "trajectories2"]:
        # With a single animal idtracker.ai forgets which axis is which.
        table.names = ["time", "x1", "y1"]
    roles = roles_of(table.names)
    if "frames_per_second" in said:
        # Times are rounded to a millisecond; rows or frame numbers are exact.
        roles.single.pop("time", None)
    rows = load_rows(table, roles)
    (piece,) = pieces_of(rows, fps, file_fps=_frame_rate(path, said))
    labels = rows.individuals
    if rows.member is not None:
        # The tidy forms count from 0, labels and all other forms from 1.
        labels = [str(int(name) + 1) if name.isdigit() else name for name in labels]
    if "id_probabilities" in said and not piece.variables:
        piece.variables = _probability(path, said["id_probabilities"], piece.position.shape)
    return _finished(path, piece, said, labels)


def _tracks_of(path: Path, said: Mapping[str, Any], fps: float | None) -> xr.Dataset:
    """Build tracks from idtracker.ai's dictionary."""
    position = _numbers(path, "trajectories", said.get("trajectories"))
    if position is None or position.ndim != 3 or position.shape[-1] not in (2, 3):
        shape = "nothing" if position is None else f"the shape {position.shape}"
        raise InputError(
            f"{path}: its trajectories have {shape}, and not (frame, individual, 2). It is no file "
            "of idtracker.ai, or damaged."
        )
    clock = clock_of(path, len(position), fps=fps, file_fps=_frame_rate(path, said))
    piece = Piece(position, clock)
    if said.get("id_probabilities") is not None:
        piece.variables = _probability(path, said["id_probabilities"], position.shape)
    return _finished(path, piece, said, [str(i + 1) for i in range(position.shape[1])])


def _finished(path: Path, piece: Piece, said: Mapping[str, Any], labels: list[str]) -> xr.Dataset:
    """Add labels, areas and settings, and assemble."""
    given = said.get("identities_labels")
    if isinstance(given, list | tuple | np.ndarray) and len(given) == len(labels):
        labels = [g.decode("utf-8", "replace") if isinstance(g, bytes) else str(g) for g in given]
    variables = {**piece.variables, **_areas(path, said.get("areas"), piece.position.shape)}
    piece.variables = variables
    attrs = {
        name: plain
        for name, value in said.items()
        if name not in NO_ATTRIBUTES and (plain := plain_attribute(value)) is not None
    }
    scale = said.get("length_unit")
    if isinstance(scale, int | float | np.number) and scale > 0:
        attrs["length_unit"] = float(scale)
    return assemble(
        path, piece, individuals=labels, unit="px", source_software="idtracker.ai", attrs=attrs
    )


def _frame_rate(path: Path, said: Mapping[str, Any]) -> float | None:
    value = said.get("frames_per_second")
    if value is None:
        return None
    numbers = _numbers(path, "frames_per_second", value)
    return None if numbers is None or numbers.size != 1 else float(numbers.reshape(-1)[0])


def _numbers(path: Path, name: str, value: object) -> npt.NDArray[np.float64] | None:
    """Return what should be numbers as an array of them."""
    if value is None:
        return None
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{path}: {name} holds no numbers. Export the session again.") from None


def _probability(path: Path, value: object, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return the variable of the identities' probabilities, stored with or without a last axis."""
    numbers = _numbers(path, "id_probabilities", value)
    if numbers is None or numbers.size != shape[0] * shape[1] or len(numbers) != shape[0]:
        raise InputError(
            f"{path}: id_probabilities do not fit trajectories of {shape[1]} individuals in "
            f"{shape[0]} frames. Export the session again."
        )
    return {"id_probability": (("time", "individual"), numbers.reshape(shape[:2]))}


def _areas(path: Path, value: object, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return areas of the animals: per frame (old versions), or mean, median and std."""
    if isinstance(value, Mapping):
        found = {f"area_{k}": _numbers(path, "areas", v) for k, v in value.items()}
        return {
            name: (("individual",), numbers)
            for name, numbers in found.items()
            if numbers is not None and numbers.shape == (shape[1],)
        }
    numbers = _numbers(path, "areas", value)
    if numbers is not None and numbers.shape == shape[:2]:
        return {"area": (("time", "individual"), numbers)}
    return {}


def _bytes_of(path: Path) -> bytes:
    with reading(path, "json file"):
        return path.read_bytes()


def _json(path: Path, data: bytes) -> dict[str, Any]:
    """Return the dictionary of a json text."""
    with reading(path, "json text of attributes"):
        said = json.loads(data)
        if not isinstance(said, dict):
            raise ValueError("no dictionary")
        return said
