"""Typical sizes in tracks, from which models take their units and default priors."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyro.distributions as dist
import torch
import xarray as xr
from pyro.nn import PyroSample

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.tracks import Array, states_of, with_trials
from swarmssm.tracks.kinematics import estimate_noise

__all__ = ["Scales", "scales_of"]

#: A tracking noise of less than this part of a mean step cannot be told from none.
LEAST_NOISE = 1e-4
#: The least that a unit may be, where tracks stand still.
LEAST_UNIT = 1e-6
#: Distances that are measured at most.
MOST_PAIRS = 20_000_000


@dataclass(frozen=True)
class Scales:
    """What a model may know of the tracks before it sees them.

    Attributes
    ----------
    space
        Number of spatial dimensions, 2 or 3.
    individuals
        Their number.
    dt
        Seconds from one frame to the next.
    centre, low, high
        Mean, least and greatest position on each axis.
    length
        Standard deviation of positions about the centre, over all axes.
    speed
        Root mean square of speed.
    slow, fast
        Second and ninety-eighth percentile of speed.
    spacing
        Median distance to the nearest neighbour.
    step
        Root mean square of what a coordinate of the velocity changes by in one frame.
    noise
        Estimated standard deviation of the tracking noise of a coordinate; 0 if it cannot be told.
    apart
        Ninety-eighth percentile of the distance to those whom an individual sees; 0 if nobody
        measured it.
    """

    space: int
    individuals: int
    dt: float
    centre: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    length: float
    speed: float
    slow: float
    fast: float
    spacing: float
    step: float
    noise: float
    apart: float = 0.0

    @property
    def state_dim(self) -> int:
        """Number of features of a physical state: positions and velocities."""
        return 2 * self.space

    def prior(
        self, *, length: float = 0.0, time: float = 0.0, factor: float = 1.0, spread: float = 1.5
    ) -> PyroSample:
        r"""Return a log-normal prior of a positive parameter in the unit of the tracks.

        Its median is :math:`c\, L^a T^b`, with L the standard deviation of positions and
        :math:`T = L / U` the time that an individual of typical speed U takes for it.

        Parameters
        ----------
        length, time
            a and b: the dimension of the parameter. A force by distance has ``time=-2``, a rate
            ``time=-1``, process noise ``length=1, time=-1.5``.
        factor
            c.
        spread
            Standard deviation of the logarithm; 1.5 is a factor of 20 to both sides with 95 %.
        """
        unit = max(self.length, LEAST_UNIT)
        period = unit / max(self.speed, LEAST_UNIT)
        median = math.log(factor) + length * math.log(unit) + time * math.log(period)
        return PyroSample(dist.LogNormal(torch.tensor(median), torch.tensor(spread)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Scales":
        """Undo :meth:`to_dict`."""
        plain: dict[str, Any] = {}
        for name, value in values.items():
            if name in ("space", "individuals"):
                plain[name] = int(value)
            elif isinstance(value, list):
                plain[name] = tuple(float(part) for part in value)
            else:
                plain[name] = float(value)
        return cls(**plain)


def scales_of(tracks: xr.Dataset, rule: GraphRule | None = None) -> Scales:
    """Measure the scales of tracks.

    Parameters
    ----------
    tracks
        The training part.
    rule
        Of who sees whom; absent, the adjacency of the tracks, or without one, all see all.

    Raises
    ------
    InputError
        If nobody is seen in two consecutive frames.
    """
    tracks = with_trials(tracks)
    states = states_of(tracks)
    space = states.shape[-1] // 2
    position, velocity = states[..., :space], states[..., space:]
    rows = position.reshape(-1, space)
    speeds = np.linalg.norm(velocity, axis=-1)
    if not np.isfinite(speeds).any():
        raise InputError(
            "tracks: no individual is seen in two consecutive frames of the training part."
        )
    centre = np.nanmean(rows, axis=0)
    slow, fast = np.nanpercentile(speeds, [2, 98])
    change = np.diff(velocity, axis=1)
    step = float(np.sqrt(np.nanmean(change**2))) if np.isfinite(change).any() else 0.0
    length = float(np.sqrt(np.nanmean((rows - centre) ** 2)))
    spacing = _spacing(position, length)
    return Scales(
        space=space,
        individuals=int(tracks.sizes["individual"]),
        dt=1.0 / float(tracks.attrs["fps"]),
        centre=tuple(centre.tolist()),
        low=tuple(np.nanmin(rows, axis=0).tolist()),
        high=tuple(np.nanmax(rows, axis=0).tolist()),
        length=length,
        speed=float(np.sqrt(np.nanmean(speeds**2))),
        slow=float(slow),
        fast=float(fast),
        spacing=spacing,
        step=step,
        noise=_noise(position, float(tracks.attrs["fps"])),
        apart=_apart(tracks, states, rule, 2.0 * length),
    )


def _noise(position: Array, fps: float) -> float:
    """Return the tracking noise, or 0 where the estimate is the least that it gives to any."""
    noise = float(estimate_noise(position, fps)[1])
    steps = np.abs(np.diff(position, axis=-3))
    moved = float(np.nanmean(steps)) if np.isfinite(steps).any() else 0.0
    return noise if noise > LEAST_NOISE * moved else 0.0


def _some_frames(frames: Array) -> npt.NDArray[np.int64]:
    """Return the places of at most 200 frames, fewer of large swarms."""
    count, individuals = len(frames), frames.shape[1]
    most = max(1, min(200, count, MOST_PAIRS // individuals**2))
    return np.linspace(0, count - 1, most).astype(np.int64)


def _spacing(position: Array, length: float) -> float:
    """Return the median distance to the nearest neighbour."""
    frames = position.reshape(-1, *position.shape[-2:])
    nearest = []
    for frame in frames[_some_frames(frames)]:
        seen = frame[np.isfinite(frame).all(-1)]
        if len(seen) > 1:
            apart = np.linalg.norm(seen[:, None] - seen[None], axis=-1)
            np.fill_diagonal(apart, np.inf)
            nearest.append(apart.min(-1))
    return float(np.median(np.concatenate(nearest))) if nearest else length


def _apart(tracks: xr.Dataset, states: Array, rule: GraphRule | None, alone: float) -> float:
    """Return the 98th percentile of the distance along the graph; ``alone`` if it has no edges."""
    flat = states.reshape(-1, *states.shape[-2:])
    index = _some_frames(flat)
    space = flat.shape[-1] // 2
    frames = torch.from_numpy(np.ascontiguousarray(flat[index]))
    position = frames[..., :space]
    if rule is not None:
        graph = rule(position, frames[..., space:]).numpy() != 0
    elif "adjacency" in tracks:
        dims = ("trial", "time", "individual", "neighbor")
        own = tracks["adjacency"].transpose(*dims).to_numpy()
        graph = own.reshape(-1, *own.shape[-2:])[index] != 0
    else:
        graph = ~np.eye(flat.shape[-2], dtype=bool)
    distance = torch.cdist(position, position).numpy()
    distance = distance[np.isfinite(distance) & graph]
    return float(np.percentile(distance, 98)) if distance.size else alone
