r"""The terms of the boids model, on tensors: what an individual's neighbours do to it.

Equation numbers are those of the thesis. With the neighbours
:math:`\mathcal{N}_i = \{j : A_{ij} = 1\}` of individual *i*,

.. math::
    C_i = \frac{1}{|\mathcal{N}_i|} \sum_{j \in \mathcal{N}_i} p_j - p_i \quad (3.16) \qquad
    S_i = \sum_{j \in \mathcal{N}_i} \frac{p_i - p_j}{\lVert p_j - p_i \rVert^{n+1}} \quad (3.17)
    \qquad A_i = \frac{1}{|\mathcal{N}_i|} \sum_{j \in \mathcal{N}_i} v_j \quad (3.18)

Shapes: positions and velocities ``(..., individual, space)`` with 2 or 3 coordinates, adjacency
``(..., individual, individual)`` of any dtype, or an :class:`~swarmssm.graphs.EdgeList`; the
leading dimensions broadcast. The graph may have weights, for instance edge probabilities; a mean is
then the weighted mean, and gradients flow into the weights.

Nobody is moved by what is not there: an individual without neighbours gets 0 from the three terms,
although the means of (3.16) and (3.18) are not defined for it. A NaN row is an absent individual:
it is left out of everybody's sums, and where its own value is needed it gets 0, so that no NaN
enters a result or a gradient.
"""

import torch
from torch import Tensor

from swarmssm.graphs import EdgeList, Graph, neighbor_sum, pair_sum

__all__ = ["alignment", "cohesion", "separation", "speed_regulation", "wall"]


def cohesion(positions: Tensor, adjacency: Graph) -> Tensor:
    """From each individual to the mean position of its neighbours (3.16).

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.
    adjacency
        Shape ``(..., individual, individual)``, ``[i, j]`` nonzero when i sees j, or edges.

    Returns
    -------
    Shape ``(..., individual, space)``, in the unit of ``positions``.
    """
    return _mean_difference(positions, adjacency)


def separation(
    positions: Tensor,
    adjacency: Graph,
    exponent: float | Tensor = 1.0,
    softening: float = 0.0,
) -> Tensor:
    r"""Away from each neighbour, the more strongly the nearer it is (3.17).

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.
    adjacency
        Shape ``(..., individual, individual)``, or edges.
    exponent
        *n* of (3.17): a neighbour at distance d pushes with strength ``d ** -n``. A number, or a
        tensor that broadcasts against ``(..., individual)``, one for each pushed individual.
    softening
        Length s that bounds the push at short distance: d becomes ``sqrt(d ** 2 + s ** 2)`` in the
        denominator. 0 gives (3.17) itself.

    Returns
    -------
    Shape ``(..., individual, space)``. Two individuals at the very same place do not push each
    other, since there is no direction to push in; value and gradient are 0 there.
    """
    if isinstance(adjacency, EdgeList):
        return _edge_separation(positions, adjacency, exponent, softening)
    known = _known(positions)
    filled = torch.where(known, positions, 0.0)
    # One (individual, individual) array a coordinate: sums over a last axis of 2 are slow.
    offsets = [c[..., :, None] - c[..., None, :] for c in filled.unbind(-1)]
    squared = torch.stack([offset.square() for offset in offsets]).sum(0)
    power = exponent[..., None] if isinstance(exponent, Tensor) else exponent
    strength = _push(squared, known & known.mT, power, softening) * adjacency.to(positions.dtype)
    return torch.stack([(strength * offset).sum(-1) for offset in offsets], -1)


def _edge_separation(
    positions: Tensor, edges: EdgeList, exponent: float | Tensor, softening: float
) -> Tensor:
    """Return :func:`separation` over a list of edges."""
    space = positions.shape[-1]
    known = _known(positions)
    columns = [torch.where(known, positions, 0.0), known.to(positions.dtype)]
    if isinstance(exponent, Tensor):
        # The exponent goes to the edges of an individual as a feature of it.
        exponent = exponent.to(positions.dtype).unsqueeze(-1)
        shape: torch.Size = torch.broadcast_shapes(  # type: ignore[no-untyped-call]
            exponent.shape, (*positions.shape[:-1], 1)
        )
        columns = [column.expand(*shape[:-1], -1) for column in (*columns, exponent)]

    def push(pushed: Tensor, neighbor: Tensor) -> Tensor:
        offset = pushed[..., :space] - neighbor[..., :space]
        squared = torch.stack([part.square() for part in offset.unbind(-1)]).sum(0).unsqueeze(-1)
        both = (pushed[..., space] * neighbor[..., space] > 0).unsqueeze(-1)
        power = pushed[..., space + 1 :] if isinstance(exponent, Tensor) else exponent
        return _push(squared, both, power, softening) * offset

    return pair_sum(torch.cat(columns, -1), edges, push)


