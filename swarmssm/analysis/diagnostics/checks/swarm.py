"""What a statistic is given: a swarm as it was seen, observed or simulated alike."""

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

__all__ = ["Scales", "Swarm"]

#: Pairs of individuals of which a statistic of pairs is taken at most.
MAX_PAIRS = 400_000
#: The largest scale is this quantile of the observed.
FAR = 0.99


@dataclass(frozen=True)
class Swarm:
    """Runs of a swarm: of the recording, or of one replicate seen as the recording was.

    Attributes
    ----------
    position, velocity
        ``(run, time, individual, space)`` in the tracks' units, NaN where not seen. Velocities are
        differences of seen positions, ``(p(t) - p(t - 1)) * fps``, in both.
    fps
        Frames per second of these arrays.
    unit
        Of length; may be empty.
    walls
        The arena, if it is known.
    scales
        Sizes of the observed; the same for all replicates, so that histograms share their bins.
    """

    position: Array
    velocity: Array
    fps: float
    unit: str = ""
    walls: Arena | None = None
    scales: "Scales | None" = None

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """Who was seen when: ``(run, time, individual)``."""
        return np.asarray(np.isfinite(self.position).all(-1))

    @property
    def num_individuals(self) -> int:
        """Number of individuals, seen or not."""
        return int(self.position.shape[-2])

    @property
    def num_space(self) -> int:
        """Number of spatial dimensions."""
        return int(self.position.shape[-1])

    @cached_property
    def sparse(self) -> "Swarm":
        """Every so many frames of it, few enough that all pairs can be taken."""
        runs, times, individuals, _ = self.position.shape
        step = max(1, math.ceil(runs * times * individuals**2 / MAX_PAIRS))
        if step == 1:
            return self
        return Swarm(
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
class Scales:
    """Sizes of an observed swarm, from which bins are made.

    Attributes
    ----------
    speed, turn, nearest, pair
        99 % of speeds, absolute turning angles, distances to the nearest, distances of pairs are
        at most this. 1 where there are none (pi for ``turn``).
    wall
        98 % of distances to the wall are between these; 0 and 1 where there are none.
    near
        Half of the distances to the nearest are at most this.
    """

    speed: float
    turn: float
    nearest: float
    pair: float
    wall: tuple[float, float]
    near: float

    @classmethod
    def of(cls, swarm: Swarm) -> "Scales":
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
    """Return the size that a share of the values is within."""
    seen = values[np.isfinite(values)]
    size = float(np.quantile(seen, share)) if seen.size else 0.0
    return size if size > 0 else default


def _between(values: Array) -> tuple[float, float]:
    """Return between which sizes nearly all values are."""
    seen = values[np.isfinite(values)]
    if not seen.size:
        return 0.0, 1.0
    low, high = (float(end) for end in np.quantile(seen, [1.0 - FAR, FAR]))
    return (low, high) if high > low else (low - 0.5, low + 0.5)
