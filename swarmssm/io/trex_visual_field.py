"""Who sees whom: directed adjacency from the visual fields that TRex exports.

Each eye casts 512 rays; TRex stores for each ray which individual it meets first (layer 0) and
next (layer 1). Two eyes of 260 degrees overlap in front, and their union is taken.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.numpy_files import NumpyArchive, read_npy
from swarmssm.io.opening import check_memory
from swarmssm.io.trex_files import NUMBERED, IndividualFile, of_one_video, tracks_of

__all__ = ["FIELD", "add_visual_field", "tracks_from_visual_field"]

#: Followed by ``_meta`` where the arrays lie in files of their own.
FIELD = re.compile(r"(?P<video>.*)_visual_field_(?P<name>.+)")
#: Depths are squared pixels; TRex writes the largest float32 where a ray meets nothing.
NOTHING_DEPTH = 1e30
#: Frames whose rays are looked at in one go.
CHUNK = 2048


@dataclass
class FieldFile:
    """The visual field of one individual: where it lies and whose it is."""

    path: Path
    individual: str
    split: bool

    def frames(self) -> npt.NDArray[np.int64]:
        """Return the frame numbers, ``(row,)``: only frames with posture."""
        with NumpyArchive(self.path) as archive:
            if "frames" not in archive:
                raise InputError(f"{self.path}: it has no array frames; export it again.")
            frames = archive.numbers("frames", 1)
        if not np.isfinite(frames).all() or (np.diff(frames) <= 0).any():
            raise InputError(f"{self.path}: its frames do not increase; export it again.")
        return frames.astype(np.int64)

    def array(self, name: str) -> npt.NDArray[Any] | None:
        """Return the rays' first layer of an array, ``(row, eye, ray)``, or None if absent."""
        if self.split:
            file = self.path.with_name(f"{self.path.stem.removesuffix('_meta')}_{name}.npy")
            values = read_npy(file, in_place=True) if file.is_file() else None
        else:
            with NumpyArchive(self.path) as archive:
                values = archive.read(name) if name in archive else None
        if values is None:
            return None
        if values.ndim != 4 or values.shape[2] < 1 or values.dtype.kind not in "iuf":
            raise InputError(
                f"{self.path}: {name} has the shape {values.shape}, and not (frame, eye, layer, "
                "ray); export it again."
            )
        return values[:, :, 0]

    def seen(self, own: int, count: int) -> Iterator[tuple[slice, npt.NDArray[np.int64]]]:
        """Yield some of ``count`` rows and whom each of their rays meets first, -1 for nobody."""
        ids, depth = self.array("ids"), self.array("depth")
        if ids is None:
            raise InputError(f"{self.path}: it has no array ids; export it again.")
        if len(ids) != count or (depth is not None and depth.shape != ids.shape):
            raise InputError(
                f"{self.path}: frames, ids and depth differ in length. Export it again."
            )
        for start in range(0, len(ids), CHUNK):
            rows = slice(start, min(start + CHUNK, len(ids)))
            met = np.nan_to_num(ids[rows]).astype(np.int64)
            nobody = met == own
            if depth is not None:
                nobody |= ~(depth[rows] < NOTHING_DEPTH)
            yield rows, np.where(nobody, -1, met).reshape(len(met), -1)


