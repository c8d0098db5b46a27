"""What an encoder of edges is given: states, how they change, and how two move to each other."""

import torch
from torch import Tensor, nn

__all__ = [
    "begin_without_changes",
    "individual_features",
    "num_individual_features",
    "num_relative_features",
    "relative_features",
]


def num_individual_features(features: int, changes: bool) -> int:
    """Return the number of features of an individual in a frame."""
    return (2 if changes else 1) * features + 1


def individual_features(
    states: Tensor, present: Tensor, change: Tensor | None, before: Tensor | None = None
) -> Tensor:
    """Return states, what they changed by since the frame before, and a mark for who is there.

    Parameters
    ----------
    states
        Shape ``(batch, time, individual, feature)``, 0 where an individual is absent.
    present
        Shape ``(batch, time, individual)`` of bool.
    change
        Unit of the changes, ``(feature,)``; ``None``: leave the changes out.
    before
        State and mark of the frame before the first, ``(batch, individual, feature + 1)``;
        ``None``: nobody was there.

    Returns
    -------
    Shape ``(batch, time, individual, 2 * feature + 1)``, or ``feature + 1`` without changes; a
    change is 0 for who was not there in the frame before.
    """
    mark = present.unsqueeze(-1).to(states.dtype)
    marked = torch.cat([states, mark], dim=-1)
    if change is None:
        return marked
    first = torch.zeros_like(marked[:, 0]) if before is None else before
    earlier = torch.cat([first.unsqueeze(1), marked[:, :-1]], dim=1)
    moved = (states - earlier[..., :-1]) / change * (mark * earlier[..., -1:])
    return torch.cat([states, moved, mark], dim=-1)


def begin_without_changes(layer: nn.Linear, features: int) -> None:
    """Set the weights of the changes to 0 in a layer on the features of one or more frames."""
    changes = torch.zeros(num_individual_features(features, True), dtype=torch.bool)
    changes[features : 2 * features] = True
    with torch.no_grad():
        layer.weight[:, changes.repeat(layer.in_features // len(changes))] = 0.0


def num_relative_features(features: int) -> int:
    """Return the number of features of a pair in a frame."""
    return features + 2


def relative_features(states: Tensor, present: Tensor) -> Tensor:
    """Return differences of the states, and lengths of their two halves.

    Parameters
    ----------
    states
        Shape ``(..., individual, feature)``, positions first and velocities after; finite.
    present
        Shape ``(..., individual)`` of bool.

    Returns
    -------
    Shape ``(..., individual, neighbor, feature + 2)``: the neighbor's state less one's own,
    distance and relative speed; 0 unless both are there.
    """
    apart = states.unsqueeze(-3) - states.unsqueeze(-2)
    halves = torch.stack(apart.chunk(2, dim=-1), dim=-2)
    # The square root has no slope at 0, which is where everybody stands relative to itself.
    lengths = (halves.square().sum(-1) + 1e-8).sqrt()
    both = present.unsqueeze(-1) & present.unsqueeze(-2)
    return torch.cat([apart, lengths], dim=-1) * both.unsqueeze(-1).to(states.dtype)
