"""What the columns of a table mean, told by their names."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

__all__ = ["AXES", "Axis", "Roles", "roles_of"]

Axis = Literal["x", "y", "z", "vx", "vy", "vz"]
AXES: tuple[Axis, ...] = ("x", "y", "z", "vx", "vy", "vz")

#: Role -> names, in lower case and with ``_`` for every separator.
NAMES = {
    "frame": "frame frames frame_number frame_no frame_id frame_index frame_idx framenumber "
    "frameindex frame_nr",
    "time": "time t time_s seconds sec timestamp time_sec datetime date_time time_stamp",
    "date": "date",
    "individual": "individual individuals individual_id id ids identity track track_id trackid "
    "tracks animal animal_id agent agent_id fish fish_id bird bird_id robot robot_id object "
    "object_id particle particle_id subject subject_id tag tag_id name",
    "trial": "trial trial_id trials session session_id recording recording_id video video_id "
    "experiment replicate segment",
    "probability": "probability probabilities confidence likelihood id_probability",
}
for _axis in "xyz":
    NAMES[_axis] = (
        f"{_axis} pos_{_axis} {_axis}_pos position_{_axis} {_axis}_position {_axis}pos pos{_axis} "
        f"{_axis}_coord coord_{_axis} {_axis}_centroid centroid_{_axis} center_{_axis} "
        f"centre_{_axis} {_axis}_center {_axis}_centre"
    )
    NAMES[f"v{_axis}"] = f"v{_axis} v_{_axis} vel_{_axis} velocity_{_axis} {_axis}_velocity"
ROLE_OF = {name: role for role, names in NAMES.items() for name in names.split()}

#: ``x1``, ``pos_x_1``, ``vx1``, ``x_fish1``.
AXIS_FIRST = re.compile(
    r"(?:pos(?:ition)?_)?(?P<v>v(?:el(?:ocity)?_)?_?)?(?P<axis>[xyz])(?:_(?P<name>.+)|(?P<digits>\d+))",
    re.IGNORECASE,
)
#: ``fish1_x``, ``fish1_vx``, ``fish1_pos_x``.
AXIS_LAST = re.compile(
    r"(?P<name>.+?)_(?:pos(?:ition)?_)?(?P<v>v(?:el(?:ocity)?_)?_?)?(?P<axis>[xyz])", re.IGNORECASE
)
#: ``fish1x``.
AXIS_GLUED = re.compile(r"(?P<name>.*\d)(?P<v>v?)(?P<axis>[xyz])", re.IGNORECASE)
UNIT = re.compile(r"\s*[(\[](?P<unit>[^()\[\]]*)[)\]]\s*$")
LENGTH_SUFFIX = re.compile(r"_(?P<unit>um|µm|mm|cm|km|m|px|pixels?)$", re.IGNORECASE)
TIME_SUFFIX = re.compile(r"_(?P<unit>ms|us|min|s)$", re.IGNORECASE)
SECONDS = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}


@dataclass
class Roles:
    """Columns by index.

    ``single`` maps a role to its column, ``wide`` an individual's label to the columns of its axes
    in a table with columns for each individual. ``doubled`` are columns whose meaning an earlier
    one of the same name has already. ``time_scale`` is the number of seconds in the unit of the
    time column.
    """

    single: dict[str, int] = field(default_factory=dict)
    wide: dict[str, dict[Axis, int]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    doubled: list[str] = field(default_factory=list)
    unit: str = ""
    time_scale: float = 1.0


def roles_of(names: Sequence[str]) -> Roles:
    """Tell what each column means.

    Units are understood in brackets (``x (cm)``, ``time [ms]``) or as an ending (``x_cm``,
    ``time_ms``). Of several columns with one role the first counts.

    Parameters
    ----------
    names
        The header.
    """
    roles = Roles()
    for index, name in enumerate(names):
        role, unit = _single_role(name)
        if role == "time" and unit.lower() in ("frame", "frames"):
            role = "frame"
        if role is not None and role not in roles.single:
            roles.single[role] = index
            if role in ("x", "y") and unit:
                roles.unit = unit
            if role == "time":
                roles.time_scale = SECONDS.get(unit.lower(), 1.0)
        elif (found := _wide_role(name)) is not None:
            label, axis, unit = found
            columns = roles.wide.setdefault(label, {})
            if axis in columns:
                roles.doubled.append(name)
            else:
                columns[axis] = index
                roles.unit = roles.unit or unit * (axis in ("x", "y"))
        elif role is not None and name in names[:index]:
            roles.doubled.append(name)
        else:
            roles.left_out.append(name)
    return roles


def _plain(name: str) -> tuple[str, str]:
    """Return a name with ``_`` for every separator, and the unit that stood in brackets."""
    found = UNIT.search(name)
    bare = UNIT.sub("", name).strip()
    return re.sub(r"[\s.:\-_]+", "_", bare).strip("_"), found["unit"].strip() if found else ""


def _single_role(name: str) -> tuple[str | None, str]:
    """Return the role of a column that stands once, and its unit."""
    plain, unit = _plain(name)
    role = ROLE_OF.get(plain.lower())
    if role is not None or unit:
        return role, unit
    for suffix, allowed in ((LENGTH_SUFFIX, AXES), (TIME_SUFFIX, ("time",))):
        found = suffix.search(plain)
        role = ROLE_OF.get(suffix.sub("", plain).lower()) if found else None
        if found and role in allowed:
            return role, found["unit"]
    return None, ""


def _wide_role(name: str) -> tuple[str, Axis, str] | None:
    """Return individual, axis and unit of a column of a wide table."""
    plain, unit = _plain(name)
    suffix = LENGTH_SUFFIX.search(plain)
    if suffix and not unit:
        plain, unit = LENGTH_SUFFIX.sub("", plain), suffix["unit"]
    for pattern in (AXIS_FIRST, AXIS_LAST, AXIS_GLUED):
        found = pattern.fullmatch(plain)
        if found:
            groups = found.groupdict()
            label = groups["name"] or groups["digits"]
            axis = ("v" if groups["v"] else "") + groups["axis"].lower()
            return label, next(a for a in AXES if a == axis), unit
    return None
