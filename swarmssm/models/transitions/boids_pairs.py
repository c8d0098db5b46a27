"""What pairs of boids do to each other, and its derivative, in closed form."""

from typing import NamedTuple

import torch
from torch import Tensor

from swarmssm.models.transitions.force import PairDerivative
from swarmssm.models.transitions.perception import any_in_sight, sight

__all__ = ["BoidsPairs"]


class BoidsPairs(NamedTuple):
    r"""Gains and forms of cohesion, separation and alignment.

    Attributes
    ----------
    cohesion, separation, alignment
        Gains, which broadcast against ``(..., individual)``.
    exponent, softening
        Of the separation, see :func:`swarmssm.forces.separation`.
    radius, width
        Of sight, see :mod:`swarmssm.models.transitions.perception`; the width ``None`` for a sharp
        cut-off, the radius ``None`` for none at all.
    relative
        Whether alignment is with the neighbours' mean velocity minus one's own, or with the mean.
    """

    cohesion: Tensor
    separation: Tensor
    alignment: Tensor
    exponent: Tensor
    softening: float
    radius: Tensor | None
    width: Tensor | None
    relative: bool

    def __call__(self, states: Tensor, adjacency: Tensor) -> PairDerivative:
        """Return force and derivatives at given states.

        Parameters
        ----------
        states
            ``(..., individual, state)``: positions and velocities.
        adjacency
            ``(..., individual, individual)``, without those who are absent.
        """
        space = states.shape[-1] // 2
        kc, ks, ka = (g[..., None] for g in (self.cohesion, self.separation, self.alignment))
        power = self.exponent[..., None] + 1.0
        adjacency = adjacency.to(states.dtype)
        positions, velocities = states[..., :space], states[..., space:]
        # (..., i, j, space): from i to j.
        offset = positions.unsqueeze(-3) - positions.unsqueeze(-2)
        squared = offset.square().sum(-1)
        apart = squared > 0
        squared = torch.where(apart, squared, 1.0)
        if self.radius is None:
            weight = adjacency
            total = weight.sum(-1, keepdim=True)
            some = (total > 0).to(states.dtype)
        else:
            width = None if self.width is None else self.width[..., None]
            distance = torch.where(apart, squared.sqrt(), 0.0)
            share, hazard = sight(distance, self.radius[..., None], width)
            weight = adjacency * share
            total = weight.sum(-1, keepdim=True)
            some = any_in_sight((adjacency * hazard).sum(-1, keepdim=True), width)
        total = torch.where(total > 0, total, 1.0)
        pull = some * weight / total

        softened = squared + self.softening**2 if self.softening else squared
        strength = softened ** (-0.5 * power)
        push = ks * strength * torch.where(apart, weight, 0.0)
        # Cohesion and separation are along the offset, with this factor.
        along = kc * pull - push
        mean = pull @ velocities
        force = (along.unsqueeze(-2) @ offset).squeeze(-2) + ka * (
            mean - some * velocities if self.relative else mean
        )

        eye = torch.eye(space, dtype=states.dtype, device=states.device)[:, None, :]
        # Layout (..., i, a, j, b).
        twist = (push * (power / softened))[..., None, :, None]
        by_position = along[..., None, :, None] * eye + (
            twist * offset.mT.unsqueeze(-1) * offset.unsqueeze(-3)
        )
        if self.radius is not None and self.width is not None:
            # Here weights change with distance too. Of the changes of the weighted mean, of the
            # probability of any neighbour, and of the push:
            change = weight / self.width[..., None] / torch.where(apart, distance, 1.0)
            change = torch.where(apart, -change, 0.0)
            fade = 1.0 - share
            away = states.unsqueeze(-3) - states.unsqueeze(-2)
            centre = (weight.unsqueeze(-2) @ away).squeeze(-2) / total
            lever = (some * fade / total).unsqueeze(-1) * (away - centre.unsqueeze(-2))
            alone = centre if self.relative else centre + _velocity_part(states)
            lever = lever + ((1.0 - some) * alone).unsqueeze(-2)
            lever = kc[..., None] * lever[..., :space] + ka[..., None] * lever[..., space:]
            lever = lever - (ks * fade * torch.where(apart, strength, 0.0)).unsqueeze(-1) * offset
            by_position = by_position + lever.mT.unsqueeze(-1) * (
                change.unsqueeze(-1) * offset
            ).unsqueeze(-3)
        by_velocity = (ka * pull)[..., None, :, None] * eye
        if by_position.shape != by_velocity.shape:
            by_position, by_velocity = torch.broadcast_tensors(by_position, by_velocity)  # type: ignore[no-untyped-call]
        own = None
        if not self.relative:
            own = (ka * some).unsqueeze(-1) * eye.squeeze(1)
            own = torch.cat([torch.zeros_like(own), own], -1)
        return PairDerivative(force, torch.cat([by_position, by_velocity], -1), own)


def _velocity_part(states: Tensor) -> Tensor:
    """Return the states with positions of 0."""
    space = states.shape[-1] // 2
    return torch.cat([torch.zeros_like(states[..., :space]), states[..., space:]], -1)