def add_visual_field(
    tracks: xr.Dataset, files: Sequence[IndividualFile], folder: Path, *, required: bool
) -> xr.Dataset:
    """Attach ``adjacency`` and ``adjacency_known`` from the visual fields of the same folder.

    Parameters
    ----------
    tracks
        Tracks from ``files``, whose ``frame`` coordinate the visual fields refer to.
    files
        The individuals' files, in the order of the tracks.
    folder
        Where the visual fields lie.
    required
        Whether to refuse a folder without visual fields, or without the numbers of individuals;
        if not, the tracks come back without adjacency, and in the second case
        ``attrs["visual_field"]`` says why.

    Returns
    -------
    The tracks with ``adjacency (time, individual, neighbor)`` and ``adjacency_known (time,
    individual)``: 0 where no visual field was exported, and the row of adjacency is then 0.
    ``attrs["adjacency_unknown_rows"]`` counts tracked individuals in such rows.

    Raises
    ------
    InputError
        If a visual field is damaged, or required and absent.
    """
    fields = {field.individual: field for field in _fields(folder)}
    of_tracks = [fields.get(file.path.stem) for file in files]
    if not any(of_tracks):
        if required:
            raise InputError(
                f"{folder}: it holds no visual field (<video>_visual_field_<name>.npz) of these "
                "individuals. Switch on output_visual_fields in TRex and export again."
            )
        return tracks
    unnumbered = [file.path.name for file in files if file.number is None]
    if unnumbered:
        reason = (
            f"{unnumbered[0]} does not tell the number by which visual fields name its individual"
        )
        if required:
            raise InputError(f"{folder}: {reason}. Export with TRex 2, which writes it.")
        tracks.attrs["visual_field"] = f"not read: {reason}"
        return tracks
    numbers = np.array([file.number for file in files], dtype=np.int64)
    frame = tracks["frame"].to_numpy()
    shape = (len(frame), len(files), len(files))
    needed = 3 * math.prod(shape)
    check_memory(folder, needed, "its adjacency (left out with --no-visual-field)")
    adjacency = np.zeros(shape, dtype=np.uint8)
    known = np.zeros(shape[:2], dtype=np.uint8)
    order = np.argsort(numbers)
    strangers: set[int] = set()
    for column, field in enumerate(of_tracks):
        if field is None:
            continue
        rows = field.frames() - frame[0]
        inside = (rows >= 0) & (rows < len(frame))
        known[rows[inside], column] = 1
        for part, met in field.seen(int(numbers[column]), len(rows)):
            slot = np.clip(np.searchsorted(numbers[order], met), 0, len(numbers) - 1)
            member = order[slot]
            found = (numbers[member] == met) & (met >= 0) & inside[part, None]
            strangers.update(np.unique(met[(numbers[member] != met) & (met >= 0)]).tolist())
            at, _ = np.nonzero(found)
            adjacency[rows[part][at], column, member[found]] = 1
    present = tracks["position"].notnull().all("space").to_numpy()
    tracks = tracks.assign_coords(neighbor=tracks["individual"].values).assign(
        adjacency=(("time", "individual", "neighbor"), adjacency),
        adjacency_known=(("time", "individual"), known),
    )
    tracks.attrs["adjacency_unknown_rows"] = int((present & (known == 0)).sum())
    if strangers:
        tracks.attrs["adjacency_strangers"] = ", ".join(map(str, sorted(strangers)))
    return tracks


def tracks_from_visual_field(
    folder: Path, fps: float | None, *, video: str | None = None
) -> xr.Dataset:
    """Read tracks and adjacency from visual fields alone: head positions in pixels.

    Raises
    ------
    InputError
        If there is none in the folder, one is damaged, or ``fps`` is not given.
    """
    fields = {field.individual: field for field in _fields(folder)}
    if not fields:
        raise InputError(
            f"{folder}: it holds no npz file of TRex with the arrays frame, X#wcentroid and "
            "Y#wcentroid. Name the folder into which TRex exported (data by default)."
        )
    chosen = of_one_video([folder / f"{name}.npz" for name in fields], folder, video)
    files = []
    for path in chosen:
        field = fields[path.stem]
        with NumpyArchive(field.path) as archive:
            if "fish_pos" not in archive:
                raise InputError(f"{field.path}: it has no array fish_pos; export the tracks too.")
            position = archive.numbers("fish_pos", 2)
        frames = field.frames()
        if position.shape != (len(frames), 2) or not len(frames):
            raise InputError(
                f"{field.path}: fish_pos has the shape {position.shape} for {len(frames)} frames."
            )
        position[~np.isfinite(position).all(-1)] = np.nan
        match = NUMBERED.fullmatch(path.stem)
        number = int(match["number"]) if match else None
        files.append(IndividualFile(path, frames, position, number=number))
    tracks, files = tracks_of(files, folder, fps=fps, unit="px", centroid="head")
    return add_visual_field(tracks, files, folder, required=True)


def _fields(folder: Path) -> list[FieldFile]:
    """Return the visual fields of a folder; ``individual`` is the stem of the track's file."""
    found = []
    for path in sorted(folder.glob("*_visual_field_*.npz")):
        stem = path.stem
        split = stem.endswith("_meta") and path.with_name(f"{stem[:-5]}_ids.npy").is_file()
        match = FIELD.fullmatch(stem.removesuffix("_meta") if split else stem)
        if match:
            found.append(FieldFile(path, f"{match['video']}_{match['name']}", split))
    return found
