"""Tracks of TRex: one npz file for each individual (versions 1 and 2).

Walter, T. & Couzin, I. D. (2021). TRex, a fast multi-animal tracking system with markerless
identification, and 2D estimation of posture and visual fields. eLife 10:e64000.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.clock import Place, row_name
from swarmssm.io.numpy_files import NumpyArchive
from swarmssm.io.opening import existing
from swarmssm.io.trex_files import IndividualFile, is_companion, of_one_video, tracks_of
from swarmssm.io.trex_visual_field import add_visual_field, tracks_from_visual_field
from swarmssm.tracks.time_grid import Array

__all__ = ["CENTROIDS", "centroid_of", "checked_file", "is_trex_archive", "read_trex"]

#: Point of the body -> ending of TRex's column; in the order in which they are preferred.
CENTROIDS = {"wcentroid": "#wcentroid", "centroid": "#centroid", "pcentroid": "#pcentroid"}
CENTROIDS["head"] = ""
#: Frame numbers are stored in float32, which holds whole numbers up to this one.
LAST_EXACT_FRAME = 2**24


def read_trex(
    path: Path | str,
    fps: float | None = None,
    *,
    centroid: str | None = None,
    video: str | None = None,
    visual_field: bool | str = "auto",
) -> xr.Dataset:
    """Read the npz files of TRex.

    Frames where TRex reports ``inf`` or ``missing`` are NaN. Speeds, which TRex computes across
    gaps too, are not read. Lengths are in cm as far as TRex was calibrated; ``attrs`` keep
    ``cm_per_pixel`` where it was exported. The camera's own times, where exported, are in the
    variable ``recorded_time``; ``time`` is frame number by ``fps``.

    Parameters
    ----------
    path
        The folder of the files (``data`` by default in TRex), or the file of one individual.
    fps
        Frames per second; default is TRex's own setting, or the median time step, rounded.
    centroid
        Point of the body: ``"wcentroid"`` (centre of the weighted blob), ``"centroid"`` (of the
        binary blob), ``"pcentroid"`` (of the posture) or ``"head"``. Default: the first of them
        that was exported.
    video
        Name of the recording, if the folder holds several.
    visual_field
        ``True``: attach the directed adjacency of the visual fields, ``adjacency[t, i, j] = 1``
        when some ray of i's eyes meets j first. ``"auto"``: if they were exported. ``False``: no.
        Individuals without posture in a frame have no visual field there: their row is 0, and
        the variable ``adjacency_known`` tells such rows.

    Returns
    -------
    Tracks with one individual for each file, among them those never tracked.

    Raises
    ------
    InputError
        If there are no such files, one of them is damaged, they are of several recordings, or
        what was asked for was not exported.
    """
    place = existing(path)
    if centroid is not None and centroid not in CENTROIDS:
        raise InputError(
            f"centroid: {centroid!r} is unknown; choose one of {', '.join(CENTROIDS)}."
        )
    if visual_field not in (True, False, "auto"):
        raise InputError(f"visual_field: {visual_field!r} is unknown; choose True, False or auto.")
    files = []
    for file in _candidates(place, video):
        with NumpyArchive(file) as archive:
            if not place.is_dir() or _holds_tracks(archive):
                centroid = centroid or centroid_of(archive.keys, file)
                files.append(_read_individual(archive, centroid))
    if not files and visual_field and place.is_dir():
        return tracks_from_visual_field(place, fps, video=video)
    if not files:
        raise InputError(
            f"{place}: it holds no npz file of TRex with the arrays frame, X#wcentroid and "
            "Y#wcentroid. Name the folder into which TRex exported (data by default)."
        )
    chosen = set(of_one_video([file.path for file in files], place, video))
    files = [file for file in files if file.path in chosen]
    if centroid == "head" and all(np.isnan(file.position).all() for file in files):
        raise InputError(
            f"{place}: no head position is known, because TRex had no posture. "
            'Leave out centroid="head", or export with posture.'
        )
    tracks, files = tracks_of(files, place, fps=fps, unit="cm", centroid=centroid or "")
    if visual_field and place.is_dir():
        tracks = add_visual_field(tracks, files, place, required=visual_field is True)
    elif visual_field is True:
        raise InputError(
            f"{place}: the visual field of one individual sees no other. Name the folder of all."
        )
    return tracks


def is_trex_archive(path: Path) -> bool:
    """Return whether an npz file has a frame number and a position for each row.

    Raises
    ------
    InputError
        If it is not a whole npz file.
    """
    with NumpyArchive(path) as archive:
        return _holds_tracks(archive)


def _holds_tracks(archive: NumpyArchive) -> bool:
    keys = set(archive.keys)
    return "frame" in keys and bool(_exported(keys)) and len(archive.shape("frame")) == 1


def _candidates(place: Path, video: str | None) -> list[Path]:
    """Return the files that may hold an individual of the recording."""
    if not place.is_dir():
        return [place]
    paths = [path for path in sorted(place.glob("*.npz")) if not is_companion(path)]
    mine = [path for path in paths if video is None or path.stem.startswith(f"{video}_")]
    # If there are none, all are read, so that the sentence can name the recordings there are.
    return mine or paths


def centroid_of(columns: list[str], path: Path) -> str:
    """Return the preferred point of the body among those exported.

    Raises
    ------
    InputError
        If a file has no whole pair of X and Y: it says what it has, and what to switch on.
    """
    exported = _exported(set(columns))
    if exported:
        return exported[0]
    for axis, other in (("X", "Y"), ("Y", "X")):
        lonely = [axis + end for end in CENTROIDS.values() if axis + end in columns]
        if lonely:
            raise InputError(
                f"{path}: it has {lonely[0]} but no {other}{lonely[0][1:]}, so that positions are "
                f'unknown. Add ["{other}",["RAW","WCENTROID"]] to output_fields in TRex (version '
                "1: output_graphs) and export again."
            )
    raise InputError(f"{path}: it has no columns X and Y. Add them to output_fields in TRex.")


def _exported(columns: set[str]) -> list[str]:
    """Return the points of the body for which X and Y are there."""
    return [name for name, end in CENTROIDS.items() if {f"X{end}", f"Y{end}"} <= columns]


def _read_individual(archive: NumpyArchive, centroid: str) -> IndividualFile:
    """Read what is needed of one file."""
    columns = [f"X{CENTROIDS[centroid]}", f"Y{CENTROIDS[centroid]}"]
    missing = [key for key in ("frame", *columns) if key not in archive]
    if missing:
        raise InputError(
            f"{archive.path}: it has no array {missing[0]}. Choose another centroid, or add it to "
            "output_fields in TRex."
        )
    number = int(archive.scalar("id")) if "id" in archive else None
    return checked_file(
        archive.path,
        {
            key: archive.numbers(key, 1)
            for key in ("frame", *columns, "time", "missing")
            if key in archive
        },
        columns,
        number=number,
        frame_rate=archive.scalar("frame_rate") if "frame_rate" in archive else None,
        cm_per_pixel=archive.scalar("cm_per_pixel") if "cm_per_pixel" in archive else None,
    )


def checked_file(
    path: Path,
    values: dict[str, Array],
    columns: list[str],
    *,
    number: int | None = None,
    frame_rate: float | None = None,
    cm_per_pixel: float | None = None,
    place: Place = row_name,
) -> IndividualFile:
    """Check the columns of one individual against each other, and blank what is missing.

    Parameters
    ----------
    path
        The file.
    values
        Columns by name, each ``(row,)``: ``frame``, the two of ``columns``, and perhaps ``time``
        and ``missing``.
    columns
        Names of the x and the y column.
    number, frame_rate, cm_per_pixel
        As in :class:`~swarmssm.io.trex_files.IndividualFile`.
    place
        Names a row in a sentence.

    Raises
    ------
    InputError
        If columns differ in length, or frames are not whole numbers that increase.
    """
    frame = values["frame"]
    for name, column in values.items():
        if len(column) != len(frame):
            raise InputError(
                f"{path}: {name} has {len(column)} rows and frame has {len(frame)}; it is damaged."
            )
    if not len(frame):
        raise InputError(f"{path}: it has no frame. Take the file away.")

    odd = ~np.isfinite(frame) | (frame != np.round(frame)) | (np.abs(frame) > LAST_EXACT_FRAME)
    odd[1:] |= frame[1:] <= frame[:-1]
    if odd.any():
        row = int(np.argmax(odd))
        raise InputError(
            f"{path}: the frame in {place(row)} is {frame[row]:.10g}; frames must be whole "
            "numbers that increase from row to row."
        )
    position: npt.NDArray[np.float64] = np.stack([values[name] for name in columns], axis=-1)
    absent = ~np.isfinite(position).all(-1)
    if "missing" in values:
        absent |= values["missing"] != 0
    position[absent] = np.nan
    time = values.get("time")
    if time is not None:
        time = np.where(np.isfinite(time), time, np.nan)
    return IndividualFile(
        path, frame.astype(np.int64), position, time, number, frame_rate, cm_per_pixel
    )
