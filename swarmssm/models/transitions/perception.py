r"""How far an individual sees: the graph narrowed to those within a radius, sharply or smoothly.

A radius that is to be inferred needs a density that is smooth in it. Edge :math:`i \leftarrow j`
of the candidate graph, at the distance :math:`d_{ij}`, then has the weight

.. math::
    w_{ij} = A_{ij}\, \mathrm{sigmoid}\bigl((r_i - d_{ij}) / \omega\bigr)

Means over neighbours are weighted means, times the probability that there is any neighbour,
:math:`h_i = 1 - \prod_j (1 - w_{ij})`, so that the pull of a single neighbour fades out
where it leaves the field of view instead of staying at full strength. With a width :math:`\omega`
of 0 the cut-off is sharp and :math:`h_i` is 0 or 1.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import softplus

from swarmssm.graphs import EdgeList, Graph, pair_sum

__all__ = ["Perceived", "perceive", "sight", "without_absent"]


class Perceived(NamedTuple):
    """What the neighbours within the radius add up to, each ``(..., individual, space)``.

    Attributes
    ----------
    cohesion
        To their mean position.
    separation
        Away from each.
    mean_velocity
        Their mean velocity, 0 without any.
    alignment
        Their mean velocity minus one's own, 0 without any.
    """

    cohesion: Tensor
    separation: Tensor
    mean_velocity: Tensor
    alignment: Tensor


def sight(distance: Tensor, radius: Tensor, width: Tensor | None) -> tuple[Tensor, Tensor]:
    r"""Return the weight of an edge by its length, and :math:`-\log(1 - w)`.

    Parameters
    ----------
    distance, radius
        Broadcast against each other.
    width
        :math:`\omega`; ``None``: a sharp cut-off, where the second is 1 within the radius.
    """
    if width is None:
        within = (distance <= radius).to(distance.dtype)
        return within, within
    depth = (radius - distance) / width
    return torch.sigmoid(depth), softplus(depth)


def any_in_sight(hazard: Tensor, width: Tensor | None) -> Tensor:
    """Return the probability of any neighbour from the sum over :func:`sight`'s second answer."""
    return (hazard > 0).to(hazard.dtype) if width is None else -torch.expm1(-hazard)


def perceive(
    positions: Tensor,
    velocities: Tensor,
    graph: Graph,
    radius: Tensor,
    width: Tensor | None,
    exponent: Tensor,
    softening: float = 0.0,
) -> Perceived:
    """Sum over the neighbours within a radius.

    Parameters
    ----------
    positions, velocities
        ``(..., individual, space)``.
    graph
        Candidates, a matrix or a list of edges.
    radius, exponent
        Broadcast against ``(..., individual)``.
    width
        Of the cut-off, likewise; ``None`` for a sharp one.
    softening
        As in :func:`swarmssm.forces.separation`.
    """
    space = positions.shape[-1]
    own = [radius, exponent, *([] if width is None else [width])]
    shape: torch.Size = torch.broadcast_shapes(  # type: ignore[no-untyped-call]
        positions.shape[:-1], *(value.shape for value in own)
    )
    columns = [
        positions.expand(*shape, space),
        velocities.expand(*shape, space),
        *(value.expand(shape).unsqueeze(-1) for value in own),
    ]

    def message(mine: Tensor, theirs: Tensor) -> Tensor:
        away = theirs[..., : 2 * space] - mine[..., : 2 * space]
        offset = away[..., :space]
        squared = offset.square().sum(-1, keepdim=True)
        apart = squared > 0
        # The inner `where` keeps the gradients finite where the outer one discards them.
        squared = torch.where(apart, squared, 1.0)
        distance = torch.where(apart, squared.sqrt(), 0.0)
        reach, power = mine[..., 2 * space, None], mine[..., 2 * space + 1, None]
        weight, hazard = sight(
            distance, reach, None if width is None else mine[..., 2 * space + 2, None]
        )
        push = torch.where(apart, (squared + softening**2) ** (-0.5 * (power + 1.0)), 0.0)
        away, push = weight * away, -weight * push * offset
        parts = [weight.expand_as(squared), hazard.expand_as(squared), away, push]
        return torch.cat(parts, -1)

    summed = pair_sum(torch.cat(columns, -1), graph, message)
    total, hazard = summed[..., :1], summed[..., 1:2]
    some = any_in_sight(hazard, width)
    has_neighbor = total > 0
    mean = torch.where(has_neighbor, summed[..., 2 : 2 + 2 * space], 0.0)
    mean = some * mean / torch.where(has_neighbor, total, 1.0)
    alignment = mean[..., space:]
    return Perceived(
        cohesion=mean[..., :space],
        separation=summed[..., 2 + 2 * space :],
        mean_velocity=alignment + torch.where(has_neighbor, some, 0.0) * velocities,
        alignment=alignment,
    )


def without_absent(graph: Graph, present: Tensor | None) -> Graph:
    """Return the graph without the edges to and from those who are not there.

    Parameters
    ----------
    graph
        A matrix or a list of edges.
    present
        ``(..., individual)`` of bool; ``None`` if all are there.
    """
    if present is None:
        return graph
    if isinstance(graph, EdgeList):
        return graph.between(present.expand(*graph.leading, graph.individuals))
    return graph * (present.unsqueeze(-1) & present.unsqueeze(-2)).to(graph.dtype)
