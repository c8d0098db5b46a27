"""NetCDF files: our own, which keep every number of the tracks, and those of ``movement``."""

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from swarmssm.errors import InputError, WorkError
from swarmssm.files import check_output, write_beside
from swarmssm.io.assembly import named_list
from swarmssm.io.hdf5 import open_hdf5
from swarmssm.io.opening import existing, reading
from swarmssm.tracks.time_grid import check_fps, rate_of
from swarmssm.tracks.validation import PLURALS, validate_tracks

__all__ = [
    "encoded",
    "read_netcdf",
    "restored",
    "restored_attributes",
    "writable",
    "write_buffered",
    "write_dataset",
    "write_tracks",
]

COMPRESSION = {"zlib": True, "complevel": 4, "shuffle": True}
#: Names of attributes that are stored as JSON text because NetCDF has no form for them.
JSON_LIST = "json_attributes"
CENTRES = ("centroid", "center", "centre")


def write_tracks(tracks: xr.Dataset, path: Path | str, *, overwrite: bool = False) -> None:
    """Write tracks to a NetCDF-4 file, compressed and without loss.

    Parameters
    ----------
    tracks
        Tracks; they are checked first.
    path
        The file to write. It is written beside and then renamed, so that no part of a file is
        ever seen.
    overwrite
        Whether an existing file may be replaced.

    Raises
    ------
    InputError
        If these are no tracks, or ``path`` exists or cannot be written to.
    WorkError
        If writing fails.
    """
    write_dataset(validate_tracks(tracks), path, overwrite=overwrite)


def write_dataset(dataset: xr.Dataset, path: Path | str, *, overwrite: bool = False) -> None:
    """Write any dataset as :func:`write_tracks` does, without asking whether it holds tracks.

    Attributes that NetCDF cannot hold (None, truth values, nested lists, dictionaries) are stored
    as JSON and come back as they were.

    Raises
    ------
    InputError
        If ``path`` exists or cannot be written to, or an attribute has no written form.
    WorkError
        If writing fails.
    """
    dataset, encoding = encoded(dataset)
    write_buffered(
        path,
        lambda buffer: dataset.to_netcdf(buffer, engine="h5netcdf", encoding=encoding),
        overwrite=overwrite,
    )


def encoded(dataset: xr.Dataset) -> tuple[xr.Dataset, dict[Any, dict[str, Any]]]:
    """Return a dataset with attributes that NetCDF can hold, and how to write its variables.

    Raises
    ------
    InputError
        If an attribute has no written form.
    """
    dataset = dataset.copy()
    dataset.attrs = writable(dataset.attrs)
    encoding: dict[Any, dict[str, Any]] = {}
    for name in dataset.variables:
        variable = dataset[name]
        variable.attrs = writable(variable.attrs)
        # What a file was read with (chunks, fill values) says nothing of how to write it.
        variable.encoding = {}
        numeric = variable.dtype.kind in "fiub"
        encoding[name] = {**COMPRESSION} if numeric and variable.ndim else {}
        if variable.dtype.kind in "iub":
            encoding[name]["_FillValue"] = None
    return dataset, encoding


def write_buffered(
    path: Path | str, write: Callable[[io.BytesIO], object], *, overwrite: bool = False
) -> None:
    """Write a file that ``write`` makes, in memory first.

    Raises
    ------
    InputError
        If ``path`` exists or cannot be written to.
    WorkError
        If writing fails.
    """
    check_output(Path(path), overwrite=overwrite)
    # The file is made in memory: libhdf5 crashes when it closes a file on a disk that is full.
    buffer = io.BytesIO()
    try:
        write(buffer)
    except (ValueError, TypeError, RuntimeError) as error:
        raise WorkError(f"{path}: could not be written ({error}).") from error
    with write_beside(Path(path), overwrite=overwrite) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def read_netcdf(
    path: Path | str, fps: float | None = None, *, keypoint: str | None = None
) -> xr.Dataset:
    """Read a NetCDF-4 file of our own, or a dataset of ``movement``.

    Parameters
    ----------
    path
        The file.
    fps
        Frames per second; needed if the file counts time in frames and does not tell. If it
        differs from the file's, time is counted anew from the file's start, and
        ``attrs["fps_in_file"]`` keeps the file's.
    keypoint
        Which point of the body, by its name in the file, or ``"mean"`` of those seen. Default:
        the one called centroid, else the mean. ``attrs["keypoint"]`` keeps which was taken.

    Returns
    -------
    Tracks.

    Raises
    ------
    InputError
        If the file is damaged or does not hold tracks, or there is no such keypoint.
    """
    place = existing(path)
    with open_hdf5(place, "NetCDF file"):
        pass
    with (
        reading(place, "NetCDF file"),
        xr.open_dataset(
            place, engine="h5netcdf", decode_times=False, decode_timedelta=False
        ) as opened,
    ):
        dataset = opened.load()
    with reading(place, "file of tracks"):
        dataset = _tidied(dataset)
        dataset = _one_keypoint(dataset, keypoint, place)
        if fps is not None:
            dataset = _with_rate(dataset, check_fps(fps, "fps"))
        dataset.attrs.setdefault("source_file", place.name)
        if dataset.attrs.get("fps") is None and _counts_frames(dataset):
            raise InputError(
                f"{place}: its time is in frames, and it does not tell their rate. Add fps=..."
            )
        return validate_tracks(dataset, where=str(place))


