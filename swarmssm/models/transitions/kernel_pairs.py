"""What pairs do to each other by kernels of distance and angle, with derivatives in closed form."""

from typing import NamedTuple

import torch
from torch import Tensor

from swarmssm.models.transitions.force import PairDerivative
from swarmssm.models.transitions.perception import any_in_sight, sight
from swarmssm.models.transitions.radial_basis import RadialBasis

__all__ = ["Angular", "KernelPairs", "angular_factor"]


class Angular(NamedTuple):
    """A factor by angle, and its derivative by the cosine of the angle."""

    factor: Tensor
    slope: Tensor


def angular_factor(cosine: Tensor, weights: Tensor) -> Angular:
    r"""Return :math:`1 + \sum_l a_l \cos(l \varphi)` by the cosine of the angle.

    The cosines of multiples are Chebyshev polynomials of the cosine.

    Parameters
    ----------
    cosine
        ``(...)``.
    weights
        :math:`a_1, a_2, \dots`.
    """
    factor, slope = torch.ones_like(cosine), torch.zeros_like(cosine)
    # T_l and T_l' from T_{l+1} = 2 c T_l - T_{l-1}.
    before, here = torch.ones_like(cosine), cosine
    slope_before, slope_here = torch.zeros_like(cosine), torch.ones_like(cosine)
    for weight in weights.unbind(-1):
        factor = factor + weight * here
        slope = slope + weight * slope_here
        following = 2.0 * cosine * here - before
        slope_following = 2.0 * here + 2.0 * cosine * slope_here - slope_before
        before, here = here, following
        slope_before, slope_here = slope_here, slope_following
    return Angular(factor, slope)


class KernelPairs(NamedTuple):
    r"""Kernels, and how pairs are weighted.

    Attributes
    ----------
    basis
        Of the kernels.
    coefficients
        ``(3, size)``: of attraction, repulsion and alignment.
    modulation
        :math:`a_l` of :func:`angular_factor`; ``None``, none.
    weights
        Of pairs, which broadcast against ``(..., individual, individual)``; ``None``, 1.
    radius, width
        Of sight, see :mod:`swarmssm.models.transitions.perception`; the width ``None`` for a sharp
        cut-off, the radius ``None`` for none at all.
    mean
        Whether attraction and alignment are averaged over the neighbours, or summed. Repulsion is
        summed.
    """

    basis: RadialBasis
    coefficients: Tensor
    modulation: Tensor | None
    weights: Tensor | None
    radius: Tensor | None
    width: Tensor | None
    mean: bool

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
        adjacency = adjacency.to(states.dtype)
        # (..., i, j, state): from i to j.
        away = states.unsqueeze(-3) - states.unsqueeze(-2)
        offset, relative = away[..., :space], away[..., space:]
        squared = offset.square().sum(-1)
        apart = squared > 0
        # What stands at an individual's own place is finite, and of weight 0.
        distance = torch.where(apart, squared, 1.0).sqrt()
        toward = offset / distance.unsqueeze(-1)

        width = None if self.width is None else self.width.unsqueeze(-1)
        if self.radius is None:
            total = adjacency.sum(-1, keepdim=True)
            adjacency = share = torch.where(apart, adjacency, 0.0)
            some = (total > 0).to(states.dtype)
        else:
            adjacency = torch.where(apart, adjacency, 0.0)
            inside, hazard = sight(distance, self.radius.unsqueeze(-1), width)
            share = adjacency * inside
            total = share.sum(-1, keepdim=True)
            some = any_in_sight((adjacency * hazard).sum(-1, keepdim=True), width)
        total = torch.where(total > 0, total, 1.0)
        pull = some * share / total if self.mean else share

        kernel = self.basis(distance, self.coefficients)
        counted, pushed = pull, share
        if self.weights is not None:
            counted, pushed = counted * self.weights, pushed * self.weights
        attraction, repulsion, aligning = kernel.value.unbind(-1)
        by_distance = kernel.slope.unbind(-1)
        along = counted * attraction + pushed * repulsion
        across = counted * aligning
        along_slope = counted * by_distance[0] + pushed * by_distance[1]
        across_slope = counted * by_distance[2]

        eye = torch.eye(space, dtype=states.dtype, device=states.device)
        own = None
        factor = None
        if self.modulation is not None:
            velocities = states[..., space:].unsqueeze(-2)
            speed = velocities.square().sum(-1, keepdim=True)
            moving = speed > 0
            speed = torch.where(moving, speed, 1.0).sqrt()
            heading = torch.where(moving, velocities / speed, 0.0)
            cosine = (toward * heading).sum(-1)
            factor, factor_slope = angular_factor(cosine, self.modulation)
            plain = along.unsqueeze(-1) * toward + across.unsqueeze(-1) * relative
            turn = factor_slope.unsqueeze(-1) * plain
            # Derivatives of the cosine by the offset and by one's own velocity.
            by_offset = (heading - cosine.unsqueeze(-1) * toward) / distance.unsqueeze(-1)
            by_heading = torch.where(moving, (toward - cosine.unsqueeze(-1) * heading) / speed, 0.0)
            own = turn.mT @ by_heading
            own = torch.cat([torch.zeros_like(own), own], -1)
            along, across = factor * along, factor * across
            along_slope, across_slope = factor * along_slope, factor * across_slope
        force = (along.unsqueeze(-2) @ toward + across.unsqueeze(-2) @ relative).squeeze(-2)

        # All that goes with the direction to the neighbour: (..., i, j, space) x toward.
        radial = along / distance
        lever = (along_slope - radial).unsqueeze(-1) * toward
        lever = lever + across_slope.unsqueeze(-1) * relative
        if self.radius is not None and width is not None:
            weight = torch.ones_like(distance) if factor is None else factor
            if self.weights is not None:
                weight = weight * self.weights
            pulled, pushed, aligned = torch.split(weight.unsqueeze(-1) * kernel.value, 1, -1)
            shared = pulled * toward + aligned * relative
            change = pushed * toward
            # With distance the weight fades at this rate, the hazard at that without 1 - inside.
            fading = (-adjacency * inside / width).unsqueeze(-1)
            outside = (1.0 - inside).unsqueeze(-1)
            if self.mean:
                average = share.unsqueeze(-2) @ shared / total.unsqueeze(-1)
                change = change + (some / total).unsqueeze(-1) * (shared - average)
                lever = lever + fading * (1.0 - some).unsqueeze(-1) * average
            else:
                change = change + shared
            lever = lever + fading * outside * change
        # Layout (..., i, a, j, b).
        by_position = lever.mT.unsqueeze(-1) * toward.unsqueeze(-3)
        by_position = by_position + radial[..., None, :, None] * eye[:, None, :]
        if self.modulation is not None:
            by_position = by_position + turn.mT.unsqueeze(-1) * by_offset.unsqueeze(-3)
        by_velocity = across[..., None, :, None] * eye[:, None, :]
        pairs = torch.cat(torch.broadcast_tensors(by_position, by_velocity), -1)  # type: ignore[no-untyped-call]
        return PairDerivative(force, pairs, own)
