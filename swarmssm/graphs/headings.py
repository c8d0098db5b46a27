"""Where an animal looks, when only its motion is known."""

import math

import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.graphs.neighbors import check_positions

__all__ = ["headings_from_velocity"]


def headings_from_velocity(
    velocities: Tensor,
    *,
    rest_speed: float = 0.0,
    fallback: tuple[float, float] | tuple[float, float, float] | None = None,
) -> Tensor:
    """Return unit headings from velocities, the last one held while an individual rests.

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, NaN = unknown.
    rest_speed
        An individual that is not faster than this is at rest: its velocity says nothing of where
        it looks.
    fallback
        Heading before the first motion. If absent it is NaN.

    Returns
    -------
    Same shape. At rest and where the velocity is unknown it is the last heading before. Nothing is
    taken from later frames: a graph must not know the future.

    Raises
    ------
    InputError
        If the shape is not of that form, ``rest_speed`` is negative or ``fallback`` has no length.
    """
    check_positions(velocities, "velocities")
    if velocities.ndim < 3:
        raise InputError("velocities: the shape must be (..., time, individual, space).")
    if not 0.0 <= rest_speed < math.inf:
        raise InputError(f"rest_speed: it must be a number from 0 upwards, not {rest_speed}.")
    speed = torch.linalg.vector_norm(velocities, dim=-1)
    moving = speed > rest_speed
    length = velocities.shape[-3]
    clock = torch.arange(length, device=velocities.device)[:, None]
    last = torch.where(moving, clock, -1).cummax(-2).values
    source = last.clamp(min=0)[..., None].expand_as(velocities)
    headings = (velocities / speed[..., None]).gather(-3, source)
    unknown = (last < 0)[..., None]
    if fallback is None:
        return torch.where(unknown, math.nan, headings)
    vector = velocities.new_tensor(fallback)
    norm = float(torch.linalg.vector_norm(vector))
    if vector.shape != velocities.shape[-1:] or not 0.0 < norm < math.inf:
        raise InputError(
            f"fallback: it must be a direction with {velocities.shape[-1]} coordinates, not "
            f"{fallback}."
        )
    return torch.where(unknown, vector / norm, headings)
