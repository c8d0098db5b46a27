"""Mirrored and turned copies of windows, for laws of motion that no axis of the arena breaks."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from swarmssm.models.batch import SwarmBatch

__all__ = ["reflected"]


def reflected(
    batch: SwarmBatch,
    centre: Sequence[float] | torch.Tensor,
    *,
    swap_axes: bool = True,
    generator: torch.Generator | None = None,
) -> SwarmBatch:
    """Return each window mirrored about the centre, and its axes exchanged, at random.

    Each axis of each window is mirrored or not, and the axes are put in any order, all equally
    likely: the symmetries of a square arena. Who sees whom does not change.

    Parameters
    ----------
    batch
        Windows of positions, or of positions and velocities, and no controls.
    centre
        ``(space,)``: the fixed point.
    swap_axes
        Whether axes are exchanged too; else mirrored alone, the symmetries of a rectangle.
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
    size = (len(batch), space)
    # Drawn where the generator lives, so that a seed means the same on every device.
    device = torch.device("cpu") if generator is None else generator.device
    signs = 1.0 - 2.0 * torch.randint(2, size, generator=generator, device=device)
    if swap_axes:
        order = torch.rand(size, generator=generator, device=device).argsort(-1)
    else:
        order = torch.arange(space, device=device).expand(size)
    # Of each window the matrix that takes axes to axes.
    turn = torch.nn.functional.one_hot(order, space) * signs.unsqueeze(-1)
    turn = turn.to(values).unsqueeze(1)
    parts = [(values[..., :space] - middle) @ turn.mT + middle]
    if features > space:
        parts.append(values[..., space:] @ turn.mT)
    # What was not observed stays 0.
    observations = torch.cat(parts, dim=-1) * batch.mask.unsqueeze(-1)
    return replace(batch, observations=observations)
