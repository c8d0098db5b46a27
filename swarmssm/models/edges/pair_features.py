"""What can be told of an ordered pair that looks the same turned, mirrored or moved."""

import math

import torch
from torch import Tensor, nn

from swarmssm.models.scales import Scales

__all__ = ["PairFeatures"]

#: Features stay within this.
BOUND = 10.0


class PairFeatures(nn.Module):
    r"""Invariant features of a receiver i and a sender j in one frame, all of about size 1.

    With the unit vector u from i to j at the distance d, the velocities v, their difference w and
    the changes b of each velocity into this frame: of d itself :math:`\log d`, d,
    :math:`e^{-d}, e^{-d/3}`; :math:`w \cdot u`, :math:`|w|`, both speeds, :math:`v_i \cdot u,
    v_j \cdot u, v_i \cdot v_j`; :math:`b_i \cdot u, b_i \cdot w, |b_i|, b_j \cdot u`; and the
    last four of the changes out of this frame too, if the *future* is told: what j does to i shows
    in them.

    Parameters
    ----------
    scales
        Units: the spacing of distances, the typical speed and its change from frame to frame.
    future
        Whether the next velocities are told.
    """

    def __init__(self, scales: Scales, *, future: bool) -> None:
        super().__init__()
        self.space, self.future = scales.space, future
        self.spacing = _positive(scales.spacing or scales.length)
        self.speed = _positive(scales.speed)
        self.change = _positive(scales.step or scales.speed) * math.sqrt(scales.space)

    @property
    def size(self) -> int:
        """Number of features."""
        return 19 if self.future else 15

    def forward(self, states: Tensor, before: Tensor, after: Tensor | None = None) -> Tensor:
        """Return the features.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        before, after
            Velocities one frame before and after, ``(..., individual, space)``.

        Returns
        -------
        ``(..., individual, neighbor, feature)``.
        """
        positions = states[..., : self.space] / self.spacing
        velocities = states[..., self.space :] / self.speed
        away = positions.unsqueeze(-3) - positions.unsqueeze(-2)
        squared = away.square().sum(-1)
        apart = squared > 0
        distance = torch.where(apart, squared, 1.0).sqrt()
        toward = torch.where(apart.unsqueeze(-1), away / distance.unsqueeze(-1), 0.0)
        mine, theirs = velocities.unsqueeze(-2), velocities.unsqueeze(-3)
        relative = theirs - mine
        parts = [
            distance.clamp(min=1e-3).log(),
            distance,
            torch.exp(-distance),
            torch.exp(-distance / 3.0),
            _dot(relative, toward),
            _length(relative),
            _length(mine).expand_as(distance),
            _length(theirs).expand_as(distance),
            _dot(mine, toward),
            _dot(theirs, toward),
            _dot(mine, theirs),
        ]
        changes = [states[..., self.space :] - before]
        if self.future:
            assert after is not None, "the encoder is told the future"
            changes.append(after - states[..., self.space :])
        for change in changes:
            turned = change / self.change
            own = turned.unsqueeze(-2)
            parts += [
                _dot(own, toward),
                _dot(own, relative),
                _length(own).expand_as(distance),
                _dot(turned.unsqueeze(-3), toward),
            ]
        return torch.stack(parts, -1).clamp(-BOUND, BOUND)

    def of_window(self, states: Tensor) -> Tensor:
        """Return the features of all frames, ``(batch, time, individual, neighbor, feature)``.

        Before the first frame, and after the last, velocities are taken not to change.
        """
        velocities = states[..., self.space :]
        before = torch.cat([velocities[:, :1], velocities[:, :-1]], 1)
        after = torch.cat([velocities[:, 1:], velocities[:, -1:]], 1) if self.future else None
        found: Tensor = self(states, before, after)
        return found


def _dot(left: Tensor, right: Tensor) -> Tensor:
    return (left * right).sum(-1)


def _length(vectors: Tensor) -> Tensor:
    """Return lengths, smooth at 0."""
    return (vectors.square().sum(-1) + 1e-6).sqrt()


def _positive(size: float) -> float:
    return size if size > 0.0 else 1.0
