"""The Vicsek model: everyone takes the mean heading of those around, with an error."""

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy.typing as npt
import torch
import xarray as xr
from torch import Tensor

from swarmssm.graphs import GraphRule
from swarmssm.simulate.directions import disturb_uniform, random_directions, unit
from swarmssm.simulate.recording import (
    check_number,
    check_space,
    directions_given,
    record,
)

__all__ = ["Vicsek", "simulate_vicsek"]

#: Individuals in a unit of area or volume where no box says how densely to begin.
START_DENSITY = 4.0


@dataclasses.dataclass(frozen=True)
class Vicsek:
    """The dynamics of :func:`simulate_vicsek`, which documents the parameters."""

    dt: float
    space: int
    speed: float
    radius: float
    box: float | None
    process_noise: float

    name: ClassVar[str] = "vicsek"
    remedy: ClassVar[str] = "Try a smaller dt or speed."
    terms: ClassVar[tuple[str, ...]] = ("alignment",)
    force_meaning: ClassVar[str] = "acceleration from the own to the mean heading in one step"

    def __post_init__(self) -> None:
        check_space(self.space)
        for name in ("dt", "speed"):
            check_number(name, getattr(self, name), above_zero=True)
        check_number("radius", self.radius)
        check_number("process_noise", self.process_noise, most=2.0 * math.pi)
        if self.box is not None:
            check_number("box", self.box, above_zero=True)
        _ = self.graph_rule  # refuses a radius above half the box

    @functools.cached_property
    def graph_rule(self) -> GraphRule:
        """The rule of the interaction graph."""
        return GraphRule("radius", radius=self.radius, box=self.box)

    def start(
        self, trials: int, individuals: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Draw positions all over the box, and headings all around."""
        shape = (trials, individuals, self.space)
        side = self.box or (individuals / START_DENSITY) ** (1 / self.space)
        positions = side * torch.rand(shape, dtype=torch.float64, generator=generator)
        return positions, self.speed * random_directions(shape, generator)

    def begin(self, velocities: Tensor) -> Tensor:
        """Bring the velocities to the speed of all."""
        return self.speed * directions_given(velocities)

    def forces(self, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Return the one term ``(..., 1, individual, space)`` and the graph."""
        graph = self.graph_rule(positions)
        heading = velocities / self.speed
        mean = unit(heading + graph.to(heading.dtype) @ heading, heading)
        return ((self.speed * mean - velocities) / self.dt).unsqueeze(-3), graph

    def move(
        self,
        positions: Tensor,
        velocities: Tensor,
        force: Tensor,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return the next positions and velocities; without a generator those free of noise."""
        own = velocities / self.speed
        heading = unit(own + self.dt / self.speed * force.sum(-3), own)
        if generator is not None and self.process_noise > 0.0:
            heading = disturb_uniform(heading, self.process_noise, generator)
        return positions + self.dt * velocities, self.speed * heading

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters, for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Vicsek":
        """Return the dynamics that :meth:`to_dict` described."""
        return cls(**values)


def simulate_vicsek(
    individuals: int = 100,
    steps: int = 1000,
    trials: int = 1,
    *,
    dt: float = 1.0,
    space: int = 2,
    speed: float = 0.03,
    radius: float = 1.0,
    box: float | None = 5.0,
    process_noise: float = 1.0,
    observation_noise: float = 0.0,
    seed: int | torch.Generator = 0,
    burn_in: int = 0,
    initial_position: npt.ArrayLike | None = None,
    initial_velocity: npt.ArrayLike | None = None,
) -> xr.Dataset:
    r"""Simulate the Vicsek model, with the truth behind every step.

    All at once, each individual goes on along its velocity and takes over the mean heading of all
    within ``radius``, itself included, with an error:

    .. math::
        x_i' = x_i + dt\, v_i, \qquad
        \theta_i' = \arg \sum_{j: |x_j - x_i| \le r} e^{\mathrm{i} \theta_j} + \Delta\theta_i,
        \qquad \Delta\theta_i \sim U[-\eta / 2, \eta / 2].

    As in (1) and (2) of the paper the position moves with the *old* velocity, so that a velocity is
    the forward difference of positions. Where the mean heading vanishes, one's own is kept. In
    three dimensions the error is uniform on the spherical cap that the angle :math:`\eta` spans.

    Parameters
    ----------
    individuals, steps, trials, dt, space
        As in :func:`~swarmssm.simulate.simulate_boids`; ``dt`` is the paper's time step of 1.
    speed
        Speed of all; 0.03 as in the paper.
    radius
        *r*; the paper's unit of length.
    box
        Side of the periodic box, ``None`` for open space. Distances are taken across the boundary.
        Recorded positions are **not** folded back into the box, so that tracks do not jump;
        ``position % box`` folds them.
    process_noise
        *eta*, in radians, from 0 (no noise) to 2 pi (headings wholly random).
    observation_noise, seed, burn_in, initial_position, initial_velocity
        As in :func:`~swarmssm.simulate.simulate_boids`. Of an initial velocity only the direction
        counts.

    Returns
    -------
    As :func:`~swarmssm.simulate.simulate_boids`. The one term of ``force`` is ``alignment``, the
    acceleration that takes the own to the mean heading in one step.

    Raises
    ------
    InputError
        Naming the parameter that is out of range.

    References
    ----------
    Vicsek, Czirok, Ben-Jacob, Cohen and Shochet (1995), Phys. Rev. Lett. 75:1226.
    """
    dynamics = Vicsek(
        dt=dt, space=space, speed=speed, radius=radius, box=box, process_noise=process_noise
    )
    return record(
        dynamics,
        individuals=individuals,
        steps=steps,
        trials=trials,
        observation_noise=observation_noise,
        seed=seed,
        burn_in=burn_in,
        initial_position=initial_position,
        initial_velocity=initial_velocity,
    )
