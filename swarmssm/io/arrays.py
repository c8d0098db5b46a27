"""Tracks in plain arrays of numpy: an ``.npz`` file with ``xy`` or ``X``, or one ``.npy`` array."""

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.assembly import Piece, assemble, check_distinct, named_list
from swarmssm.io.attributes import plain_attribute
from swarmssm.io.clock import clock_of
from swarmssm.io.numpy_files import NPY_MAGIC, NumpyArchive, read_npy
from swarmssm.io.opening import existing, first_bytes
from swarmssm.tracks.time_grid import Array, check_fps

__all__ = ["POSITION_KEYS", "read_arrays"]

#: Names of positions, and of states ``[x, y, vx, vy]``.
POSITION_KEYS = ("xy", "xyz", "position", "positions", "X", "states")
STATE_KEYS = ("X", "states")
KEYS = {
    "velocity": ("velocity", "velocities"),
    "adjacency": ("A", "adjacency"),
    "time": ("time_s", "time"),
    "frames": ("frame", "frames"),
    "individuals": ("id", "ids", "individual", "individuals"),
    "trials": ("trial", "trials"),
    "segment": ("segment", "segments"),
    "fps": ("fps",),
    "dt": ("dt",),
    "unit": ("unit",),
}
#: Lists of trials and other settings, even where their length is that of an axis.
SETTINGS = {"train", "val", "validation", "test", "params"}
#: Names with a meaning of their own in a dataset.
RESERVED = {"position", "velocity", "adjacency", "time", "space", "individual", "neighbor", "trial"}
RESERVED |= {"frame", "recorded_time", "source_time", "fps", "time_unit", "unit"}


def read_arrays(path: Path | str, fps: float | None = None) -> xr.Dataset:
    """Read tracks from an ``.npz`` or ``.npy`` file of plain arrays.

    ``xy`` has the shape ``(time, individual, space)``, or ``(trial, time, individual, space)``;
    ``X`` has ``[x, y, vx, vy]`` as its last axis (or three of each), and ``A (..., time,
    individual, neighbor)`` is its adjacency. ``time_s`` (seconds), ``frame``, ``fps`` or ``dt``
    (also as an entry of a JSON text ``params``), ``id`` and ``unit`` are understood. ``segment
    (time,)`` numbers recordings laid end to end: each becomes a trial, so that nothing is ever
    differenced from one to the next, and ``source_time (trial, time)`` keeps its seconds. Arrays
    with the shape of the tracks become variables, all others attributes; what can be neither is
    named in ``attrs["left_out_arrays"]``.

    Parameters
    ----------
    path
        The file.
    fps
        Frames per second; needed where the file has neither ``fps``, ``dt`` nor times.

    Returns
    -------
    Tracks.

    Raises
    ------
    InputError
        If there is no such array, shapes do not fit together, times or frames do not increase, or
        the file is damaged.
    """
    place = existing(path)
    if first_bytes(place).startswith(NPY_MAGIC):
        position, velocity = _split(place, "its array", read_npy(place))
        return _assembled(place, position, velocity, {}, {}, fps)
    with NumpyArchive(place) as archive:
        key = next((key for key in POSITION_KEYS if key in archive), None)
        if key is None:
            raise InputError(
                f"{place}: it has no array xy (time, individual, 2), but {named_list(archive.keys)}"
                ". Name it so."
            )
        names = {
            role: next(name for name in names if name in archive)
            for role, names in KEYS.items()
            if any(name in archive for name in names)
        }
        arrays = {role: archive.read(name) for role, name in names.items()}
        taken = {key, *names.values()}
        others = {name: archive.read(name) for name in archive.keys if name not in taken}
        position, velocity = _split(place, key, archive.read(key), states=key in STATE_KEYS)
    if velocity is None and "velocity" in arrays:
        velocity = _real(place, "velocity", arrays["velocity"])
    return _assembled(place, position, velocity, arrays, others, fps)


