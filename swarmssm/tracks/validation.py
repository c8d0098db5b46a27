"""Checking a dataset from anywhere against the schema of tracks."""

import hashlib
import weakref
from collections.abc import Hashable
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks.time_grid import ROUNDING, check_fps, check_increasing, grid_rows, rate_of

__all__ = ["MAX_COORDINATE", "SPACE_NAMES", "checked_digest", "text_of", "validate_tracks"]

SPACE_NAMES = ("x", "y", "z")
MAX_COORDINATE = 1e12
PLURALS = {"individuals": "individual", "keypoints": "keypoint", "neighbors": "neighbor"}

#: What was checked: the dataset by its identity, and the digest of what it held then. A dataset can
#: be changed in place, which the digest notices.
_VALIDATED: dict[int, tuple[weakref.ref[xr.Dataset], bytes]] = {}


def validate_tracks(dataset: xr.Dataset, where: str = "tracks") -> xr.Dataset:
    """Check a dataset from anywhere against the schema, and bring it into our own order.

    Accepts the datasets of ``movement`` (plural dimension names of 0.15 and 0.16, one keypoint or
    several: their mean is taken; other variables of keypoints are left out), and other orders of
    the dimensions, of ``x, y, z`` and of the neighbors. Time stamps that jitter by less than a
    quarter of a step are put on the grid, and a place known in part is not known.

    Parameters
    ----------
    dataset
        A dataset with at least ``position``.
    where
        What to call it in an error: the file's name.

    Returns
    -------
    A new dataset; the given one is not changed. A dataset that was checked before, followed the
    schema, and was not changed since is returned as it is.

    Raises
    ------
    InputError
        In the words of the data, naming ``where``, the variable and the place.
    """
    if not isinstance(dataset, xr.Dataset):
        raise InputError(
            f"{where}: tracks are a dataset, as swarmssm.io.read or swarmssm.tracks.make_tracks "
            f"returns it, not {type(dataset).__name__}."
        )
    known, checked = _VALIDATED.get(id(dataset), (None, b""))
    is_known = known is not None and known() is dataset
    if is_known and _digest(dataset) == checked:
        return dataset
    validated = _validated(dataset, where)
    digest = _digest(validated)
    _remember(validated, digest)
    # Nothing had to be changed: the given one need not be checked again either.
    if _digest(dataset) == digest:
        _remember(dataset, digest)
    return validated


def _remember(dataset: xr.Dataset, digest: bytes) -> None:
    """Note that a dataset was checked, as long as it lives."""
    key = id(dataset)
    _VALIDATED[key] = (weakref.ref(dataset, lambda _: _VALIDATED.pop(key, None)), digest)


def checked_digest(dataset: xr.Dataset) -> bytes:
    """Return the digest of what a dataset held when :func:`validate_tracks` returned it."""
    return _VALIDATED[id(dataset)][1]


def _digest(dataset: xr.Dataset) -> bytes:
    """Return a digest of all that validation looks at."""
    digest = hashlib.sha256()
    own = ("fps", "time_unit", "unit", "y_axis", "source_software", "source_file")
    attrs = {name: dataset.attrs.get(name) for name in own}
    digest.update(repr((attrs, dict(dataset.sizes))).encode())
    for name, variable in sorted(dataset.variables.items(), key=lambda item: str(item[0])):
        units = variable.attrs.get("units")
        about = [name, variable.dims, variable.dtype, bool(variable.encoding), units]
        if name in ("position", "velocity", "adjacency") or name in dataset.dims:
            values = variable.to_numpy()
            # In validated tracks all are contiguous: of others no copy need be made to see that
            # they differ.
            about.append(values.flags.c_contiguous)
            if values.dtype.kind in "OT":
                about.append(values.tolist())
            elif values.flags.c_contiguous:
                digest.update(values.view(np.uint8).data)
        digest.update(repr(about).encode())
    return digest.digest()


def _validated(dataset: xr.Dataset, where: str) -> xr.Dataset:
    """Check a dataset against the schema; return it in our own order."""
    renames = {old: new for old, new in PLURALS.items() if old in dataset.dims}
    # How a file packed its numbers says nothing of how they are to be written again.
    dataset = dataset.rename(renames).drop_encoding()
    if "position" not in dataset:
        found = ", ".join(map(str, dataset.data_vars)) or "no variable at all"
        raise InputError(f"{where}: it has no variable called position (found: {found}).")
    if "keypoint" in dataset["position"].dims:
        dataset = _centre_of_keypoints(dataset, where)
    extra = ("trial",) if "trial" in dataset["position"].dims else ()
    dims = (*extra, "time", "space", "individual")
    if set(dataset["position"].dims) != set(dims):
        raise InputError(
            f"{where}: position has the dimensions {tuple(map(str, dataset['position'].dims))}; "
            "it needs time, space and individual, and may have trial."
        )
    dataset = _check_space(dataset, where)
    if (y_axis := dataset.attrs.get("y_axis", "up")) not in ("up", "down"):
        raise InputError(f"{where}: y_axis must be up or down, and it is {y_axis!r}.")
    for dim in ("individual", *extra):
        dataset = _check_labels(dataset, dim, where)
    if "neighbor" in dataset.dims:
        dataset = _check_neighbors(dataset, where)
    dataset = _check_time(dataset, where)
    for name in ("position", "velocity"):
        if name in dataset:
            dataset[name] = _motion(dataset, name, dims, where)
    if not dataset["position"].notnull().any():
        raise InputError(f"{where}: no individual has a position in any frame.")
    if "adjacency" in dataset:
        edge_dims = (*extra, "time", "individual", "neighbor")
        dataset["adjacency"] = _edges(dataset, edge_dims, where)
    return dataset


