"""Statistics of a swarm by name: built-in ones and the user's own."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm.analysis.diagnostics.checks import observables
from swarmssm.analysis.diagnostics.checks.observables import Axis
from swarmssm.analysis.diagnostics.checks.swarm import ObservedSwarm
from swarmssm.errors import InputError

__all__ = ["STATISTICS", "Chosen", "Statistic", "chosen_statistics"]

KINDS = ("number", "curve", "histogram")


@dataclass(frozen=True)
class Statistic:
    """A statistic of a swarm: a number, a curve or a histogram.

    Attributes
    ----------
    name
        Name in a result; letters, digits and ``_``.
    title
        Name in tables and figures.
    function
        Takes a ``ObservedSwarm`` and returns a number, or an array that has
        the same shape for every swarm. It may look at everything in the swarm: ``position`` and
        ``velocity (run, time, individual, space)``, ``mask``, ``fps``, ``walls``. NaN says that
        it has no value.
    kind
        ``"number"``; ``"curve"``: values along axes; ``"histogram"``: shares of bins, of any number
        of dimensions, none negative. It says how swarms are compared, see
        ``p_values``. ``"auto"``: a number or a curve, as it comes.
    units
        Units of its values; ``{length}`` is replaced by the unit of the tracks.
    axes
        Axes of the array, from the recording; absent, they are numbered.
    walls, individuals, space
        Whether it needs walls, how many individuals at least, and how many dimensions.
    """

    name: str
    title: str
    function: Callable[[ObservedSwarm], npt.ArrayLike]
    kind: str = "auto"
    units: str = "1"
    axes: Callable[[ObservedSwarm], tuple[Axis, ...]] | None = None
    walls: bool = False
    individuals: int = 1
    space: int = 1

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InputError(
                f"statistics: {self.name!r} is no valid name; use letters, digits and _, as for a "
                "Python variable."
            )
        if self.kind not in (*KINDS, "auto"):
            raise InputError(
                f"statistics: the kind of {self.name} is {self.kind!r}; choose one of "
                f"{', '.join(KINDS)}."
            )

    def missing(self, swarm: ObservedSwarm) -> str:
        """Return why a swarm has no such statistic, empty if it has."""
        if swarm.num_individuals < self.individuals:
            return f"it needs {self.individuals} individuals"
        if swarm.num_space < self.space:
            return f"it needs {self.space} dimensions"
        if self.walls and swarm.walls is None:
            return "no walls are known"
        return ""

    def of(self, swarm: ObservedSwarm) -> npt.NDArray[np.float64]:
        """Return its value.

        Raises
        ------
        InputError
            If the function fails, or returns no numbers.
        """
        try:
            value = np.asarray(self.function(swarm), dtype=np.float64)
        except Exception as error:
            raise InputError(
                f"statistics: {self.name} failed with {type(error).__name__}: {error}. It is "
                "called with a ObservedSwarm and must return a number or an array of numbers."
            ) from error
        return value


def _built_in(
    kind: str,
    name: str,
    title: str,
    units: str = "1",
    axes: Callable[[ObservedSwarm], tuple[Axis, ...]] | None = None,
    *,
    group: int = 1,
    space: int = 1,
    walls: bool = False,
) -> Statistic:
    """Return the built-in statistic of a name, for at least ``group`` individuals."""
    function = getattr(observables, name)
    return Statistic(name, title, function, kind, units, axes, walls, group, space)


def _number(
    name: str, title: str, units: str = "1", *, group: int = 2, space: int = 1
) -> Statistic:
    return _built_in("number", name, title, units, group=group, space=space)


def _histogram(
    name: str, title: str, axes: Callable[[ObservedSwarm], tuple[Axis, ...]], **needs: Any
) -> Statistic:
    return _built_in("histogram", name, title, axes=axes, **needs)


def _curve(name: str, title: str, units: str = "1", *, space: int = 1) -> Statistic:
    return _built_in("curve", name, title, units, observables.lag_axes, space=space)


_BUILT_IN = (
    _number("polarization", "polarization"),
    _number("rotation", "rotation", space=2),
    _number("amd", "nearest-neighbour distance (AMD)", "{length}"),
    _number("displacement_difference", "mean displacement difference", "{length}/s"),
    _number("group_area", "group area", "{length}^2", group=3, space=2),
    _number("elongation", "elongation", group=3, space=2),
    _number("state_duration", "time between changes of state", "s", space=2),
    _histogram("states", "group states", observables.state_axes, group=2, space=2),
    _histogram("speed", "speeds", observables.speed_axes),
    _histogram("turning_angle", "turning angles", observables.turn_axes, space=2),
    _histogram(
        "nearest_distance", "nearest-neighbour distances", observables.nearest_axes, group=2
    ),
    _histogram("pair_distance", "pair distances", observables.pair_axes, group=2),
    _histogram(
        "heading_difference", "heading differences", observables.angle_axes, group=2, space=2
    ),
    _histogram("viewing_angle", "viewing angles", observables.angle_axes, group=2, space=2),
    _histogram(
        "neighbor_position",
        "relative positions of neighbours",
        observables.neighbor_axes,
        group=2,
        space=2,
    ),
    _histogram("wall_distance", "distances to the wall", observables.wall_axes, walls=True),
    _histogram("wall_angle", "angles to the wall", observables.angle_axes, space=2, walls=True),
    _curve("velocity_autocorrelation", "velocity autocorrelation"),
    _curve("heading_autocorrelation", "heading autocorrelation", space=2),
    _curve("displacement", "mean squared displacement", "{length}^2"),
)

#: What a user asks for: names, statistics, or functions by name.
Chosen = Iterable[str | Statistic] | Mapping[str, Callable[[ObservedSwarm], Any] | Statistic]
#: The built-in statistics, by name.
STATISTICS: dict[str, Statistic] = {one.name: one for one in _BUILT_IN}


def chosen_statistics(
    wanted: Chosen | None,
) -> list[Statistic]:
    """Return statistics by what a user gives.

    Parameters
    ----------
    wanted
        ``None``: all built-in ones. Names of built-in ones, or own statistics; or
        name -> function.

    Raises
    ------
    InputError
        If a name is unknown or given twice, or a function is not callable.
    """
    if wanted is None:
        return list(STATISTICS.values())
    if isinstance(wanted, str):
        wanted = [wanted]
    found = []
    if isinstance(wanted, Mapping):
        for name, one in wanted.items():
            if not callable(one) and not isinstance(one, Statistic):
                raise InputError(
                    f"statistics: {name} must be a function of a swarm, not {type(one).__name__}."
                )
            own = Statistic(str(name), str(name).replace("_", " "), one) if callable(one) else one
            found.append(own)
    else:
        for item in wanted:
            if isinstance(item, Statistic):
                found.append(item)
            elif item in STATISTICS:
                found.append(STATISTICS[item])
            else:
                raise InputError(
                    f"statistics: {item!r} is unknown. Choose of {', '.join(STATISTICS)}, or pass "
                    "your own as {name: function}."
                )
    names = [one.name for one in found]
    if not names or len(set(names)) < len(names):
        raise InputError("statistics: give at least one, and none twice.")
    return found
