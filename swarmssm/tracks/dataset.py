"""Tracks: where each individual was at each time, as a validated xarray dataset.

The schema follows the ``movement`` package (singular dimension names)::

    position   (trial?, time, space, individual)      NaN = not tracked
    velocity   (trial?, time, space, individual)      optional, length unit per second
    adjacency  (trial?, time, individual, neighbor)   optional, 1 = individual sees neighbor

``time`` is in seconds on a regular grid of ``1 / fps``; ``attrs`` carry ``fps``, ``time_unit``,
``unit`` (of length), ``source_software`` and ``source_file``. Where y grows downwards, as in the
pixels of a video, ``attrs["y_axis"]`` is ``"down"``.
"""

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks.time_grid import MAX_FPS, MAX_JITTER, Array, time_grid
from swarmssm.tracks.validation import MAX_COORDINATE, SPACE_NAMES, text_of, validate_tracks

__all__ = [
    "MAX_COORDINATE",
    "MAX_FPS",
    "MAX_JITTER",
    "SPACE_NAMES",
    "Array",
    "has_trials",
    "make_tracks",
    "num_individuals",
    "observed",
    "spatial_attributes",
    "states_of",
    "stepwise_velocity",
    "validate_tracks",
    "with_trials",
]

#: Names that further variables may not bear, beside those of the dimensions.
RESERVED = ("position", "velocity", "adjacency", "frame", "trial")