def _push(squared: Tensor, both: Tensor, power: float | Tensor, softening: float) -> Tensor:
    """Return the strength of (3.17) by squared distance, 0 where not both are known or apart."""
    apart = (squared > 0) & both
    # The inner `where` keeps the gradient of the power finite where the outer one discards it.
    softened = torch.where(apart, squared, 1.0) + softening**2
    return torch.where(apart, softened ** (-0.5 * (power + 1.0)), 0.0)


def alignment(velocities: Tensor, adjacency: Graph, *, relative: bool = True) -> Tensor:
    """Mean velocity of the neighbours minus one's own, or that mean itself (3.18).

    Parameters
    ----------
    velocities
        Shape ``(..., individual, space)``.
    adjacency
        Shape ``(..., individual, individual)``, or edges.
    relative
        True: ``mean_j v_j - v_i``, which an acceleration rule needs. False: ``mean_j v_j``, as
        (3.18), which a velocity rule needs.

    Returns
    -------
    Shape ``(..., individual, space)``, in the unit of ``velocities``.
    """
    if relative:
        return _mean_difference(velocities, adjacency)
    return _neighbor_mean(velocities, adjacency)[0]


def wall(positions: Tensor, half_width: float | Tensor, center: float | Tensor = 0.0) -> Tensor:
    """Push of a soft rectangular wall: 0 inside, growing linearly with the distance outside.

    ``-sign(q) * max(|q| - half_width, 0)`` on each axis, with ``q = position - center``.

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.
    half_width
        Half the side of the box: a number, or one for each axis, shape ``(space,)``.
    center
        Middle of the box, likewise.

    Returns
    -------
    Shape ``(..., individual, space)``, in the unit of ``positions``.
    """
    offset = torch.where(_known(positions), positions - center, 0.0)
    return -offset.sign() * (offset.abs() - half_width).clamp(min=0.0)


def speed_regulation(velocities: Tensor, preferred_speed: float | Tensor) -> Tensor:
    r"""Along one's own velocity, towards a preferred speed: :math:`(v_0 - |v|)\, v / |v|`.

    Parameters
    ----------
    velocities
        Shape ``(..., individual, space)``.
    preferred_speed
        *v0*: a number, or a tensor that broadcasts against ``(..., individual)``.

    Returns
    -------
    Shape ``(..., individual, space)``, in the unit of ``velocities``. An individual at rest has no
    direction and gets 0, with gradient 0.
    """
    velocities = torch.where(_known(velocities), velocities, 0.0)
    squared = velocities.square().sum(-1)
    moving = squared > 0
    speed = torch.where(moving, squared, 1.0).sqrt()
    factor = torch.where(moving, (preferred_speed - speed) / speed, 0.0)
    return factor[..., None] * velocities


def _known(values: Tensor) -> Tensor:
    """Return which individuals have all coordinates, ``(..., individual, 1)``."""
    return values.isfinite().all(-1, keepdim=True)


def _neighbor_mean(values: Tensor, adjacency: Graph) -> tuple[Tensor, Tensor]:
    """Return the (weighted) mean over known neighbours, and who has any, ``(..., individual, 1)``.

    The mean is 0 for an individual without neighbours.
    """
    known = _known(values)
    columns = torch.cat([torch.where(known, values, 0.0), known.to(values.dtype)], -1)
    # The last column counts.
    summed = neighbor_sum(columns, adjacency)
    total = summed[..., -1:]
    has_neighbor = total > 0
    return summed[..., :-1] / torch.where(has_neighbor, total, 1.0), has_neighbor


def _mean_difference(values: Tensor, adjacency: Graph) -> Tensor:
    """Return the neighbours' mean minus one's own value, 0 for who is alone or absent."""
    mean, has_neighbor = _neighbor_mean(values, adjacency)
    known = _known(values)
    own = torch.where(known, values, 0.0)
    return torch.where(has_neighbor & known, mean - own, 0.0)
