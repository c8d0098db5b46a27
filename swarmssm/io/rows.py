"""Rows of a long or wide table, and from them one dense array for each trial."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from swarmssm.errors import InputError
from swarmssm.io.assembly import Piece, named_list
from swarmssm.io.clock import clock_of
from swarmssm.io.columns import AXES, Axis, Roles
from swarmssm.io.opening import check_memory, shorten
from swarmssm.io.text import Table
from swarmssm.tracks.time_grid import Array

__all__ = ["Rows", "load_rows", "pieces_of"]

Codes = npt.NDArray[np.int64]
#: Times that agree to this many digits after the point are one time.
TIME_DIGITS = 9


@dataclass
class Rows:
    """The cells of a table that matter.

    ``values`` has shape ``(row, individual, axis)`` and ``member`` is None in a wide table; in a
    long one it is ``(row, 1, axis)``, and ``member (row,)`` tells whose row it is. ``axes`` names
    the axes: those of position, then perhaps those of velocity. ``trial (row,)`` points into
    ``trials``, which is empty if the table has no such column.
    """

    table: Table
    individuals: list[str]
    axes: list[Axis]
    values: Array
    member: Codes | None
    probability: Array | None
    frame: Array | None
    time: Array | None
    trial: Codes
    trials: list[str]


def load_rows(table: Table, roles: Roles) -> Rows:
    """Read the columns that matter.

    Raises
    ------
    InputError
        If columns of positions are absent, unpaired or ambiguous, or a cell is no number.
    """
    single = dict(roles.single)
    if roles.doubled:
        raise InputError(
            f"{table.path}: the column {shorten(roles.doubled[0])} stands there more than once. "
            "Rename or remove one."
        )
    long = {"individual", "x", "y"} <= single.keys()
    if long or not roles.wide:
        _check_single(table, roles)
        columns = {"0": {axis: single[axis] for axis in AXES if axis in single}}
    else:
        columns = _paired(table, roles)
    axes = _common_axes(table, columns)
    if not long:
        single.pop("individual", None)
        single.pop("probability", None)
    cells = [columns[label][axis] for label in columns for axis in axes]
    texts = [single[role] for role in ("individual", "trial") if role in single]
    numbers = cells + [single[role] for role in ("frame", "probability") if role in single]
    if "time" in single:
        dated = not table.is_numeric(single["time"])
        clock = [single[role] for role in ("time", "date") if role in single and dated]
        texts += clock
        numbers += [] if dated else [single["time"]]
    loaded = table.load(numbers, texts)
    count = len(loaded[cells[0]])
    if not count:
        raise InputError(f"{table.path}: it has a header but no rows. Export it again.")
    time = None
    if "time" in single:
        time = _seconds(table, [loaded[c] for c in clock]) if dated else loaded[single["time"]]
        time = time * (1.0 if dated else roles.time_scale)
    trial, trials = np.zeros(count, dtype=np.int64), list[str]()
    if "trial" in single:
        trial, trials = _codes(table, loaded[single["trial"]], "trial")
    member, individuals = None, list(columns)
    if long:
        member, individuals = _codes(table, loaded[single["individual"]], "individual")
    return Rows(
        table,
        individuals,
        axes,
        np.stack([loaded[c] for c in cells], axis=-1).reshape(count, len(columns), len(axes)),
        member,
        loaded[single["probability"]] if "probability" in single else None,
        loaded[single["frame"]] if "frame" in single else None,
        time,
        trial,
        trials,
    )


def pieces_of(
    rows: Rows, fps: float | None, *, file_fps: float | None = None, pad_trials: bool = False
) -> list[Piece]:
    """Return one piece for each trial, all with the same individuals.

    Raises
    ------
    InputError
        If an individual stands twice in a frame, times do not increase, the frame rate is unknown,
        or trials differ in their individuals and are not to be padded.
    """
    names = rows.trials or [""]
    if rows.member is not None and not pad_trials:
        _check_same_members(rows, rows.member)
    pieces = []
    for number, name in enumerate(names):
        chosen = np.flatnonzero(rows.trial == number)
        where = f"{rows.table.path}: trial {name}" if name else f"{rows.table.path}"
        if rows.member is None:
            pieces.append(_wide_piece(rows, chosen, where, fps, file_fps))
        else:
            pieces.append(_long_piece(rows, rows.member, chosen, where, fps, file_fps))
    return pieces


def _wide_piece(
    rows: Rows, chosen: Codes, where: str, fps: float | None, file_fps: float | None
) -> Piece:
    clock = clock_of(
        where,
        len(chosen),
        fps=fps,
        file_fps=file_fps,
        frames=None if rows.frame is None else rows.frame[chosen],
        time=None if rows.time is None else rows.time[chosen],
        place=lambda row: rows.table.place(int(chosen[row])),
    )
    position, velocity = _split(rows.values[chosen], rows.axes)
    return Piece(position, clock, velocity)


def _long_piece(
    rows: Rows, member: Codes, chosen: Codes, where: str, fps: float | None, file_fps: float | None
) -> Piece:
    table = rows.table
    key = rows.frame if rows.frame is not None else rows.time
    if key is None:
        raise InputError(
            f"{table.path}: it has a column for the individual, but none for frame or time. Add "
            "one."
        )
    key = key[chosen]
    if np.isnan(key).any():
        row = int(chosen[np.argmax(np.isnan(key))])
        what = "frame" if rows.frame is not None else "time"
        raise InputError(f"{table.path}: {table.place(row)} has no {what}. Fill it in.")
    points, first, at = np.unique(
        np.round(key, TIME_DIGITS), return_index=True, return_inverse=True
    )
    cell = at * len(rows.individuals) + member[chosen]
    order = np.argsort(cell, kind="stable")
    twice = np.flatnonzero(np.diff(cell[order]) == 0)
    if twice.size:
        one, two = (int(chosen[order[twice[0] + i]]) for i in (0, 1))
        raise InputError(
            f"{where}: individual {shorten(rows.individuals[member[one]])} stands twice at "
            f"{'frame' if rows.frame is not None else 'time'} {key[order[twice[0]]]:.10g}, in "
            f"{table.place(one)} and {table.place(two)}. Take one of them away."
        )
    clock = clock_of(
        where,
        len(points),
        fps=fps,
        file_fps=file_fps,
        frames=None if rows.frame is None else points,
        time=None if rows.time is None else rows.time[chosen][first],
        place=lambda row: table.place(int(chosen[first[row]])),
    )
    shape = (len(points), len(rows.individuals), len(rows.axes))
    check_memory(table.path, 16 * int(np.prod(shape, dtype=np.float64)), "reading it")
    dense = np.full(shape, np.nan)
    dense[at, member[chosen]] = rows.values[chosen, 0]
    position, velocity = _split(dense, rows.axes)
    piece = Piece(position, clock, velocity)
    if rows.probability is not None:
        probability = np.full(shape[:2], np.nan)
        probability[at, member[chosen]] = rows.probability[chosen]
        piece.variables = {"id_probability": (("time", "individual"), probability)}
    return piece


def _split(values: Array, axes: list[Axis]) -> tuple[Array, Array | None]:
    """Return positions and velocities."""
    space = sum(axis in "xyz" for axis in axes)
    return values[..., :space], values[..., space:] if len(axes) > space else None


def _check_same_members(rows: Rows, member: Codes) -> None:
    """Refuse trials that differ in their individuals."""
    everyone = set(range(len(rows.individuals)))
    for number, name in enumerate(rows.trials):
        absent = sorted(everyone - set(np.unique(member[rows.trial == number]).tolist()))
        if absent:
            raise InputError(
                f"{rows.table.path}: trial {shorten(name)} has {len(everyone) - len(absent)} of "
                f"{len(everyone)} individuals, without "
                f"{named_list([rows.individuals[i] for i in absent])}. Mend the labels, or add "
                "--pad-trials if that is right."
            )


def _check_single(table: Table, roles: Roles) -> None:
    """Refuse a table whose header does not tell where the positions are."""
    path, names = table.path, named_list(table.names)
    absent = [axis for axis in ("x", "y") if axis not in roles.single]
    if len(absent) == 1:
        other = "y" if absent == ["x"] else "x"
        raise InputError(
            f"{path}: it has a column {other} but no column {absent[0]} (columns: {names}). Add it."
        )
    if absent and all(_is_number(name) for name in table.names):
        raise InputError(
            f"{path}: its first line holds numbers. Put a header there, such as frame,id,x,y."
        )
    if absent:
        raise InputError(
            f"{path}: no columns of positions are recognised among {names}. Name them frame, id, "
            "x, y (a row for each individual and frame) or x1, y1, x2, y2 ... (a row for each "
            "frame)."
        )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _paired(table: Table, roles: Roles) -> dict[str, dict[Axis, int]]:
    """Return the columns of each individual of a wide table."""
    if {"x", "y"} & roles.single.keys():
        other = table.names[min(min(pair.values()) for pair in roles.wide.values())]
        raise InputError(
            f"{table.path}: it has x and y and also {shorten(other)}, so that it is not clear "
            "whose positions x and y are. Add a column id, or take one kind away."
        )
    for label, columns in roles.wide.items():
        for axis, other in (("x", "y"), ("y", "x")):
            if axis not in columns:
                has = table.names[next(iter(columns.values()))]
                raise InputError(
                    f"{table.path}: individual {shorten(label)} has {shorten(has)} but no column "
                    f"of {axis} beside its {other}. Add it, or rename that column."
                )
    return roles.wide


def _common_axes(table: Table, columns: dict[str, dict[Axis, int]]) -> list[Axis]:
    """Return the axes that every individual has; velocities count only if they are whole."""
    for label, mine in columns.items():
        if ("z" in mine) != any("z" in other for other in columns.values()):
            raise InputError(
                f"{table.path}: individual {shorten(label)} has no z and others have. Add it."
            )
    position: list[Axis] = [axis for axis in AXES[:3] if axis in next(iter(columns.values()))]
    velocity = [axis for axis in AXES[3:] if axis[1] in position]
    whole = all(axis in mine for mine in columns.values() for axis in velocity)
    return position + (velocity if whole else [])


def _codes(table: Table, labels: npt.NDArray[np.str_], what: str) -> tuple[Codes, list[str]]:
    """Return which label each row has, and the labels: by number if they all are, else by name."""
    names, codes = np.unique(labels, return_inverse=True)
    if "" in names:
        row = int(np.argmax(labels == ""))
        raise InputError(f"{table.path}: {table.place(row)} has no {what}. Fill it in.")
    plain = [name.removesuffix(".0") if _is_number(name) else name for name in names.tolist()]
    if len(set(plain)) == len(plain):
        names = np.array(plain)
    if all(name.isascii() and name.isdigit() for name in names.tolist()):
        order = np.argsort([int(name) for name in names.tolist()], kind="stable")
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        names, codes = names[order], rank[codes]
    return codes.astype(np.int64).reshape(-1), [str(name) for name in names]


def _seconds(table: Table, columns: list[npt.NDArray[np.str_]]) -> Array:
    """Return the seconds since the earliest of dates written in ISO 8601."""
    texts = columns[0]
    if len(columns) > 1:
        texts = np.char.add(np.char.add(columns[1], "T"), texts)
    moments = pd.to_datetime(pd.Series(texts), format="ISO8601", errors="coerce", utc=True)
    wrong = moments.isna().to_numpy()
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{table.path}: {table.place(row)}: {shorten(texts[row])} is no time. Write seconds, "
            "or dates as 2015-09-10T07:00:00."
        )
    return np.asarray((moments - moments.min()).dt.total_seconds(), dtype=np.float64)