def make_tracks(
    position: npt.ArrayLike | Sequence[npt.ArrayLike],
    *,
    fps: float | None = None,
    time: npt.ArrayLike | None = None,
    frames: npt.ArrayLike | None = None,
    individuals: Sequence[Hashable] | None = None,
    trials: Sequence[Hashable] | None = None,
    velocity: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
    adjacency: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
    unit: str = "",
    source_software: str = "",
    source_file: str = "",
    variables: Mapping[str, tuple[Sequence[str], npt.ArrayLike]] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Build tracks from arrays: the one constructor that every reader and simulator uses.

    Parameters
    ----------
    position
        Shape ``(time, individual, space)`` or ``(trial, time, individual, space)``, space 2 or 3,
        in ``unit``; NaN where an individual was not tracked. A list of ``(time, individual,
        space)`` arrays of differing length or number of individuals is padded with NaN. An
        individual of which only some coordinates are known was not tracked.
    fps
        Frames per second. Told by ``time`` if absent (:func:`swarmssm.tracks.time_grid.rate_of`).
    time
        Seconds, shape ``(time,)``, strictly increasing. Stamps within a quarter of a step of the
        grid ``1 / fps`` are snapped to it, and missing rows are filled with NaN.
    frames
        Integer frame numbers, shape ``(time,)``, strictly increasing; holes are filled with NaN.
        With ``fps`` they define the time, and ``time`` is then not needed.
    individuals, trials
        Labels, stored as strings; default ``"0", "1", ...``.
    velocity
        Same shape as ``position`` (or the same list of trials), in ``unit`` per second.
    adjacency
        Shape ``(..., time, individual, neighbor)`` of 0 and 1; ``[t, i, j] = 1`` when i sees j.
        The diagonal is 0.
    unit
        Unit of length, for instance ``"cm"`` or ``"px"``.
    source_software, source_file
        Where the tracks come from.
    variables
        Further data variables, name to ``(dims, array)``; dims as in the dataset, or new ones. In
        holes, floats are NaN and anything else is 0.
    attrs
        Further attributes of the dataset.

    Returns
    -------
    The validated dataset.

    Raises
    ------
    InputError
        If a shape, a label, a time or a value cannot be tracks.
    """
    positions, sizes_of_trials = _stack(position, "position")
    if positions.ndim not in (3, 4) or positions.shape[-1] not in (2, 3):
        raise InputError(
            "position: its shape must be (time, individual, space) or (trial, time, individual, "
            f"space) with 2 or 3 coordinates, and it is {positions.shape}."
        )
    trial_dim = ("trial",) if positions.ndim == 4 else ()
    num_times, num_members, num_space = positions.shape[-3:]
    rows, stamps, numbers, rate = time_grid(num_times, fps, time, frames)

    names = _labels(individuals, num_members, "individual")
    coords: dict[str, Any] = {
        "time": stamps,
        "space": list(SPACE_NAMES[:num_space]),
        "individual": names,
    }
    if numbers is not None:
        coords["frame"] = ("time", numbers)
    if trial_dim:
        coords["trial"] = _labels(trials, positions.shape[0], "trial")
    elif trials is not None:
        raise InputError(
            "trials: labels are given, and position has no trial dimension. Leave them out, or "
            "give position the shape (trial, time, individual, space)."
        )

    def place(values: npt.NDArray[Any], axis: int, blank: float) -> npt.NDArray[Any]:
        """Put the given rows on the regular time grid."""
        if len(rows) == len(stamps):
            return values
        shape = list(values.shape)
        shape[axis] = len(stamps)
        out = np.zeros(shape, values.dtype)
        if np.isnan(blank):
            out.fill(blank)
        out[(slice(None),) * axis + (rows,)] = values
        return out

    time_axis = len(trial_dim)
    dims = (*trial_dim, "time", "space", "individual")
    data: dict[str, Any] = {
        "position": (dims, np.swapaxes(place(positions, time_axis, np.nan), -1, -2))
    }
    if velocity is not None:
        velocities, given_sizes = _stack(velocity, "velocity")
        _check_shape("velocity", velocities.shape, positions.shape)
        _check_ragged("velocity", given_sizes, sizes_of_trials)
        data["velocity"] = (dims, np.swapaxes(place(velocities, time_axis, np.nan), -1, -2))
    if adjacency is not None:
        edges, given_sizes = _stack(adjacency, "adjacency", dtype=None)
        _check_shape("adjacency", edges.shape, (*positions.shape[:-1], num_members))
        square: Sizes = [(t, n, n) for t, n, _ in sizes_of_trials or ()]
        _check_ragged("adjacency", given_sizes, square)
        edge_dims = (*trial_dim, "time", "individual", "neighbor")
        data["adjacency"] = (edge_dims, place(edges, time_axis, 0.0))
    sizes = dict(zip(dims, (*positions.shape[:-2], num_space, num_members), strict=True))
    sizes["neighbor"] = num_members
    taken = {*sizes, *RESERVED}
    for name, (variable_dims, values) in (variables or {}).items():
        if name in taken:
            raise InputError(f"variables: the name {name} is taken. Choose another.")
        array = _variable(name, tuple(variable_dims), values, sizes, bool(trial_dim))
        if "time" in variable_dims:
            # Only floats can say that they are not known.
            blank = np.nan if array.dtype.kind in "fc" else 0.0
            array = place(array, list(variable_dims).index("time"), blank)
        data[name] = (tuple(variable_dims), array)

    given = dict(attrs or {})
    own = {"unit": unit, "source_software": source_software, "source_file": source_file}
    own = {key: value or given.get(key, "") for key, value in own.items()}
    given.update(fps=rate, time_unit="seconds", **own)
    return validate_tracks(xr.Dataset(data, coords, given))


def states_of(tracks: xr.Dataset) -> Array:
    """Return positions and velocities as one array.

    Parameters
    ----------
    tracks
        Tracks. Where they carry no velocity it is :func:`stepwise_velocity`.

    Returns
    -------
    Shape ``(trial, time, individual, 2 * space)``, ordered ``[x, y, vx, vy]`` (``[x, y, z, ...]``
    in 3-D), NaN where unknown. Tracks without trials have one.
    """
    tracks = with_trials(tracks)
    order = ("trial", "time", "individual", "space")
    position = tracks["position"].transpose(*order).to_numpy()
    num_space = position.shape[-1]
    states = np.empty((*position.shape[:-1], 2 * num_space))
    states[..., :num_space] = position
    if "velocity" in tracks:
        states[..., num_space:] = tracks["velocity"].transpose(*order).to_numpy()
    else:
        states[..., num_space:] = stepwise_velocity(position, tracks.attrs["fps"])
    return states


def stepwise_velocity(position: Array, fps: float) -> Array:
    """Backward difference, only across consecutive observed frames.

    ``v(t) = (p(t) - p(t - 1)) * fps``: it uses the past only, so that a forecast made at t does
    not know of t + 1, and it is the velocity that carried an individual to where it is.

    Parameters
    ----------
    position
        Shape ``(..., time, individual, space)``, NaN where not tracked.
    fps
        Frames per second.

    Returns
    -------
    Same shape, length unit per second; NaN in the first frame and in the first after each gap.
    """
    velocity = np.full(position.shape, np.nan)
    late, early = position[..., 1:, :, :], position[..., :-1, :, :]
    np.subtract(late, early, out=velocity[..., 1:, :, :])
    velocity *= fps
    return velocity


def observed(tracks: xr.Dataset) -> xr.DataArray:
    """Return where an individual was tracked: ``(trial?, time, individual)`` of bool."""
    return tracks["position"].notnull().all("space").rename("observed")


def has_trials(tracks: xr.Dataset) -> bool:
    """Return whether the tracks have a ``trial`` dimension."""
    return "trial" in tracks["position"].dims


def with_trials(tracks: xr.Dataset) -> xr.Dataset:
    """Return the tracks with a ``trial`` dimension, of length one if they had none."""
    if has_trials(tracks):
        return tracks
    # One trial picked out of several keeps its label beside it.
    label = str(tracks["trial"].item()) if "trial" in tracks.coords else "0"
    tracks = tracks.drop_vars("trial", errors="ignore")
    timed = [name for name in tracks.data_vars if "time" in tracks[name].dims]
    several = tracks[timed].expand_dims(trial=np.array([label]))
    return several.assign(tracks.drop_vars(timed).data_vars)


def spatial_attributes(tracks: xr.Dataset) -> dict[str, str]:
    """Return what a picture of space needs: ``unit``, and ``y_axis`` where y grows downwards."""
    attributes = {"unit": str(tracks.attrs.get("unit", ""))}
    if tracks.attrs.get("y_axis") == "down":
        attributes["y_axis"] = "down"
    return attributes


def num_individuals(tracks: xr.Dataset) -> int:
    """Return the number of individuals, tracked or not."""
    return int(tracks.sizes["individual"])


Sizes = list[tuple[int, ...]]


def _stack(
    values: npt.ArrayLike | Sequence[npt.ArrayLike],
    name: str,
    dtype: type[np.float64] | None = np.float64,
) -> tuple[npt.NDArray[Any], Sizes | None]:
    """Return one array of numbers, and each trial's own shape if they were given as a list."""
    if isinstance(values, list | tuple) and values:
        arrays = [_array(value, name, dtype) for value in values]
        if all(array.ndim == 3 for array in arrays):
            return _pad_trials(arrays, name, dtype)
        if len({array.shape for array in arrays}) > 1:
            raise InputError(
                f"{name}: the arrays of a list must have three dimensions each, and their shapes "
                f"are {', '.join(str(array.shape) for array in arrays[:5])}."
            )
        return np.stack(arrays), None
    return _array(values, name, dtype), None


def _array(values: object, name: str, dtype: type[np.float64] | None) -> npt.NDArray[Any]:
    """Return an array of numbers; what is masked is not known."""
    try:
        if isinstance(values, np.ma.MaskedArray):
            return np.ma.filled(values.astype(np.float64), np.nan)
        array = np.asarray(values)
        if array.dtype.kind == "O":
            array = array.astype(np.float64)
        if array.dtype.kind not in "fiub":
            raise TypeError(f"{array.dtype} is no real number")
        return array if dtype is None else array.astype(dtype, copy=False)
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{name}: it must be an array of numbers, or a list of one such array a trial."
        ) from error


