"""Mirrored and turned copies of windows, for laws of motion that no axis of the arena breaks."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import torch

from swarmssm.models.batch import SwarmBatch

__all__ = ["Images", "reflected"]

#: The symmetries of a rectangle, of a square, and of a circle (box, cube, sphere).
Images = Literal["mirror", "square", "circle"]


def reflected(
    batch: SwarmBatch,
    centre: Sequence[float] | torch.Tensor,
    images: Images = "square",
    *,
    generator: torch.Generator | None = None,
) -> SwarmBatch:
    """Return each window as it would look in another position of the arena, at random.

    Who sees whom does not change.

    Parameters
    ----------
    batch
        Windows of positions, or of positions and velocities, and no controls.
    centre
        ``(space,)``: the fixed point.
    images
        ``"mirror"``: each axis is mirrored or not; ``"square"``: and the axes are put in any order;
        ``"circle"``: turned by any angle, and mirrored or not. All equally likely.
    generator
        Draws; torch's own, if absent.

    Raises
    ------
    ValueError
        If there are controls, of which nobody knows how they change, or the observations are
        neither positions nor states.
    """
    if batch.controls is not None:
        raise ValueError("windows with controls cannot be reflected")
    values = batch.observations
    middle = torch.as_tensor(centre, dtype=values.dtype, device=values.device)
    space, features = len(middle), values.shape[-1]
    if features not in (space, 2 * space):
        raise ValueError(
            f"observations must have {space} or {2 * space} features, and they have {features}"
        )
    turn = _matrices(len(batch), space, images, generator).to(values).unsqueeze(1)
    parts = [(values[..., :space] - middle) @ turn.mT + middle]
    if features > space:
        parts.append(values[..., space:] @ turn.mT)
    # What was not observed stays 0.
    observations = torch.cat(parts, dim=-1) * batch.mask.unsqueeze(-1)
    return replace(batch, observations=observations)


def _matrices(
    number: int, space: int, images: Images, generator: torch.Generator | None
) -> torch.Tensor:
    """Draw orthogonal matrices ``(number, space, space)``."""
    # Drawn where the generator lives, so that a seed means the same on every device.
    device = torch.device("cpu") if generator is None else generator.device
    if images == "circle":
        entries = torch.randn(number, space, space, generator=generator, device=device)
        rotation, upper = torch.linalg.qr(entries)
        # Uniform only if the signs that QR leaves open are settled (Mezzadri 2007).
        uniform: torch.Tensor = rotation * upper.diagonal(dim1=-2, dim2=-1).sign().unsqueeze(-2)
        return uniform
    size = (number, space)
    signs = 1.0 - 2.0 * torch.randint(2, size, generator=generator, device=device)
    if images == "square":
        order = torch.rand(size, generator=generator, device=device).argsort(-1)
    else:
        order = torch.arange(space, device=device).expand(size)
    return torch.nn.functional.one_hot(order, space) * signs.unsqueeze(-1)
