"""From the arrays a reader found to tracks: the checks that all formats share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.clock import RATE_TOLERANCE, Clock
from swarmssm.io.opening import check_memory, shorten
from swarmssm.tracks import MAX_COORDINATE, make_tracks
from swarmssm.tracks.time_grid import Array

__all__ = ["EmptyPolicy", "Piece", "assemble", "check_distinct", "named_list", "settle_empty"]

EmptyPolicy = Literal["refuse", "drop", "keep"]
Variables = Mapping[str, tuple[Sequence[str], npt.NDArray[Any]]]


@dataclass
class Piece:
    """One recording as read: rows of positions and their clock.

    ``position`` and ``velocity`` have shape ``(row, individual, space)``, ``adjacency``
    ``(row, individual, neighbor)``; of ``variables`` those with the dimension ``time`` have it
    first and one entry a row.
    """

    position: Array
    clock: Clock
    velocity: Array | None = None
    adjacency: npt.NDArray[Any] | None = None
    variables: Variables = field(default_factory=dict)


def assemble(
    path: Path,
    pieces: Piece | Sequence[Piece],
    *,
    individuals: Sequence[str],
    trials: Sequence[str] | None = None,
    unit: str = "",
    source_software: str = "",
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Build tracks from one recording, or from several as trials.

    Rows missing on the grid are filled with NaN, shorter trials are padded with NaN at the end.

    Parameters
    ----------
    path
        The file or folder, for sentences and ``attrs["source_file"]``.
    pieces
        One piece: tracks without trials. A sequence: one trial each, all with the same individuals.
    individuals, trials
        Labels.
    unit, source_software, attrs
        As in :func:`swarmssm.tracks.make_tracks`.

    Raises
    ------
    InputError
        If a coordinate is infinite or absurd, a label is doubled, trials differ in frame rate, or
        the arrays do not fit together.
    """
    several = [pieces] if isinstance(pieces, Piece) else list(pieces)
    check_distinct(path, individuals, "individual")
    clock = several[0].clock
    for name, piece in zip(trials or [""], several, strict=True):
        if abs(piece.clock.fps - clock.fps) > RATE_TOLERANCE * clock.fps:
            raise InputError(
                f"{path}: trial {name} has {piece.clock.fps:g} frames per second and the first "
                f"one {clock.fps:g}. Import them one by one."
            )
        _check_coordinates(path, piece, individuals, name)
    length = max(piece.clock.length for piece in several)
    check_memory(path, 6 * 8 * length * len(several) * several[0].position[0].size, "reading it")
    timed = any(piece.clock.recorded is not None for piece in several)
    several = [_on_grid(piece, length, timed=timed) for piece in several]
    try:
        tracks = make_tracks(
            _merged([piece.position for piece in several], trials),
            fps=clock.fps,
            velocity=_merged([piece.velocity for piece in several], trials),
            adjacency=_merged([piece.adjacency for piece in several], trials),
            individuals=individuals,
            trials=trials,
            unit=unit,
            source_software=source_software,
            source_file=path.name,
            variables=_merged_variables(several, trials),
            attrs={**clock.attrs, **(attrs or {})},
        )
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix('tracks: ')}") from error
    return _with_clock(tracks, [piece.clock for piece in several])


def check_distinct(path: Path, labels: Sequence[str], what: str) -> None:
    """Refuse labels that stand there twice.

    Raises
    ------
    InputError
        Naming the first such label.
    """
    seen: set[str] = set()
    for label in labels:
        if label in seen:
            raise InputError(
                f"{path}: {what} {shorten(label)} stands there more than once. Rename one of them."
            )
        seen.add(label)


def settle_empty(tracks: xr.Dataset, policy: EmptyPolicy, where: object) -> xr.Dataset:
    """Deal with individuals that were not tracked in any frame.

    Parameters
    ----------
    tracks
        Tracks.
    policy
        ``"refuse"`` them, ``"drop"`` them and name them in ``attrs["left_out_individuals"]``, or
        ``"keep"`` them.
    where
        The file, for the sentence.

    Raises
    ------
    InputError
        If there are some and they are to be refused, or no individual would be left.
    """
    if policy not in ("refuse", "drop", "keep"):
        raise InputError(f"empty: {policy!r} is unknown; choose refuse, drop or keep.")
    others = [dim for dim in tracks["position"].dims if dim != "individual"]
    seen = tracks["position"].notnull().any(others).to_numpy()
    if policy == "keep" or seen.all():
        return tracks
    names = [str(name) for name in tracks["individual"].values[~seen]]
    if policy == "refuse":
        many = len(names) > 1
        raise InputError(
            f"{where}: individual{'s' * many} {named_list(names)} {'have' if many else 'has'} no "
            'position in any frame. Take them out of the file, or add empty="drop".'
        )
    chosen = {dim: seen for dim in ("individual", "neighbor") if dim in tracks.dims}
    left = tracks.isel(chosen)
    left.attrs["left_out_individuals"] = ", ".join(names)
    return left