def _pad_trials(
    arrays: list[npt.NDArray[Any]], name: str, dtype: type[np.float64] | None
) -> tuple[npt.NDArray[Any], Sizes]:
    """Stack trials that may differ in length and in the number of individuals."""
    sizes: Sizes = [array.shape for array in arrays]
    odd = [index for index, size in enumerate(sizes) if dtype and size[-1] != sizes[0][-1]]
    if odd:
        raise InputError(
            f"{name}: trial {odd[0]} has {sizes[odd[0]][-1]} coordinates, and trial 0 has "
            f"{sizes[0][-1]}. Give all trials the same."
        )
    shape = tuple(max(lengths) for lengths in zip(*sizes, strict=True))
    fill = np.nan if dtype else 0
    stacked = np.full((len(arrays), *shape), fill, dtype or np.result_type(*arrays))
    for target, array in zip(stacked, arrays, strict=True):
        target[tuple(slice(0, n) for n in array.shape)] = array
    return stacked, sizes


def _check_shape(name: str, shape: tuple[int, ...], expected: tuple[int, ...]) -> None:
    """Refuse an array that does not fit the positions."""
    if shape != expected:
        raise InputError(
            f"{name}: its shape is {shape}, and for this position it must be {expected}."
        )


def _check_ragged(name: str, given: Sizes | None, expected: Sizes | None) -> None:
    """Refuse a list of trials whose lengths are not those of the positions."""
    for index, (size, wanted) in enumerate(zip(given or (), expected or (), strict=False)):
        if size != wanted:
            raise InputError(
                f"{name}: its shape in trial {index} is {size}, and for this position it must be "
                f"{wanted}."
            )


def _variable(
    name: str,
    dims: tuple[str, ...],
    values: npt.ArrayLike,
    sizes: dict[str, int],
    trials: bool,
) -> npt.NDArray[Any]:
    """Return a further variable as an array of its own, and note the sizes of new dimensions."""
    try:
        array = np.array(values)
    except ValueError as error:
        raise InputError(f"variables: {name} must be an array.") from error
    if len(dims) != array.ndim or len(set(dims)) != len(dims):
        raise InputError(
            f"variables: {name} has the dimensions {dims} and an array of shape {array.shape}; "
            "name each axis once."
        )
    if "trial" in dims and not trials:
        raise InputError(f"variables: {name} has the dimension trial, and position has none.")
    for dim, size in zip(dims, array.shape, strict=True):
        if sizes.setdefault(dim, size) != size:
            raise InputError(
                f"variables: {name} has {size} along {dim}, where {sizes[dim]} are needed."
            )
    return array


def _labels(given: Sequence[Hashable] | None, count: int, what: str) -> list[str]:
    """Return labels as strings, one for each."""
    labels = [text_of(label) for label in (range(count) if given is None else given)]
    if len(labels) != count:
        raise InputError(f"{what}s: {len(labels)} labels are given for {count} {what}s.")
    return labels
