"""Tracks of the classic idTracker: ``trajectories.txt``, before idtracker.ai.

Perez-Escudero, A. et al. (2014). idTracker: tracking individuals in a group by automatic
identification of unmarked animals. Nature Methods 11:743-748.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.assembly import assemble
from swarmssm.io.columns import roles_of
from swarmssm.io.opening import existing
from swarmssm.io.rows import load_rows, pieces_of
from swarmssm.io.text import TextTable

__all__ = ["FILE_NAMES", "is_idtracker_header", "read_idtracker"]

#: What idTracker calls its files, in the order in which they are preferred in a folder.
FILE_NAMES = ("trajectories.txt", "trajectories_nogaps.txt")
PROBABILITY = re.compile(r"ProbId(?P<number>\d+)")


def read_idtracker(path: Path | str, fps: float | None = None) -> xr.Dataset:
    """Read ``trajectories.txt`` or ``trajectories_nogaps.txt`` of idTracker, in px.

    Parameters
    ----------
    path
        The file, or the folder of ``trajectories.txt``.
    fps
        Frames per second; the file does not tell them.

    Returns
    -------
    Tracks; the variable ``id_probability (time, individual)`` is idTracker's ProbId: a
    probability, or -1 where an occluded animal was cut out again, -2 where its place is estimated.

    Raises
    ------
    InputError
        If ``fps`` is not given, a cell is no number or a row is cut short.
    """
    place = existing(path)
    if place.is_dir():
        found = [place / name for name in FILE_NAMES if (place / name).is_file()]
        if not found:
            raise InputError(f"{place}: it holds no trajectories.txt of idTracker.")
        place = found[0]
    table = TextTable(place)
    if not is_idtracker_header(table.names):
        raise InputError(f"{place}: its header is not X1, Y1, ProbId1, X2 ... as in idTracker.")
    rows = load_rows(table, roles_of(table.names))
    (piece,) = pieces_of(rows, fps)
    columns = {
        match["number"]: index
        for index, name in enumerate(table.names)
        if (match := PROBABILITY.fullmatch(name))
    }
    if set(rows.individuals) <= columns.keys():
        wanted = [columns[name] for name in rows.individuals]
        loaded = table.load(wanted)
        probability = np.stack([loaded[column] for column in wanted], axis=-1)
        piece.variables = {"id_probability": (("time", "individual"), probability)}
    return assemble(
        place, piece, individuals=rows.individuals, unit="px", source_software="idTracker"
    )


def is_idtracker_header(names: Sequence[str]) -> bool:
    """Return whether the columns are those of idTracker."""
    return any(PROBABILITY.fullmatch(name) for name in names) and "X1" in names and "Y1" in names