def _tidied(dataset: xr.Dataset) -> xr.Dataset:
    """Undo what the format makes of text and of attributes, and rename what is in the plural."""
    dataset = restored(dataset)
    return dataset.rename({old: new for old, new in PLURALS.items() if old in dataset.dims})


def restored(dataset: xr.Dataset) -> xr.Dataset:
    """Undo what the format makes of text and of attributes."""
    dataset = dataset.copy()
    for name in dataset.variables:
        variable = dataset[name]
        variable.encoding = {}
        variable.attrs = restored_attributes(variable.attrs)
        if variable.dtype.kind not in "fiubcmM":
            text = variable.astype(str)
            text.attrs = variable.attrs
            dataset = (
                dataset.assign_coords({name: text})
                if name in dataset.coords
                else (dataset.assign({name: text}))
            )
    dataset.encoding = {}
    dataset.attrs = restored_attributes(dataset.attrs)
    return dataset


def _one_keypoint(dataset: xr.Dataset, keypoint: str | None, path: Path) -> xr.Dataset:
    """Choose one point of the body, or leave the mean to be taken."""
    if "keypoint" not in dataset.dims:
        if keypoint is not None:
            raise InputError(f"{path}: it has no keypoints, so that none can be chosen.")
        return dataset
    count = dataset.sizes["keypoint"]
    labels = dataset["keypoint"].values if "keypoint" in dataset.coords else range(count)
    names = [str(name) for name in labels]
    wanted = keypoint
    if wanted is None:
        wanted = next((name for name in names if name.lower() in CENTRES), "mean")
        wanted = names[0] if count == 1 else wanted
    if wanted in names:
        dataset = dataset.isel(keypoint=names.index(wanted)).drop_vars("keypoint", errors="ignore")
    elif wanted != "mean":
        raise InputError(f"{path}: it has no keypoint {wanted!r}, but {named_list(names)}.")
    else:
        wanted = f"mean of {', '.join(names)}"
    dataset.attrs["keypoint"] = wanted
    return dataset


def _counts_frames(dataset: xr.Dataset) -> bool:
    return dataset.attrs.get("time_unit") == "frames" or "time" not in dataset.coords


def _with_rate(dataset: xr.Dataset, fps: float) -> xr.Dataset:
    """Let the caller's frame rate rule."""
    said = dataset.attrs.get("fps")
    if not _counts_frames(dataset) and dataset.sizes.get("time", 0) > 1:
        stamps = dataset["time"].to_numpy().astype(np.float64)
        rate = float(said) if said is not None else rate_of(stamps)
        if abs(rate - fps) > 1e-9 * fps:
            attrs = dict(dataset["time"].attrs)
            steps = np.round((stamps - stamps[0]) * rate)
            dataset = dataset.assign_coords(time=("time", stamps[0] + steps / fps, attrs))
            dataset.attrs["fps_in_file"] = rate
    dataset.attrs["fps"] = fps
    return dataset


def writable(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Return attributes in forms that NetCDF has."""
    out: dict[str, Any] = {}
    encoded = []
    for name, value in attrs.items():
        simple = isinstance(value, str | int | float | np.number) and not isinstance(value, bool)
        flat = isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "iuf"
        if simple or (flat and value.size):
            out[str(name)] = value
            continue
        try:
            out[str(name)] = json.dumps(value, default=_as_list)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"attribute {name}: a value of type {type(value).__name__} cannot be written. "
                "Make it text."
            ) from error
        encoded.append(str(name))
    if encoded:
        out[JSON_LIST] = json.dumps(encoded)
    return out


def _as_list(value: object) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(type(value).__name__)


def restored_attributes(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    """Undo :func:`writable`."""
    out = {str(name): value for name, value in attrs.items()}
    listed = out.pop(JSON_LIST, None)
    for name in json.loads(listed) if isinstance(listed, str) else []:
        out[name] = json.loads(out[name])
    for name, value in out.items():
        if isinstance(value, np.generic):
            out[name] = value.item()
    return out
