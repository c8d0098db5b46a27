"""Which files of a TRex output folder belong together: recordings, individuals, their order."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.assembly import Piece, assemble, named_list
from swarmssm.io.clock import clock_of
from swarmssm.io.opening import check_memory
from swarmssm.tracks.time_grid import Array

__all__ = ["IndividualFile", "is_companion", "of_one_video", "tracks_of"]

#: Files that TRex writes beside the tracks, told by name.
COMPANION = re.compile(
    r"_(posture|visual_field|recognition|heatmap|tracklet_images)_"
    r"|_(statistics|memory|global_memory|vi_probs|tracklet_images)(_[^_]*)?$"
    r"|_part\d+$"
)
#: ``<video>_<letters><digits>``; the video's name may itself have underscores, dots and digits.
NUMBERED = re.compile(r"(?P<video>.*)_(?P<prefix>[^\W\d_]*)(?P<number>\d+)")
#: Whole frames per second are what TRex is configured with; below this they would round to none.
MIN_WHOLE_RATE = 0.75


@dataclass
class IndividualFile:
    """What one file of TRex says about one individual.

    ``frame`` has shape ``(row,)`` and increases, ``position`` ``(row, 2)`` with NaN where the
    individual was missing, ``time`` ``(row,)`` in seconds if it was exported. ``number`` is the
    identity TRex uses in its visual fields, None if the file does not tell.
    """

    path: Path
    frame: npt.NDArray[np.int64]
    position: Array
    time: Array | None = None
    number: int | None = None
    frame_rate: float | None = None
    cm_per_pixel: float | None = None


def is_companion(path: Path) -> bool:
    """Return whether a file's name is that of posture, visual field, statistics and so on."""
    return COMPANION.search(path.stem) is not None


def of_one_video(paths: Sequence[Path], folder: Path, video: str | None) -> list[Path]:
    """Return the files of one recording.

    Parameters
    ----------
    paths
        Files of individuals.
    folder
        Where they lie, for the sentence.
    video
        The recording's name; needed only if there are several.

    Raises
    ------
    InputError
        If there are several and ``video`` is None, or none of that name.
    """
    videos = _videos(paths)
    names = sorted(set(videos))
    if video is None and len(names) > 1:
        counts = Counter(videos)
        each = named_list([f"{name} ({counts[name]} files)" for name in names])
        raise InputError(
            f"{folder}: it holds the tracks of {len(names)} recordings, {each}. "
            "Name one of them with video=..."
        )
    if video is not None and video not in names:
        raise InputError(
            f"{folder}: it holds no recording called {video}, but {named_list(names)}."
        )
    return [path for path, name in zip(paths, videos, strict=True) if video in (None, name)]


def _videos(paths: Sequence[Path]) -> list[str]:
    """Return the name of each file's recording.

    A file of a numbered individual tells it. One with a custom name (``video_alice``) belongs to a
    recording known from others or, where there is none, to what all such files have in common.
    """
    matches = [NUMBERED.fullmatch(path.stem) for path in paths]
    known = sorted({match["video"] for match in matches if match}, key=len, reverse=True)
    named = [path.stem for path, match in zip(paths, matches, strict=True) if not match]
    common = ""
    if named:
        first, last = min(named), max(named)
        same = next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), None)
        common = first[:same].rpartition("_")[0]
    videos = []
    for path, match in zip(paths, matches, strict=True):
        owner = next((name for name in known if path.stem.startswith(f"{name}_")), common)
        videos.append(match["video"] if match else owner or path.stem.rpartition("_")[0])
    return videos


