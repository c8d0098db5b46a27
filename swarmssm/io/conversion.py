"""Tracks from what a notebook holds: datasets, files, arrays, tables, and several of these."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.parquet import table_of_frame
from swarmssm.io.reading import read
from swarmssm.io.tables import tracks_from_table
from swarmssm.tracks import make_tracks, validate_tracks
from swarmssm.tracks.pooling import pool_tracks

__all__ = ["Recording", "Recordings", "as_tracks"]

Recording: TypeAlias = xr.Dataset | pd.DataFrame | npt.NDArray[Any] | str | Path
Recordings: TypeAlias = Recording | Sequence[Recording] | Mapping[str, Recording]


def as_tracks(
    recordings: Recordings, *, fps: float | None = None, unit: str | None = None
) -> xr.Dataset:
    """Return tracks, whatever form the recording has.

    Parameters
    ----------
    recordings
        Tracks; a file that :func:`swarmssm.io.read` can read; a DataFrame with the columns that
        :func:`swarmssm.io.read_table` knows, for instance ``time, individual, x, y``; an array
        ``(time, individual, space)`` or ``(trial, time, individual, space)``; or several of these
        in a list or in a dictionary by name, which are pooled, see
        :func:`swarmssm.tracks.pooling.pool_tracks`.
    fps
        Frames per second; an array has none of its own, and a table without times neither.
    unit
        Unit of length of arrays and tables.

    Returns
    -------
    Tracks, as :func:`swarmssm.tracks.make_tracks` builds them.

    Raises
    ------
    InputError
        If something is no recording, or the recordings do not fit together.
    """
    if isinstance(recordings, Mapping) and not isinstance(recordings, xr.Dataset):
        named = {str(name): part for name, part in recordings.items()}
    elif isinstance(recordings, list | tuple):
        named = {str(number): part for number, part in enumerate(recordings)}
    else:
        return _one(recordings, fps, unit, "tracks")
    return pool_tracks({name: _one(part, fps, unit, name) for name, part in named.items()})


def _one(recording: Any, fps: float | None, unit: str | None, name: str) -> xr.Dataset:
    """Return the tracks of one recording."""
    if isinstance(recording, str | Path):
        return read(recording, fps=fps, unit=unit)
    if isinstance(recording, xr.Dataset):
        tracks = validate_tracks(recording)
        own = {"fps": tracks.attrs["fps"], "unit": tracks.attrs.get("unit") or unit}
        for what, given in (("fps", fps), ("unit", unit)):
            if given not in (None, own[what]):
                raise InputError(
                    f"{what}: {given} is given, and the tracks say {own[what]}. Leave it out."
                )
        return tracks
    if isinstance(recording, pd.DataFrame):
        return tracks_from_table(table_of_frame(recording), fps, unit=unit or "")
    if hasattr(recording, "__array__"):
        position = np.asarray(recording)
        if fps is None:
            raise InputError(
                f"fps: an array has no frame rate of its own; say how many frames {name} has per "
                "second, for instance fps=25."
            )
        return make_tracks(position, fps=fps, unit=unit or "")
    raise InputError(
        f"tracks: {type(recording).__name__} is no recording; give tracks, a file, a DataFrame, an "
        "array (time, individual, space), or a list of these."
    )
