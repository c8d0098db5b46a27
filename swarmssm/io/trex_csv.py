"""Tracks of TRex exported as csv: one file for each individual."""

import re
from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.opening import existing
from swarmssm.io.text import TextTable
from swarmssm.io.trex import CENTROIDS, centroid_of, checked_file
from swarmssm.io.trex_files import is_companion, of_one_video, tracks_of

__all__ = ["is_trex_header", "read_trex_csv"]

UNIT = re.compile(r"\s*\((?P<unit>[^()]*)\)$")
#: Columns that only TRex writes.
TELLTALE = re.compile(r".+#(smooth|[wp]?centroid)|blobid|num_pixels|midline_length|MIDLINE_OFFSET")


def read_trex_csv(
    path: Path | str,
    fps: float | None = None,
    *,
    centroid: str | None = None,
    video: str | None = None,
) -> xr.Dataset:
    """Read the csv files of TRex.

    Numbers are as coarse as ``output_csv_decimals`` was; ``inf`` is NaN. See
    :func:`~swarmssm.io.trex.read_trex` for what the files hold.

    Parameters
    ----------
    path
        The folder of the files, or the file of one individual.
    fps
        Frames per second; default is from the column ``time``, rounded.
    centroid
        Point of the body; default the first of ``wcentroid, centroid, pcentroid, head`` exported.
    video
        Name of the recording, if the folder holds several.

    Returns
    -------
    Tracks with one individual for each file, among them those never tracked.

    Raises
    ------
    InputError
        If there are no such files, a column is absent (``frame``, X or Y), or a cell is no number.
    """
    place = existing(path)
    if centroid is not None and centroid not in CENTROIDS:
        raise InputError(
            f"centroid: {centroid!r} is unknown; choose one of {', '.join(CENTROIDS)}."
        )
    if place.is_dir():
        found = {p: TextTable(p) for p in sorted(place.glob("*.csv")) if not is_companion(p)}
        found = {p: table for p, table in found.items() if is_trex_header(table.names)}
    else:
        found = {place: TextTable(place)}
    if not found:
        raise InputError(f"{place}: it holds no csv file of TRex. Name the folder of its export.")
    tables = {p: found[p] for p in of_one_video(list(found), place, video)}
    files = []
    unit = ""
    for file, table in tables.items():
        # The first column of a name counts: frame stands there twice if it was asked for.
        columns = {UNIT.sub("", name): i for i, name in reversed(list(enumerate(table.names)))}
        centroid = centroid or centroid_of(list(columns), file)
        pair = [f"X{CENTROIDS[centroid]}", f"Y{CENTROIDS[centroid]}"]
        for name in ("frame", *pair):
            if name not in columns:
                raise InputError(
                    f"{file}: it has no column {name}. Choose another centroid, or add it to "
                    "output_fields in TRex."
                )
        wanted = [name for name in ("frame", *pair, "time", "missing") if name in columns]
        loaded = table.load([columns[name] for name in wanted], infinite=True)
        values = {name: loaded[columns[name]] for name in wanted}
        bracket = UNIT.search(table.names[columns[pair[0]]])
        unit = bracket["unit"] if bracket else unit
        files.append(checked_file(file, values, pair, place=table.place))
    tracks, _ = tracks_of(files, place, fps=fps, unit=unit, centroid=centroid or "")
    return tracks


def is_trex_header(names: Sequence[str]) -> bool:
    """Return whether the columns are those of TRex: ``frame`` and one that only TRex writes."""
    bare = [UNIT.sub("", name) for name in names]
    return "frame" in bare and any(TELLTALE.fullmatch(name) for name in bare)
