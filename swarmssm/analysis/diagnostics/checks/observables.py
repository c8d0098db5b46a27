"""The built-in statistics: functions of an ``ObservedSwarm``.

Those of fish in a tank - speed, distance and angle to the wall, distance and headings of
neighbours, viewing angle, displacement and autocorrelations - are the observables by which
Papaspyros et al. (2024, J. R. Soc. Interface 21:20230630) judge models of pairs, and the
Hellinger distance between their distributions is theirs too.

Histograms are shares of equal bins, made from the ``BinScales`` of the
observed; the first and the last bin also hold what lies beyond. A number over time is the mean
over all frames of all runs.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarmssm import metrics
from swarmssm.analysis.diagnostics.checks.arenas import wall_name
from swarmssm.analysis.diagnostics.checks.swarm import BinScales, ObservedSwarm
from swarmssm.metrics import memory
from swarmssm.metrics.arena import Arena, wall_angles, wall_distances
from swarmssm.metrics.pairs import (
    heading_differences,
    neighbor_positions,
    pair_distances,
    viewing_angles,
)
from swarmssm.metrics.shape import elongation as elongation_of
from swarmssm.metrics.shape import group_area as group_area_of
from swarmssm.metrics.states import STATES, group_states, mean_state_duration
from swarmssm.tracks import Array

#: Bins of a histogram, of one of angles from 0 to pi, and of each side of a map.
BINS, ANGLE_BINS, MAP_BINS = 30, 18, 15
#: Upper end of the bins, in scales of the recording.
ROOM = 1.25
LAGS = 30
#: Reach of the map of neighbours, in median nearest-neighbour distances.
MAP_REACH = 6.0


class Axis(NamedTuple):
    """An axis of a statistic: its name, the places along it, their unit and meaning."""

    name: str
    values: Array
    units: str
    long_name: str


def polarization(swarm: ObservedSwarm) -> float:
    """Mean over time of the polarization."""
    return _mean(metrics.polarization(swarm.velocity))


def rotation(swarm: ObservedSwarm) -> float:
    """Mean over time of the rotation (milling) order."""
    return _mean(metrics.rotation(swarm.position, swarm.velocity))


def amd(swarm: ObservedSwarm) -> float:
    """Mean over time of the average minimum distance (4.4)."""
    return _mean(metrics.amd(swarm.position))


def displacement_difference(swarm: ObservedSwarm) -> float:
    """Mean over time of the average difference of two displacements from frame to frame.

    As the average velocity difference (4.5), but of positions as observed, noise included.
    """
    return _mean(metrics.avd(swarm.velocity))


def group_area(swarm: ObservedSwarm) -> float:
    """Mean over time of the area (volume) of the convex hull."""
    return _mean(group_area_of(swarm.sparse.position))


def elongation(swarm: ObservedSwarm) -> float:
    """Mean over time of the elongation."""
    return _mean(elongation_of(swarm.position))


def state_duration(swarm: ObservedSwarm) -> float:
    """Mean time between changes of swarm, polarized and milling, in seconds."""
    return mean_state_duration(_states(swarm), swarm.fps)


def states(swarm: ObservedSwarm) -> Array:
    """Shares of time as a swarm, polarized, milling and in transition (Tunstrøm et al. 2013)."""
    found = _states(swarm)
    counts = np.bincount(found[found >= 0], minlength=len(STATES)).astype(np.float64)
    return counts / counts.sum() if counts.sum() else np.full(len(STATES), np.nan)


def state_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the states, numbered in the order of their names."""
    return (Axis("state", np.arange(float(len(STATES))), "1", ", ".join(STATES)),)


def speed(swarm: ObservedSwarm) -> Array:
    """Histogram of speeds."""
    return _binned(swarm.speed, _up_to(_scales(swarm).speed))


def speed_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the bins of speed."""
    return (_bins("bin", _up_to(_scales(swarm).speed), _unit(swarm, "/s"), "speed"),)


def turning_angle(swarm: ObservedSwarm) -> Array:
    """Histogram of turning angles from frame to frame."""
    return _binned(memory.turning_angles(swarm.velocity), _turn_edges(swarm))


def turn_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the bins of turning angles."""
    return (_bins("bin", _turn_edges(swarm), "rad", "turning angle in one frame"),)


def nearest_distance(swarm: ObservedSwarm) -> Array:
    """Histogram of nearest-neighbour distances."""
    distances = metrics.nearest_neighbor_distance(swarm.sparse.position)
    return _binned(distances, _up_to(_scales(swarm).nearest))


def nearest_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the bins of nearest-neighbour distances."""
    edges = _up_to(_scales(swarm).nearest)
    return (_bins("bin", edges, _unit(swarm), "nearest-neighbour distance"),)


def pair_distance(swarm: ObservedSwarm) -> Array:
    """Histogram of pair distances."""
    return _binned(pair_distances(swarm.sparse.position), _up_to(_scales(swarm).pair))


def pair_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the bins of pair distances."""
    edges = _up_to(_scales(swarm).pair)
    return (_bins("bin", edges, _unit(swarm), "pair distance"),)


def heading_difference(swarm: ObservedSwarm) -> Array:
    """Histogram of the angles between headings."""
    return _binned(heading_differences(swarm.sparse.velocity), _angle_edges())


def viewing_angle(swarm: ObservedSwarm) -> Array:
    """Histogram of bearings of the other individuals, 0 ahead."""
    few = swarm.sparse
    return _binned(viewing_angles(few.position, few.velocity), _angle_edges())


