"""The Couzin model: zones of repulsion, orientation and attraction."""

import dataclasses
import itertools
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy.typing as npt
import torch
import xarray as xr
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.graphs.neighbors import pairs
from swarmssm.simulate.directions import disturb_normal, random_directions, turn_towards, unit
from swarmssm.simulate.recording import (
    check_number,
    check_space,
    directions_given,
    record,
)

__all__ = ["Couzin", "simulate_couzin"]


@dataclasses.dataclass(frozen=True)
class Couzin:
    """The dynamics of :func:`simulate_couzin`, which documents the parameters."""

    dt: float
    space: int
    speed: float
    repulsion_radius: float
    orientation_radius: float
    attraction_radius: float
    blind_angle: float
    turning_rate: float
    process_noise: float

    name: ClassVar[str] = "couzin"
    remedy: ClassVar[str] = "Try a smaller dt or speed."
    terms: ClassVar[tuple[str, ...]] = ("repulsion", "orientation", "attraction")
    graph_rule: ClassVar[None] = None
    force_meaning: ClassVar[str] = "contribution to the desired direction, before it is normalised"

    def __post_init__(self) -> None:
        check_space(self.space)
        for name in ("dt", "speed", "turning_rate"):
            check_number(name, getattr(self, name), above_zero=True)
        radii = ("repulsion_radius", "orientation_radius", "attraction_radius")
        for name in (*radii, "process_noise", "blind_angle"):
            check_number(name, getattr(self, name))
        if self.blind_angle >= 360.0:
            raise InputError(
                f"blind_angle: it must be below 360 degrees, not {self.blind_angle:g}."
            )
        for inner, outer in itertools.pairwise(radii):
            if getattr(self, inner) > getattr(self, outer):
                raise InputError(
                    f"{outer}: it is {getattr(self, outer):g} and must not be below {inner}, "
                    f"which is {getattr(self, inner):g}."
                )

    def start(
        self, trials: int, individuals: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Draw positions in a disc or ball in which everyone has others around, and headings."""
        shape = (trials, individuals, self.space)
        reach = self.repulsion_radius * individuals ** (1 / self.space)
        reach = reach or 0.5 * self.attraction_radius or 1.0
        share = torch.rand((*shape[:-1], 1), dtype=torch.float64, generator=generator)
        around = random_directions(shape, generator)
        positions = reach * share ** (1 / self.space) * around
        return positions, self.speed * random_directions(shape, generator)

    def begin(self, velocities: Tensor) -> Tensor:
        """Bring the velocities to the speed of all."""
        return self.speed * directions_given(velocities)

    def forces(self, positions: Tensor, velocities: Tensor) -> tuple[Tensor, Tensor]:
        """Return the three terms ``(..., term, individual, space)`` and who acted on whom."""
        heading = velocities / self.speed
        offset = positions[..., None, :, :] - positions[..., :, None, :]
        distance = torch.linalg.vector_norm(offset, dim=-1)
        towards = unit(offset, torch.zeros_like(offset))
        others = pairs(positions.isfinite().all(-1))

        ahead = (towards * heading[..., :, None, :]).sum(-1)
        visible = others & (ahead >= -math.cos(math.radians(0.5 * self.blind_angle)))
        repelling = others & (distance < self.repulsion_radius)
        alone = ~repelling.any(-1, keepdim=True)
        beyond = visible & alone & (distance >= self.repulsion_radius)
        orienting = beyond & (distance < self.orientation_radius)
        attracting = beyond & (distance >= self.orientation_radius)
        attracting = attracting & (distance <= self.attraction_radius)
        both = orienting.any(-1, keepdim=True) & attracting.any(-1, keepdim=True)
        weight = torch.where(both, 0.5, 1.0).to(heading.dtype)

        away = -(repelling[..., None] * towards).sum(-2)
        along = weight * (orienting.to(heading.dtype) @ heading)
        near = weight * (attracting[..., None] * towards).sum(-2)
        return torch.stack([away, along, near], -3), repelling | orienting | attracting

    def move(
        self,
        positions: Tensor,
        velocities: Tensor,
        force: Tensor,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return the next positions and velocities; without a generator those free of noise."""
        heading = velocities / self.speed
        desired = unit(force.sum(-3), heading)
        if generator is not None:
            desired = disturb_normal(desired, self.process_noise, generator)
        turned = turn_towards(heading, desired, math.radians(self.turning_rate) * self.dt)
        # Rounding would let the length drift over many steps.
        moved = self.speed * unit(turned, heading)
        return positions + self.dt * moved, moved

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters, for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Couzin":
        """Return the dynamics that :meth:`to_dict` described."""
        return cls(**values)


def simulate_couzin(
    individuals: int = 100,
    steps: int = 1000,
    trials: int = 1,
    *,
    dt: float = 0.1,
    space: int = 2,
    speed: float = 3.0,
    repulsion_radius: float = 1.0,
    orientation_radius: float = 5.0,
    attraction_radius: float = 15.0,
    blind_angle: float = 90.0,
    turning_rate: float = 40.0,
    process_noise: float = 0.05,
    observation_noise: float = 0.0,
    seed: int | torch.Generator = 0,
    burn_in: int = 0,
    initial_position: npt.ArrayLike | None = None,
    initial_velocity: npt.ArrayLike | None = None,
) -> xr.Dataset:
    r"""Simulate the zone model of Couzin and others, with the truth behind every step.

    With the unit vector :math:`\hat r_{ij}` from i to j, each individual wants to go along

    * :math:`-\sum_j \hat r_{ij}` if anyone is in its zone of repulsion, nearer than
      ``repulsion_radius``, whoever else there may be; and else along
    * :math:`\sum_j \hat v_j` of those in the zone of orientation, up to ``orientation_radius``,
    * :math:`\sum_j \hat r_{ij}` of those in the zone of attraction, up to ``attraction_radius``,
    * half the sum of the two, if there is someone in both;
    * its own heading, if there is nobody or the sum vanishes.

    Who lies in the blind volume behind is noticed in the zone of repulsion alone. The desired
    direction is disturbed by a Gaussian wrapped on the sphere; the individual turns towards it by
    at most ``turning_rate * dt`` and moves on, all at once: :math:`p' = p + dt\, v'`.

    Parameters
    ----------
    individuals, steps, trials, dt, space
        As in :func:`~swarmssm.simulate.simulate_boids`. The paper is in three dimensions; the
        defaults are the plane and a mill (torus).
    speed
        Speed of all, in units per second.
    repulsion_radius, orientation_radius, attraction_radius
        Outer radii of the three zones, measured from the individual. The paper gives the widths of
        the outer two, here ``orientation_radius - repulsion_radius`` and ``attraction_radius -
        orientation_radius``.
    blind_angle
        Whole angle of the blind cone behind, in **degrees**: 360 minus the paper's field of
        perception.
    turning_rate
        In **degrees** per second.
    process_noise
        Standard deviation of the disturbance of the desired direction, in **radians**.
    observation_noise, seed, burn_in, initial_position, initial_velocity
        As in :func:`~swarmssm.simulate.simulate_boids`. Of an initial velocity only the direction
        counts.

    Returns
    -------
    As :func:`~swarmssm.simulate.simulate_boids`. The terms of ``force`` are ``repulsion``,
    ``orientation`` and ``attraction``, the summands of the desired direction as above. In
    ``adjacency`` i sees j when j is in a zone of i that acts: of one who is repelled, those that
    repel it. The graph belongs to no named rule.

    Raises
    ------
    InputError
        Naming the parameter that is out of range.

    References
    ----------
    Couzin, Krause, James, Ruxton and Franks (2002), J. Theor. Biol. 218:1.
    """
    dynamics = Couzin(
        dt=dt,
        space=space,
        speed=speed,
        repulsion_radius=repulsion_radius,
        orientation_radius=orientation_radius,
        attraction_radius=attraction_radius,
        blind_angle=blind_angle,
        turning_rate=turning_rate,
        process_noise=process_noise,
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
