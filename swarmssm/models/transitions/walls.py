"""The push of soft walls, averaged over how unsure a position is."""

from typing import NamedTuple

import torch
from torch import Tensor

__all__ = ["WallPush", "wall_push"]


class WallPush(NamedTuple):
    """Push of a wall and its derivative on each axis, ``(..., individual, space)``."""

    mean: Tensor
    slope: Tensor


def wall_push(offset: Tensor, half_width: Tensor, variance: Tensor | None) -> WallPush:
    """Return the push of :func:`swarmssm.forces.wall`, or its expectation, and the derivative.

    Parameters
    ----------
    offset
        Positions from the middle of the box, ``(..., individual, space)``.
    half_width
        Broadcasts against it.
    variance
        Of the positions, ``(..., individual, space)``. ``None``: they are known.
    """
    over, under = offset - half_width, -offset - half_width
    if variance is None:
        slope = -((over > 0) | (under > 0)).to(offset.dtype)
        return WallPush(under.clamp(min=0.0) - over.clamp(min=0.0), slope)
    # Of a normal x with deviation s: E max(x, 0) = x Phi(x / s) + s phi(x / s).
    deviation = (variance + (1e-6 * half_width).square()).sqrt()
    over, under = over / deviation, under / deviation
    right, left = torch.special.ndtr(over), torch.special.ndtr(under)
    density = torch.exp(-0.5 * under**2) - torch.exp(-0.5 * over**2)
    push = under * left - over * right + density * 0.3989422804014327
    return WallPush(deviation * push, -(left + right))