def angle_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the bins of angles from 0 to pi."""
    return (_bins("bin", _angle_edges(), "rad", "angle"),)


def neighbor_position(swarm: ObservedSwarm) -> Array:
    """Relative positions of the other individuals: ahead, and to the left (in 3-D: aside)."""
    few = swarm.sparse
    found = neighbor_positions(few.position, few.velocity).reshape(-1, 2)
    found = found[np.isfinite(found).all(-1)]
    if not len(found):
        return np.full((MAP_BINS, MAP_BINS), np.nan)
    edges = _map_edges(swarm)
    ends = [(edge[0], np.nextafter(edge[-1], 0.0)) for edge in edges]
    inside = [np.clip(found[:, axis], *ends[axis]) for axis in (0, 1)]
    counts = np.histogram2d(inside[0], inside[1], bins=edges)[0]
    return np.asarray(counts / counts.sum(), dtype=np.float64)


def neighbor_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the bins of the map."""
    ahead, left = _map_edges(swarm)
    aside = "to the left" if swarm.num_space == 2 else "aside"
    return (
        _bins("ahead", ahead, _unit(swarm), "ahead"),
        _bins("left", left, _unit(swarm), aside),
    )


def wall_distance(swarm: ObservedSwarm) -> Array:
    """Histogram of distances to the nearest wall, below 0 outside."""
    return _binned(wall_distances(swarm.position, _walls(swarm)), _wall_edges(swarm))


def wall_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the bins of distances to the wall, named after what is known of it."""
    title = f"distance to {wall_name(swarm.walls)}, negative outside"
    return (_bins("bin", _wall_edges(swarm), _unit(swarm), title),)


def wall_angle(swarm: ObservedSwarm) -> Array:
    """Histogram of the angles between heading and direction to the nearest wall."""
    angles = wall_angles(swarm.position, swarm.velocity, _walls(swarm))
    return _binned(angles, _angle_edges())


def velocity_autocorrelation(swarm: ObservedSwarm) -> Array:
    """Autocorrelation of velocities."""
    return memory.velocity_autocorrelation(swarm.velocity, _lags(swarm))


def heading_autocorrelation(swarm: ObservedSwarm) -> Array:
    """Autocorrelation of headings."""
    return memory.heading_autocorrelation(swarm.velocity, _lags(swarm))


def displacement(swarm: ObservedSwarm) -> Array:
    """Mean squared displacement."""
    return memory.mean_squared_displacement(swarm.position, _lags(swarm))


def lag_axes(swarm: ObservedSwarm) -> tuple[Axis, ...]:
    """Return the lags in seconds."""
    return (Axis("lag", np.array(_lags(swarm)) / swarm.fps, "s", "time apart"),)


def _mean(values: Array) -> float:
    """Return the mean of the finite values."""
    seen = values[np.isfinite(values)]
    return float(seen.mean()) if seen.size else float("nan")


def _states(swarm: ObservedSwarm) -> npt.NDArray[np.int64]:
    order = metrics.polarization(swarm.velocity)
    return group_states(order, metrics.rotation(swarm.position, swarm.velocity))


def _binned(values: Array, edges: Array) -> Array:
    """Return the shares of values in bins; the first and the last bin are open."""
    seen = values[np.isfinite(values)]
    if not seen.size:
        return np.full(len(edges) - 1, np.nan)
    inside = np.clip(seen, edges[0], np.nextafter(edges[-1], edges[0]))
    counts = np.histogram(inside, bins=edges)[0]
    return np.asarray(counts / seen.size, dtype=np.float64)


def _bins(name: str, edges: Array, units: str, long_name: str) -> Axis:
    return Axis(name, 0.5 * (edges[1:] + edges[:-1]), units, long_name)


def _up_to(scale: float) -> Array:
    return np.linspace(0.0, ROOM * scale, BINS + 1)


def _turn_edges(swarm: ObservedSwarm) -> Array:
    most = min(math.pi, ROOM * _scales(swarm).turn)
    return np.linspace(-most if swarm.num_space == 2 else 0.0, most, BINS + 1)


def _angle_edges() -> Array:
    return np.linspace(0.0, math.pi, ANGLE_BINS + 1)


def _map_edges(swarm: ObservedSwarm) -> tuple[Array, Array]:
    far = min(_scales(swarm).pair, MAP_REACH * _scales(swarm).near)
    whole = np.linspace(-far, far, MAP_BINS + 1)
    return whole, whole if swarm.num_space == 2 else np.linspace(0.0, far, MAP_BINS + 1)


def _wall_edges(swarm: ObservedSwarm) -> Array:
    low, high = _scales(swarm).wall
    room = (ROOM - 1.0) * (high - low)
    return np.linspace(low - room, high + room, BINS + 1)


def _lags(swarm: ObservedSwarm) -> list[int]:
    """Return up to 30 lags, from one frame to half a run, ever wider apart."""
    most = max(1, swarm.position.shape[1] // 2)
    lags = np.unique(np.round(np.geomspace(1, most, LAGS)).astype(int))
    return [int(lag) for lag in lags]


def _scales(swarm: ObservedSwarm) -> BinScales:
    return BinScales.of(swarm) if swarm.scales is None else swarm.scales


def _walls(swarm: ObservedSwarm) -> Arena:
    if swarm.walls is None:
        raise ValueError("the swarm has no walls")
    return swarm.walls


def _unit(swarm: ObservedSwarm, per: str = "") -> str:
    return f"{swarm.unit or 'length units'}{per}"
