"""One door for all formats."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.arrays import read_arrays
from swarmssm.io.assembly import EmptyPolicy, settle_empty
from swarmssm.io.detection import detect_format
from swarmssm.io.idtracker import read_idtracker
from swarmssm.io.idtrackerai import read_idtrackerai
from swarmssm.io.netcdf import read_netcdf
from swarmssm.io.opening import existing
from swarmssm.io.tables import read_table
from swarmssm.io.trex import read_trex
from swarmssm.io.trex_csv import read_trex_csv
from swarmssm.tracks.time_grid import check_fps

__all__ = ["FORMATS", "read"]

#: Name of each format and what it is.
FORMATS: dict[str, str] = {
    "netcdf": "our own NetCDF files, and those of movement",
    "trex": "TRex: a folder of npz files, one for each individual, perhaps with visual fields",
    "trex-csv": "TRex: a folder of csv files, one for each individual",
    "idtrackerai": "idtracker.ai: a session folder, or its h5, csv, parquet, npy or pickle file",
    "idtracker": "the classic idTracker: trajectories.txt",
    "table": "csv, tab-separated text or parquet, with a row for each frame and perhaps individual",
    "arrays": "npz or npy of numpy: xy (time, individual, 2), or X with velocities and A",
}
_READERS: dict[str, Callable[..., xr.Dataset]] = {
    "netcdf": read_netcdf,
    "trex": read_trex,
    "trex-csv": read_trex_csv,
    "idtrackerai": read_idtrackerai,
    "idtracker": read_idtracker,
    "table": read_table,
    "arrays": read_arrays,
}
#: Trackers that work on videos count from the top left corner, so that y grows downwards.
_TRACKERS = ("trex", "trex-csv", "idtrackerai", "idtracker")
_POSE_TRACKERS = ("SLEAP", "DeepLabCut", "LightningPose")
#: TRex writes a file even for an identity that it lost at once, and a part cut from tracks may not
#: meet all individuals; elsewhere one without any position is a mistake.
_EMPTY: dict[str, EmptyPolicy] = {"netcdf": "keep", "trex": "drop", "trex-csv": "drop"}


def read(
    path: Path | str,
    format: str = "auto",
    fps: float | None = None,
    *,
    unit: str | None = None,
    y_axis: Literal["up", "down"] | None = None,
    empty: EmptyPolicy | None = None,
    centroid: str | None = None,
    video: str | None = None,
    visual_field: bool | str | None = None,
    keypoint: str | None = None,
    pad_trials: bool | None = None,
    allow_pickle: bool | None = None,
) -> xr.Dataset:
    """Read tracks from a file or folder of any known format.

    Parameters
    ----------
    path
        The file or folder.
    format
        A key of :data:`FORMATS`, or ``"auto"``: told by what is in the file, not by its name.
    fps
        Frames per second. Needed where the file does not tell; where it does and differs, ``fps``
        is believed and ``attrs["fps_in_file"]`` keeps the other. ``attrs["fps_source"]`` tells
        where the rate is from: ``"argument"``, ``"file"`` or ``"time"``.
    unit
        Unit of length, where the file tells none or a wrong one. Nothing is converted.
    y_axis
        Whether y grows upwards or downwards in the picture; pictures and force maps follow it.
        Nothing is converted. Default: what the file tells, else downwards in the files of
        trackers (TRex, idtracker.ai, idTracker, SLEAP, DeepLabCut, LightningPose) and of pixels,
        and upwards elsewhere.
    empty
        What to do about individuals without any position: ``"refuse"``, ``"drop"`` (they are
        named in ``attrs["left_out_individuals"]``) or ``"keep"``. Default: drop those of TRex, keep
        those of NetCDF, refuse others.
    centroid, video
        Of TRex: :func:`~swarmssm.io.trex.read_trex`.
    visual_field
        Of TRex's npz files: :func:`~swarmssm.io.trex.read_trex`.
    keypoint
        Of NetCDF: :func:`~swarmssm.io.netcdf.read_netcdf`.
    pad_trials
        Of tables: :func:`~swarmssm.io.tables.read_table`.
    allow_pickle
        Of idtracker.ai: :func:`~swarmssm.io.idtrackerai.read_idtrackerai`.

    Returns
    -------
    Tracks, as :func:`swarmssm.tracks.make_tracks` builds them.

    Raises
    ------
    InputError
        If the file is absent, unreadable, damaged or of no known format, if it does not hold
        tracks, or an option is given that its format does not have.
    """
    place = existing(path)
    if fps is not None:
        check_fps(fps, "fps")
    if format != "auto" and format not in FORMATS:
        raise InputError(f"format: {format!r} is unknown; choose auto or {', '.join(FORMATS)}.")
    name = detect_format(place) if format == "auto" else format
    reader = _READERS[name]
    given: dict[str, Any] = {
        "centroid": centroid,
        "video": video,
        "visual_field": visual_field,
        "keypoint": keypoint,
        "pad_trials": pad_trials,
        "allow_pickle": allow_pickle,
    }
    options = {key: value for key, value in given.items() if value is not None}
    for key in options:
        if key not in inspect.signature(reader).parameters:
            raise InputError(f"{place}: the format {name} has no option {key}. Leave it out.")
    tracks = reader(place, fps, **options)
    if unit is not None:
        tracks.attrs["unit"] = unit
        tracks["position"].attrs["units"] = unit
        if "velocity" in tracks:
            tracks["velocity"].attrs["units"] = f"{unit}/s"
    _orient(tracks, name, y_axis)
    return settle_empty(tracks, empty or _EMPTY.get(name, "refuse"), place)


def _orient(tracks: xr.Dataset, format: str, y_axis: str | None) -> None:
    """Note in the tracks where y grows downwards."""
    if y_axis not in (None, "up", "down"):
        raise InputError(f"y_axis: it must be up or down, and it is {y_axis!r}.")
    if y_axis is None and "y_axis" not in tracks.attrs and tracks.sizes["space"] == 2:
        in_video = (
            format in _TRACKERS
            or tracks.attrs.get("source_software") in _POSE_TRACKERS
            or tracks.attrs["unit"] in ("px", "pixel", "pixels")
        )
        y_axis = "down" if in_video else None
    if y_axis is not None:
        tracks.attrs["y_axis"] = y_axis
