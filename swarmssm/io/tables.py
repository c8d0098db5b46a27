"""Tracks in a plain table: one row for each individual and frame (long), or one column (wide)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from swarmssm.io.assembly import assemble, named_list
from swarmssm.io.columns import roles_of
from swarmssm.io.opening import existing, first_bytes
from swarmssm.io.parquet import PARQUET_MAGIC, ParquetTable
from swarmssm.io.rows import load_rows, pieces_of
from swarmssm.io.text import Table, TextTable

__all__ = ["open_table", "read_table", "tracks_from_table"]


def open_table(path: Path) -> Table:
    """Open a text or parquet file, told apart by its first bytes.

    Raises
    ------
    InputError
        If it is neither, or damaged.
    """
    if first_bytes(path).startswith(PARQUET_MAGIC):
        return ParquetTable(path)
    return TextTable(path)


def read_table(
    path: Path | str, fps: float | None = None, *, pad_trials: bool = False
) -> xr.Dataset:
    """Read a csv, tab-separated or parquet table.

    *Long*: columns for the individual, ``x``, ``y`` and perhaps ``z``, and ``frame`` or ``time``
    or both; one row for each individual and frame, in any order. *Wide*: columns ``x1, y1, x2,
    y2, ...`` or ``fish1_x, fish1_y, ...``, one row a frame; ``frame`` and ``time`` may be absent.
    Names may differ in case and separators and end in a unit (``x (cm)``, ``time_ms``); times
    may be dates in ISO 8601. ``vx, vy`` are read as velocity, in a long table ``probability`` or
    ``confidence`` as the variable ``id_probability``; further columns are named in
    ``attrs["left_out_columns"]``. A column ``trial`` parts the rows into trials.

    Parameters
    ----------
    path
        The file.
    fps
        Frames per second; needed where the table has no time.
    pad_trials
        Whether trials may differ in their individuals: an individual is then NaN throughout a
        trial in which it does not occur.

    Returns
    -------
    Tracks.

    Raises
    ------
    InputError
        If columns are not understood, a cell is no number, an individual stands twice in a frame,
        times do not increase, or trials differ in their individuals.
    """
    return tracks_from_table(open_table(existing(path)), fps, pad_trials=pad_trials)


def tracks_from_table(
    table: Table,
    fps: float | None,
    *,
    file_fps: float | None = None,
    pad_trials: bool = False,
    labels: Mapping[str, str] | None = None,
    unit: str = "",
    source_software: str = "",
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Build tracks from an open table; :func:`read_table` tells of which forms.

    Parameters
    ----------
    table
        The table.
    fps, pad_trials
        As in :func:`read_table`.
    file_fps
        Frames per second that another file of the same recording states.
    labels
        Labels in the table and what to call them.
    unit, source_software, attrs
        As in :func:`swarmssm.tracks.make_tracks`.

    Raises
    ------
    InputError
        As :func:`read_table`.
    """
    roles = roles_of(table.names)
    rows = load_rows(table, roles)
    pieces = pieces_of(rows, fps, file_fps=file_fps, pad_trials=pad_trials)
    left_out = list(roles.left_out)
    if rows.member is not None:
        wide = [index for columns in roles.wide.values() for index in columns.values()]
        left_out += [table.names[index] for index in wide]
    extra = {"left_out_columns": named_list(left_out, 50)} if left_out else {}
    return assemble(
        table.path,
        pieces if rows.trials else pieces[0],
        individuals=[(labels or {}).get(name, name) for name in rows.individuals],
        trials=rows.trials or None,
        unit=unit or roles.unit,
        source_software=source_software,
        attrs={**extra, **(attrs or {})},
    )
