"""Unit vectors of the plane and of space: draw, disturb and turn them.

All tensors are ``(..., space)`` with 2 or 3 coordinates; directions have length one.
"""

import math

import torch
from torch import Tensor

__all__ = ["disturb_normal", "disturb_uniform", "random_directions", "turn_towards", "unit"]

#: A sum of unit vectors that is shorter than this has cancelled out, but for rounding.
CANCELLED = 1e-12


def unit(vectors: Tensor, fallback: Tensor) -> Tensor:
    """Scale vectors to length one; take ``fallback`` where a vector has no direction."""
    norm: Tensor = torch.linalg.vector_norm(vectors, dim=-1, keepdim=True)
    return torch.where(norm > CANCELLED, vectors / norm.clamp(min=CANCELLED), fallback)


def random_directions(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Draw directions uniformly from the circle or the sphere, float64."""
    drawn = torch.randn(shape, dtype=torch.float64, generator=generator)
    norm: Tensor = torch.linalg.vector_norm(drawn, dim=-1, keepdim=True)
    return drawn / norm


def disturb_uniform(directions: Tensor, width: float, generator: torch.Generator) -> Tensor:
    """Draw uniformly from the arc, or the spherical cap, of the given width around each direction.

    In the plane this turns by an angle uniform in ``[-width / 2, width / 2]``. A width of ``2 pi``
    is the whole circle or sphere.
    """
    shape = (*directions.shape[:-1], 1)
    share = torch.rand(shape, dtype=directions.dtype, generator=generator)
    if directions.shape[-1] == 2:
        angle = width * (share - 0.5)
        aside = torch.stack([-directions[..., 1], directions[..., 0]], -1)
    else:
        # By area: the cosine is uniform.
        angle = torch.acos(1.0 - share * (1.0 - math.cos(0.5 * width)))
        aside = unit(_tangent(directions, generator), torch.zeros_like(directions))
    return unit(angle.cos() * directions + angle.sin() * aside, directions)


def disturb_normal(directions: Tensor, sd: float, generator: torch.Generator) -> Tensor:
    """Draw from a Gaussian of the given standard deviation, in radians, wrapped on the sphere.

    The Gaussian lives in the tangent line or plane of each direction. In the plane this turns by an
    angle of standard deviation ``sd``.
    """
    tangent = sd * _tangent(directions, generator)
    angle: Tensor = torch.linalg.vector_norm(tangent, dim=-1, keepdim=True)
    return angle.cos() * directions + torch.sinc(angle / math.pi) * tangent


def turn_towards(directions: Tensor, targets: Tensor, most: float) -> Tensor:
    """Turn each direction towards its target, by at most the angle ``most`` in radians.

    A target straight behind can be reached on any side; the side is then that of a coordinate axis.
    """
    # Exact at small angles, where the arc cosine of the inner product is not.
    angle = 2.0 * torch.atan2(
        torch.linalg.vector_norm(targets - directions, dim=-1, keepdim=True),
        torch.linalg.vector_norm(targets + directions, dim=-1, keepdim=True),
    )
    least = torch.nn.functional.one_hot(directions.abs().argmin(-1), directions.shape[-1])
    aside = _reject(targets, directions)
    aside = unit(aside, unit(_reject(least.to(directions.dtype), directions), directions))
    turned = math.cos(most) * directions + math.sin(most) * aside
    return torch.where(angle <= most, targets, turned)


def _tangent(directions: Tensor, generator: torch.Generator) -> Tensor:
    """Draw from the standard Gaussian of the tangent line or plane of each direction."""
    drawn = torch.randn(directions.shape, dtype=directions.dtype, generator=generator)
    return _reject(drawn, directions)


def _reject(vectors: Tensor, directions: Tensor) -> Tensor:
    """Take away from vectors their part along the directions."""
    return vectors - (vectors * directions).sum(-1, keepdim=True) * directions