def named_list(names: Sequence[object], most: int = 8) -> str:
    """Return ``a, b, c``, or the first few and how many more there are."""
    shown = ", ".join(shorten(name)[1:-1] for name in names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _check_coordinates(path: Path, piece: Piece, individuals: Sequence[str], trial: str) -> None:
    """Refuse infinite and absurd numbers, naming the first."""
    for name, values in (("position", piece.position), ("velocity", piece.velocity)):
        if values is None:
            continue
        bad = np.isinf(values) | (np.abs(values) > MAX_COORDINATE)
        if bad.any():
            row, member, axis = np.argwhere(bad)[0]
            where = f"{'trial ' * bool(trial)}{trial}{', ' * bool(trial)}row {row}"
            raise InputError(
                f"{path}: the {name} of individual {individuals[member]} in {where} is "
                f"{'xyz'[axis]} = {values[row, member, axis]:g}. Use NaN where it was not tracked."
            )


def _on_grid(piece: Piece, length: int, *, timed: bool) -> Piece:
    """Return the piece with one row for each of ``length`` grid points, if timed with its times."""
    index = piece.clock.index

    def place(values: npt.NDArray[Any], fill: float) -> npt.NDArray[Any]:
        if len(index) == length:
            return values
        # Integers cannot say that they are missing; floats can.
        kind = values.dtype if values.dtype.kind == "f" or fill == 0 else np.dtype(np.float64)
        out = np.full((length, *values.shape[1:]), fill, dtype=kind)
        out[index] = values
        return out

    variables: dict[str, tuple[Sequence[str], npt.NDArray[Any]]] = {}
    for name, (dims, values) in piece.variables.items():
        timed = "time" in dims
        variables[name] = (dims, place(values, np.nan) if timed else values)
    if timed:
        stamps = piece.clock.recorded
        stamps = piece.clock.start + index / piece.clock.fps if stamps is None else stamps
        variables["recorded_time"] = (("time",), place(stamps, np.nan))
    return Piece(
        place(piece.position, np.nan),
        piece.clock,
        None if piece.velocity is None else place(piece.velocity, np.nan),
        None if piece.adjacency is None else place(piece.adjacency, 0),
        variables,
    )


def _merged(arrays: Sequence[npt.NDArray[Any] | None], trials: object) -> Any:
    """Return the only array, or all of them stacked; None if one is absent."""
    present = [array for array in arrays if array is not None]
    if len(present) < len(arrays):
        return None
    return present[0] if trials is None else np.stack(present)


def _merged_variables(pieces: Sequence[Piece], trials: object) -> dict[str, Any]:
    """Stack the variables that all trials have; those without time are the same in all."""
    merged: dict[str, Any] = {}
    for name, (dims, _) in pieces[0].variables.items():
        # The dataset keeps space before individual, readers find it behind.
        arrays = [piece.variables[name][1] for piece in pieces]
        if trials is None or "time" not in dims:
            values, found = arrays[0], tuple(dims)
        else:
            values, found = np.stack(arrays), ("trial", *dims)
        if "space" in found and found.index("space") > found.index("individual"):
            first, second = found.index("individual"), found.index("space")
            values = np.swapaxes(values, first, second)
            swapped = list(found)
            swapped[first], swapped[second] = "space", "individual"
            found = tuple(swapped)
        merged[name] = (found, values)
    return merged


def _with_clock(tracks: xr.Dataset, clocks: Sequence[Clock]) -> xr.Dataset:
    """Put the recording's own time and frame numbers on the time axis.

    Trials that start at different times share a time axis that starts at 0.
    """
    clock = clocks[0]
    shared = all(other.origin == clock.origin for other in clocks)
    count = np.arange(tracks.sizes["time"])
    attrs = dict(tracks["time"].attrs)
    start = clock.start if shared else 0.0
    coords: dict[str, Any] = {"time": ("time", start + count / clock.fps, attrs)}
    if shared and clock.first_frame is not None:
        coords["frame"] = ("time", clock.first_frame + count * clock.frame_step)
    return tracks.assign_coords(coords)