def tracks_of(
    files: Sequence[IndividualFile],
    where: Path,
    *,
    fps: float | None,
    unit: str,
    centroid: str,
) -> tuple[xr.Dataset, list[IndividualFile]]:
    """Align the individuals of one recording on the frame number.

    The individuals are ordered by number, those without one come last by name. Their labels are
    the number as text, or the custom name.

    Parameters
    ----------
    files
        One for each individual.
    where
        Their folder, for sentences.
    fps
        As given by the caller; else TRex's own setting, else from the times.
    unit, centroid
        Unit of length, and which point of the body was read.

    Returns
    -------
    The tracks, and the files in the order of the individuals.

    Raises
    ------
    InputError
        If two files are of one individual, the frame rate is unknown or the frames do not fit.
    """
    names = _names(files)
    order = sorted(
        range(len(files)),
        key=lambda i: (files[i].number is None, files[i].number or 0, names[i]),
    )
    files, names = [files[i] for i in order], [names[i] for i in order]
    owners: dict[int | str, Path] = {}
    for name, file in zip(names, files, strict=True):
        key = name if file.number is None else file.number
        if key in owners:
            raise InputError(
                f"{where}: {owners[key].name} and {file.path.name} are both of individual {key}. "
                "Take one of them away."
            )
        owners[key] = file.path
    first = min(int(file.frame[0]) for file in files)
    length = max(int(file.frame[-1]) for file in files) - first + 1
    check_memory(where, 48 * length * 2 * len(files), "reading it")
    position = np.full((length, len(files), 2), np.nan)
    time = np.full(length, np.nan)
    for column, file in enumerate(files):
        rows = file.frame - first
        position[rows, column] = file.position
        if file.time is not None:
            new = np.isnan(time[rows])
            time[rows[new]] = file.time[new]
    setting = _one_value(where, files, "frame_rate")
    clock = clock_of(
        where,
        length,
        fps=fps,
        file_fps=_rate_from_times(files) if setting is None else setting,
        frames=np.arange(first, first + length),
    )
    if setting is None and fps is None:
        clock.attrs["fps_source"] = "time"
    scale = _one_value(where, files, "cm_per_pixel")
    variables = {} if np.isnan(time).all() else {"recorded_time": (("time",), time)}
    tracks = assemble(
        where,
        Piece(position, clock, variables=variables),
        individuals=names,
        unit=unit,
        source_software="TRex",
        attrs={"centroid": centroid, **({} if scale is None else {"cm_per_pixel": scale})},
    )
    return tracks, files


def _names(files: Sequence[IndividualFile]) -> list[str]:
    """Return each individual's label, and fill in the numbers that only file names tell."""
    matches = [NUMBERED.fullmatch(file.path.stem) for file in files]
    prefixes = Counter(match["prefix"] for match in matches if match)
    usual = max(prefixes, key=lambda name: (prefixes[name], name), default="")
    videos = _videos([file.path for file in files])
    names = []
    for file, match, video in zip(files, matches, videos, strict=True):
        if match and file.number is None:
            file.number = int(match["number"])
        if match and match["prefix"] == usual and file.number == int(match["number"]):
            names.append(str(file.number))
        else:
            names.append(file.path.stem.removeprefix(f"{video}_"))
    return names


def _one_value(where: Path, files: Sequence[IndividualFile], name: str) -> float | None:
    """Return a setting that all files which state it must share."""
    values = {getattr(file, name): file.path.name for file in files} if files else {}
    values.pop(None, None)
    if len(values) > 1:
        (one, first), (two, second) = sorted(values.items())[:2]
        raise InputError(
            f"{where}: {first} has {name} {one:g} and {second} has {two:g}. "
            "Keep the files of one export only."
        )
    return next(iter(values), None)


def _rate_from_times(files: Sequence[IndividualFile]) -> float | None:
    """Return the frame rate that the median time step tells, rounded to a whole one."""
    steps = [
        np.diff(file.time) / np.diff(file.frame)
        for file in files
        if file.time is not None and len(file.time) > 1
    ]
    known = np.concatenate([s[np.isfinite(s) & (s > 0)] for s in steps]) if steps else np.empty(0)
    if not known.size:
        return None
    rate = float(1.0 / np.median(known))
    return float(round(rate)) if MIN_WHOLE_RATE < rate < 1e12 else rate