def text_of(label: object) -> str:
    """Return a label as text; older files hold bytes."""
    return label.decode(errors="replace") if isinstance(label, bytes) else str(label)


def _centre_of_keypoints(dataset: xr.Dataset, where: str) -> xr.Dataset:
    """Put the mean of the keypoints that were seen in the place of all of them."""
    points = dataset["position"]
    if points.dtype.kind not in "fiub":
        raise InputError(f"{where}: position holds no numbers.")
    if np.isinf(points.to_numpy()).any():
        raise InputError(f"{where}: position of a keypoint is infinite; use NaN for not seen.")
    if "space" in points.dims:
        points = points.where(points.notnull().all("space"))
    kept = [name for name in dataset.data_vars if "keypoint" not in dataset[name].dims]
    centre = points.mean("keypoint", skipna=True, keep_attrs=True)
    return dataset[kept].assign(position=centre)


def _check_space(dataset: xr.Dataset, where: str) -> xr.Dataset:
    """Bring the spatial axes into the order x, y and perhaps z, and refuse others."""
    size = dataset.sizes["space"]
    wanted = list(SPACE_NAMES[:size])
    if "space" not in dataset.coords:
        raise InputError(
            f"{where}: the {size} entries of the space axis have no names. Name them x, y or "
            "x, y, z."
        )
    names = [text_of(name) for name in dataset["space"].values]
    if size not in (2, 3) or sorted(names) != wanted:
        raise InputError(
            f"{where}: the space axis must be x, y or x, y, z, and it is {', '.join(names)}."
        )
    dataset = dataset.assign_coords(space=names)
    return dataset if names == wanted else dataset.sel(space=wanted)


def _check_labels(dataset: xr.Dataset, dim: str, where: str) -> xr.Dataset:
    """Make labels strings, and refuse doubled ones."""
    size = dataset.sizes[dim]
    if size == 0:
        raise InputError(f"{where}: it has no {dim}.")
    names = [text_of(v) for v in (dataset[dim].values if dim in dataset.coords else range(size))]
    if len(set(names)) < size:
        doubled = next(name for index, name in enumerate(names) if name in names[:index])
        raise InputError(f"{where}: the {dim} {doubled} stands there more than once.")
    return dataset.assign_coords({dim: names})


def _check_neighbors(dataset: xr.Dataset, where: str) -> xr.Dataset:
    """Bring the neighbors into the order of the individuals; they are the same animals."""
    members = [str(name) for name in dataset["individual"].values]
    if dataset.sizes["neighbor"] != len(members):
        raise InputError(
            f"{where}: it has {dataset.sizes['neighbor']} neighbors and {len(members)} individuals;"
            " each individual must be a neighbor too."
        )
    if "neighbor" in dataset.coords:
        names = [text_of(name) for name in dataset["neighbor"].values]
        if sorted(names) != sorted(members):
            other = next(name for name in names if name not in members or names.count(name) > 1)
            raise InputError(
                f"{where}: the neighbor {other} is not one of the individuals, each of which must "
                "stand there once."
            )
        if names != members:
            dataset = dataset.isel(neighbor=[names.index(name) for name in members])
    return dataset.assign_coords(neighbor=members)


