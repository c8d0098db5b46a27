"""The argument of a statistic: a swarm as observed, whether recorded or simulated."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm import metrics
from swarmssm.metrics.arena import Arena, wall_distances
from swarmssm.metrics.memory import turning_angles
from swarmssm.metrics.pairs import pair_distances
from swarmssm.tracks import Array

__all__ = ["BinScales", "ObservedSwarm"]

#: Statistics of pairs use at most this many pairs.
MAX_PAIRS = 400_000
#: Scales are this quantile of the recorded values.
FAR = 0.99


@dataclass(frozen=True)
class ObservedSwarm:
    """Runs of the recording, or of one replicate observed as the recording was.

    Attributes
    ----------
    position, velocity
        ``(run, time, individual, space)`` in the tracks' units, NaN where missing. Velocities are
        differences of observed positions, ``(p(t) - p(t - 1)) * fps``, in both.
    fps
        Frames per second of these arrays.
    unit
        Unit of length; may be empty.
    walls
        The arena, if known.
    scales
        Scales of the recording, also in replicates, so that histograms have the same bins.
    """

    position: Array
    velocity: Array
    fps: float
    unit: str = ""
    walls: Arena | None = None
    scales: "BinScales | None" = None

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """Whether an individual is observed: ``(run, time, individual)``."""
        return np.asarray(np.isfinite(self.position).all(-1))

    @property
    def num_individuals(self) -> int:
        """Number of individuals."""
        return int(self.position.shape[-2])

    @property
    def num_space(self) -> int:
        """Number of spatial dimensions."""
        return int(self.position.shape[-1])

    @cached_property
    def sparse(self) -> "ObservedSwarm":
        """Every n-th frame, so few that all pairs fit into memory."""
        runs, times, individuals, _ = self.position.shape
        step = max(1, math.ceil(runs * times * individuals**2 / MAX_PAIRS))
        if step == 1:
            return self
        return ObservedSwarm(
            self.position[:, ::step],
            self.velocity[:, ::step],
            self.fps / step,
            self.unit,
            self.walls,
            self.scales,
        )

    @cached_property
    def speed(self) -> Array:
        """Speeds ``(run, time, individual)``."""
        return metrics.speeds(self.velocity)


@dataclass(frozen=True)
class BinScales:
    """Scales of a recording, from which the bins of histograms are made.

    Attributes
    ----------
    speed, turn, nearest, pair
        99 % quantiles of speeds, absolute turning angles, nearest-neighbour distances and pair
        distances; 1 where there are none (pi for ``turn``).
    wall
        1 % and 99 % quantiles of the distances to the wall; 0 and 1 where there are none.
    near
        Median nearest-neighbour distance.
    """

    speed: float
    turn: float
    nearest: float
    pair: float
    wall: tuple[float, float]
    near: float

    @classmethod
    def of(cls, swarm: ObservedSwarm) -> "BinScales":
        """Measure a swarm."""
        few = swarm.sparse
        walls: Any = np.empty(0)
        if swarm.walls is not None:
            walls = wall_distances(swarm.position, swarm.walls)
        turns = turning_angles(swarm.velocity) if swarm.num_space > 1 else np.empty(0)
        nearest = metrics.nearest_neighbor_distance(few.position)
        return cls(
            _size(swarm.speed),
            min(_size(np.abs(turns), default=math.pi), math.pi),
            _size(nearest),
            _size(pair_distances(few.position)),
            _between(walls),
            _size(nearest, share=0.5),
        )


def _size(values: Array, *, share: float = FAR, default: float = 1.0) -> float:
    """Return a quantile of the finite values."""
    seen = values[np.isfinite(values)]
    size = float(np.quantile(seen, share)) if seen.size else 0.0
    return size if size > 0 else default


def _between(values: Array) -> tuple[float, float]:
    """Return the range of nearly all values."""
    seen = values[np.isfinite(values)]
    if not seen.size:
        return 0.0, 1.0
    low, high = (float(end) for end in np.quantile(seen, [1.0 - FAR, FAR]))
    return (low, high) if high > low else (low - 0.5, low + 0.5)
