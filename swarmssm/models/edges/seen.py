"""What an encoder of edges is told of a window: states as they were seen, gaps carried over."""

from typing import NamedTuple

import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.relational import pairs_of

__all__ = ["Seen", "seen_states"]


class Seen(NamedTuple):
    """States of a window, without holes.

    Attributes
    ----------
    states
        ``(batch, time, individual, state)``: positions and velocities.
    present
        ``(batch, time, individual)`` of bool.
    """

    states: Tensor
    present: Tensor

    @property
    def pairs(self) -> Tensor:
        """Ordered pairs that are there, ``(batch, time, individual, neighbor)`` of bool."""
        return pairs_of(self.present)


def seen_states(batch: SwarmBatch, space: int, dt: float) -> Seen:
    """Return the states of a window as far as they were seen by then.

    Who is out of sight keeps the last state it was seen in; who was not seen yet has that of the
    first sight. Where positions alone are observed, velocities are differences to the last sight,
    and 0 at the first: no frame says anything of later ones.

    Parameters
    ----------
    batch
        Windows.
    space
        Number of spatial dimensions.
    dt
        Seconds from frame to frame.

    Raises
    ------
    InputError
        If positions are not observed.
    """
    observed, mask = batch.observations, batch.mask
    features = observed.shape[-1]
    if features not in (space, 2 * space):
        raise InputError(
            f"edges: relational edges are told by positions, or positions and velocities, in "
            f"{space} dimensions, and the observations have {features} features."
        )
    times = mask.shape[1]
    frames = torch.arange(times, device=mask.device).view(1, -1, 1)
    last = torch.where(mask, frames, -1).cummax(1).values
    first = mask.long().argmax(1, keepdim=True)
    index = torch.where(last < 0, first, last)

    def carried(values: Tensor) -> Tensor:
        wide = index.unsqueeze(-1).expand(*index.shape, values.shape[-1])
        return values.gather(1, wide)

    if features == 2 * space:
        return Seen(carried(observed), batch.present)
    positions = carried(observed)
    before = torch.cat([index[:, :1], index[:, :-1]], 1)
    earlier = torch.cat([positions[:, :1], positions[:, :-1]], 1)
    elapsed = (frames - before).clamp(min=1).unsqueeze(-1) * dt
    known = mask & (torch.cat([last[:, :1] * 0 - 1, last[:, :-1]], 1) >= 0)
    velocities = torch.where(known.unsqueeze(-1), (positions - earlier) / elapsed, 0.0)
    return Seen(torch.cat([positions, carried(velocities)], -1), batch.present)