def _check_time(dataset: xr.Dataset, where: str) -> xr.Dataset:
    """Put seconds on the time axis, and check them and fps."""
    size = dataset.sizes["time"]
    if size < 2:
        have = "1 frame" if size else "no frame"
        raise InputError(f"{where}: it has {have}; motion needs at least 2.")
    attrs = dict(dataset.attrs)
    fps = attrs.get("fps")
    notes: dict[Hashable, Any] = {}
    in_frames = attrs.get("time_unit") == "frames"
    stamps = np.arange(size, dtype=np.float64)
    if "time" in dataset.coords:
        raw = dataset["time"].to_numpy()
        notes = dict(dataset["time"].attrs)
        if raw.dtype.kind not in "fium":
            raise InputError(f"{where}: time must be in seconds or frames, not {raw.dtype}.")
        stamps = (raw / np.timedelta64(1, "s") if raw.dtype.kind == "m" else raw).astype(np.float64)
        check_increasing(stamps, f"{where}: time")
    elif fps is None:
        raise InputError(f"{where}: it has no time and fps is not known; give fps.")
    else:
        in_frames = True
    if in_frames:
        if fps is None:
            raise InputError(f"{where}: time is in frames and fps is not known; give fps.")
        stamps = stamps / check_fps(fps, f"{where}: fps")
    rate = check_fps(rate_of(stamps) if fps is None else fps, f"{where}: fps")
    rows, start = grid_rows(stamps, rate, f"{where}: time", "Mend fps or time.")
    if rows[-1] != size - 1:
        place = int(np.argmax(np.diff(rows) != 1)) + 1
        raise InputError(
            f"{where}: time row {place} comes {stamps[place] - stamps[place - 1]:g} s after the "
            f"row before it, where fps = {rate:g} asks for {1 / rate:g} s. Put rows of NaN where "
            "frames are missing."
        )
    # Stamps that lie on the grid already are kept to the last digit.
    if np.abs((stamps - start) * rate - rows).max() > ROUNDING:
        stamps = start + rows / rate
    dataset = dataset.assign_coords(time=("time", stamps, {**notes, "units": "s"}))
    dataset.attrs = {"unit": "", "source_software": "", "source_file": "", **attrs}
    dataset.attrs.update(fps=rate, time_unit="seconds")
    return dataset


def _numbers_of(
    dataset: xr.Dataset, name: str, dims: tuple[str, ...], where: str
) -> npt.NDArray[Any]:
    """Return a variable's numbers in the order of the schema."""
    if set(dataset[name].dims) != set(dims):
        raise InputError(
            f"{where}: {name} has the dimensions {tuple(map(str, dataset[name].dims))}; "
            f"it needs {', '.join(dims)}."
        )
    values = dataset[name].transpose(*dims).to_numpy()
    if values.dtype.kind not in "fiub":
        raise InputError(f"{where}: {name} holds no numbers.")
    return values


def _motion(dataset: xr.Dataset, name: str, dims: tuple[str, ...], where: str) -> xr.Variable:
    """Return position or velocity as a contiguous array of its own, without half-known places."""
    values = np.array(_numbers_of(dataset, name, dims, where), dtype=np.float64, order="C")
    # The extremes need no array of the tracks' size, and NaN is neither.
    if np.fmin.reduce(values, axis=None) < -MAX_COORDINATE or (
        np.fmax.reduce(values, axis=None) > MAX_COORDINATE
    ):
        bad = np.argwhere(np.abs(values) > MAX_COORDINATE)[0]
        raise InputError(
            f"{where}: {name} {_place(dataset, dims, bad)} is {values[tuple(bad)]:g}; use NaN for "
            "what was not seen."
        )
    unknown = np.isnan(values).any(-2, keepdims=True)
    np.copyto(values, np.nan, where=unknown)
    unit = dataset.attrs["unit"]
    units = unit if name == "position" else f"{unit}/s".lstrip("/")
    return xr.Variable(dims, values, {**dataset[name].attrs, "units": units})


def _edges(dataset: xr.Dataset, dims: tuple[str, ...], where: str) -> xr.Variable:
    """Return the adjacency as zeros and ones, of which nobody sees itself."""
    values = _numbers_of(dataset, "adjacency", dims, where)
    wrong = np.zeros(0, dtype=bool) if values.dtype.kind == "b" else (values != 0) & (values != 1)
    if wrong.any():
        bad = np.argwhere(wrong)[0]
        raise InputError(
            f"{where}: adjacency {_place(dataset, dims, bad)} is {values[tuple(bad)]:g}; it must "
            "be 0 or 1."
        )
    itself = np.einsum("...ii->...i", values)
    if itself.any():
        bad = np.argwhere(itself)[0]
        raise InputError(
            f"{where}: adjacency {_place(dataset, dims, bad)} says that the individual sees "
            "itself; set it to 0."
        )
    edges = np.array(values, dtype=np.uint8, order="C")
    return xr.Variable(dims, edges, dict(dataset["adjacency"].attrs))


def _place(dataset: xr.Dataset, dims: tuple[str, ...], index: npt.NDArray[np.int64]) -> str:
    """Say in words where an entry lies."""
    at = dict(zip(dims, index.tolist(), strict=False))
    words = [f"of individual {dataset['individual'].values[at['individual']]}"]
    if "neighbor" in at:
        words.append(f"to neighbor {dataset['neighbor'].values[at['neighbor']]}")
    if "trial" in at:
        words.append(f"in trial {dataset['trial'].values[at['trial']]}")
    return " ".join([*words, f"in time row {at['time']}"])