def _split(
    path: Path, name: str, values: npt.NDArray[Any], *, states: bool = True
) -> tuple[Array, Array | None]:
    """Return positions, and velocities if the last axis holds both."""
    numbers = _real(path, name, values)
    space = numbers.shape[-1] if numbers.ndim in (3, 4) else 0
    if space in (2, 3):
        return numbers, None
    if states and space in (4, 6):
        return numbers[..., : space // 2], numbers[..., space // 2 :]
    raise InputError(
        f"{path}: {name} has the shape {values.shape}; it must be (time, individual, 2 or 3), "
        "perhaps with trial before."
    )


def _real(path: Path, name: str, values: npt.NDArray[Any]) -> Array:
    if values.dtype.kind not in "fiub":
        raise InputError(f"{path}: {name} holds {values.dtype}, not numbers.")
    with np.errstate(over="ignore"):
        return values.astype(np.float64)


def _assembled(
    path: Path,
    position: Array,
    velocity: Array | None,
    arrays: Mapping[str, npt.NDArray[Any]],
    others: Mapping[str, npt.NDArray[Any]],
    fps: float | None,
) -> xr.Dataset:
    """Build tracks from arrays by role, one piece for each trial or segment."""
    *lead, rows, members = position.shape[:-1]
    edges = arrays.get("adjacency")
    _check_shapes(path, position, velocity, arrays)
    variables, attrs = _sorted_out(position.shape, others)
    time = _real(path, "time", arrays["time"]) if "time" in arrays else None
    frames = _real(path, "frame", arrays["frames"]) if "frames" in arrays else None
    rate = _frame_rate(path, arrays, others)
    trials: list[str] | None = None
    places: list[Any] = [...]
    if lead:
        trials = _labels(arrays.get("trials"), lead[0])
        places = list(range(lead[0]))
    elif "segment" in arrays:
        starts, trials = _runs(path, arrays["segment"])
        places = [slice(*edge) for edge in itertools.pairwise([*starts, rows])]
    pieces = []
    for place, trial in zip(places, trials or [""], strict=True):
        # Trials share their times, segments have each their own part.
        part = place if isinstance(place, slice) else ...
        clock = clock_of(
            f"{path}: segment {trial}" if isinstance(place, slice) else path,
            len(position[place]),
            fps=fps,
            file_fps=rate,
            frames=None if frames is None else frames[part],
            time=None if time is None else time[part],
        )
        mine = {
            name: (dims, values[place] if "time" in dims else values)
            for name, (dims, values) in variables.items()
        }
        if isinstance(place, slice) and time is not None:
            mine["source_time"] = (("time",), time[part])
        pieces.append(
            Piece(
                position[place],
                clock,
                None if velocity is None else velocity[place],
                None if edges is None else edges[place],
                mine,
            )
        )
    unit = arrays["unit"].reshape(-1) if "unit" in arrays else np.empty(0)
    return assemble(
        path,
        pieces[0] if trials is None else pieces,
        individuals=_labels(arrays.get("individuals"), members),
        trials=trials,
        unit=str(unit[0]) if unit.size == 1 else "",
        attrs=attrs,
    )


def _check_shapes(
    path: Path, position: Array, velocity: Array | None, arrays: Mapping[str, npt.NDArray[Any]]
) -> None:
    """Refuse arrays that do not fit the positions."""
    *lead, rows, members = position.shape[:-1]
    if 0 in position.shape:
        raise InputError(f"{path}: its positions have the shape {position.shape}; they are none.")
    if velocity is not None and velocity.shape != position.shape:
        raise InputError(
            f"{path}: velocity has the shape {velocity.shape} and position {position.shape}."
        )
    sizes = {"time": rows, "frames": rows, "segment": rows, "individuals": members}
    for role, size in {**sizes, **({"trials": lead[0]} if lead else {})}.items():
        if role in arrays and arrays[role].shape != (size,):
            raise InputError(
                f"{path}: {role} has the shape {arrays[role].shape}, and positions of shape "
                f"{position.shape} need ({size},)."
            )
    edges = arrays.get("adjacency")
    if edges is None:
        return
    if edges.shape != (*position.shape[:-1], members) or not np.isin(edges, (0, 1)).all():
        raise InputError(
            f"{path}: its adjacency has the shape {edges.shape}; it must be "
            f"{(*position.shape[:-1], members)} and hold 0 and 1 only."
        )
    if np.einsum("...ii->...i", edges).any():
        raise InputError(f"{path}: its adjacency has an individual that sees itself.")


def _runs(path: Path, segment: npt.NDArray[Any]) -> tuple[list[int], list[str]]:
    """Return where each run of equal entries starts, and what it is called."""
    change = np.flatnonzero(segment[1:] != segment[:-1]) + 1
    starts = [0, *change.tolist()]
    names = [str(segment[start]) for start in starts]
    check_distinct(path, names, "segment")
    return starts, names


def _labels(given: npt.NDArray[Any] | None, count: int) -> list[str]:
    """Return labels as text, whole numbers without a point."""
    if given is None:
        return [str(i) for i in range(count)]
    return [str(v).removesuffix(".0") if given.dtype.kind == "f" else str(v) for v in given]


def _frame_rate(
    path: Path, arrays: Mapping[str, npt.NDArray[Any]], others: Mapping[str, npt.NDArray[Any]]
) -> float | None:
    """Return frames per second from ``fps``, ``dt`` or the entry ``dt`` of ``params``."""
    for name in ("fps", "dt"):
        if name in arrays:
            numbers = _real(path, name, arrays[name])
            if numbers.size != 1:
                raise InputError(f"{path}: {name} has the shape {numbers.shape}; give one number.")
            value = float(numbers.reshape(-1)[0])
            return value if name == "fps" else _rate_of_step(path, value)
    params = others.get("params")
    if params is not None and params.dtype.kind == "U" and params.size == 1:
        try:
            said = json.loads(str(params.reshape(-1)[0]))
        except (ValueError, RecursionError):
            return None
        if isinstance(said, dict) and isinstance(said.get("dt"), int | float):
            return _rate_of_step(path, float(said["dt"]))
    return None


def _rate_of_step(path: Path, dt: float) -> float:
    """Return frames per second for a time step in seconds."""
    if not 0 < dt < np.inf:
        raise InputError(f"{path}: dt is {dt:g}; it must be a positive number of seconds.")
    # 1 / 0.1 is 10, but 1 / 0.3 carries an error of rounding that no one wrote.
    return check_fps(round(1.0 / dt, 9), str(path))


def _sorted_out(
    shape: Sequence[int], others: Mapping[str, npt.NDArray[Any]]
) -> tuple[dict[str, tuple[tuple[str, ...], npt.NDArray[Any]]], dict[str, Any]]:
    """Return what fits the positions as variables, the rest as attributes.

    The variables' dimensions are those behind ``trial``.
    """
    dims = ("time", "individual", "space")
    kinds: dict[tuple[int, ...], tuple[str, ...]] = {}
    for count in (1, 2, 3):
        kinds[tuple(shape[: len(shape) - 3 + count])] = dims[:count]
    kinds.setdefault((shape[-2],), ("individual",))
    variables: dict[str, tuple[tuple[str, ...], npt.NDArray[Any]]] = {}
    attrs: dict[str, Any] = {}
    left_out = []
    for name, values in others.items():
        found = kinds.get(values.shape)
        # Text can be told for an individual, but has no gap to fill along time.
        allowed = "fiub" if found and "time" in found else "fiubU"
        if found and name not in SETTINGS | RESERVED and values.dtype.kind in allowed:
            variables[name] = (found, values)
        elif name not in RESERVED and (plain := plain_attribute(values)) is not None:
            attrs[name] = plain
        else:
            left_out.append(name)
    if left_out:
        attrs["left_out_arrays"] = named_list(left_out, 50)
    return variables, attrs
