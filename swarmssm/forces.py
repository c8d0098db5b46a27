r"""The terms of the boids model, on tensors: what an individual's neighbours do to it.

Equation numbers are those of the thesis. With the neighbours
:math:`\mathcal{N}_i = \{j : A_{ij} = 1\}` of individual *i*,

.. math::
    C_i = \frac{1}{|\mathcal{N}_i|} \sum_{j \in \mathcal{N}_i} p_j - p_i \quad (3.16) \qquad
    S_i = \sum_{j \in \mathcal{N}_i} \frac{p_i - p_j}{\lVert p_j - p_i \rVert^{n+1}} \quad (3.17)
    \qquad A_i = \frac{1}{|\mathcal{N}_i|} \sum_{j \in \mathcal{N}_i} v_j \quad (3.18)

Shapes: positions and velocities ``(..., individual, space)`` with 2 or 3 coordinates, adjacency
``(..., individual, individual)`` of any dtype; the leading dimensions broadcast. Adjacency may hold
weights, for instance edge probabilities; a mean is then the weighted mean, and gradients flow
into the weights.

Nobody is moved by what is not there: an individual without neighbours gets 0 from the three terms,
although the means of (3.16) and (3.18) are not defined for it. A NaN row is an absent individual:
it is left out of everybody's sums, and where its own value is needed it gets 0, so that no NaN
enters a result or a gradient.
"""

import torch
from torch import Tensor

__all__ = ["alignment", "cohesion", "separation", "speed_regulation", "wall"]


def cohesion(positions: Tensor, adjacency: Tensor) -> Tensor:
    """From each individual to the mean position of its neighbours (3.16).

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.
    adjacency
        Shape ``(..., individual, individual)``, ``[i, j]`` nonzero when i sees j.

    Returns
    -------
    Shape ``(..., individual, space)``, in the unit of ``positions``.
    """
    return _mean_difference(positions, adjacency)


def separation(
    positions: Tensor,
    adjacency: Tensor,
    exponent: float | Tensor = 1.0,
    softening: float = 0.0,
) -> Tensor:
    r"""Away from each neighbour, the more strongly the nearer it is (3.17).

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.
    adjacency
        Shape ``(..., individual, individual)``.
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
    known = _known(positions)
    filled = torch.where(known, positions, 0.0)
    # One (individual, individual) array a coordinate: sums over a last axis of 2 are slow.
    offsets = [c[..., :, None] - c[..., None, :] for c in filled.unbind(-1)]
    squared = torch.stack([offset.square() for offset in offsets]).sum(0)
    apart = (squared > 0) & known & known.mT
    # The inner `where` keeps the gradient of the power finite where the outer one discards it.
    squared = torch.where(apart, squared, 1.0) + softening**2
    power = exponent[..., None] if isinstance(exponent, Tensor) else exponent
    strength = squared ** (-0.5 * (power + 1.0))
    weights = torch.where(apart, strength, 0.0) * adjacency.to(positions.dtype)
    return torch.stack([(weights * offset).sum(-1) for offset in offsets], -1)


def alignment(velocities: Tensor, adjacency: Tensor, *, relative: bool = False) -> Tensor:
    """Mean velocity of the neighbours (3.18), or how it differs from one's own.

    Parameters
    ----------
    velocities
        Shape ``(..., individual, space)``.
    adjacency
        Shape ``(..., individual, individual)``.
    relative
        False: ``mean_j v_j``, as (3.18), which a velocity rule needs. True: ``mean_j v_j - v_i``,
        which an acceleration rule needs.

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


def _neighbor_mean(values: Tensor, adjacency: Tensor) -> tuple[Tensor, Tensor]:
    """Return the (weighted) mean over known neighbours, and who has any, ``(..., individual, 1)``.

    The mean is 0 for an individual without neighbours.
    """
    known = _known(values)
    weights = adjacency.to(values.dtype) * known.mT.to(values.dtype)
    total = weights.sum(-1, keepdim=True)
    has_neighbor = total > 0
    summed = weights @ torch.where(known, values, 0.0)
    return summed / torch.where(has_neighbor, total, 1.0), has_neighbor


def _mean_difference(values: Tensor, adjacency: Tensor) -> Tensor:
    """Return the neighbours' mean minus one's own value, 0 for who is alone or absent."""
    mean, has_neighbor = _neighbor_mean(values, adjacency)
    known = _known(values)
    own = torch.where(known, values, 0.0)
    return torch.where(has_neighbor & known, mean - own, 0.0)
