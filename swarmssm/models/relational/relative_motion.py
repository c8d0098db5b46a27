"""What can be known of a pair at one time: how its two stand and move relative to each other."""

import torch
from torch import Tensor

__all__ = ["num_relative_features", "relative_features"]


def num_relative_features(features: int) -> int:
    """Return the number of features of a pair."""
    return features + 2


def relative_features(states: Tensor, present: Tensor) -> Tensor:
    """Return differences of the states, and lengths of their two halves.

    Parameters
    ----------
    states
        Shape ``(..., individual, state)``, positions first and velocities after; finite.
    present
        Shape ``(..., individual)`` of bool.

    Returns
    -------
    Shape ``(..., individual, neighbor, state + 2)``: the neighbor's state less one's own, distance
    and relative speed; 0 unless both are there.
    """
    apart = states.unsqueeze(-3) - states.unsqueeze(-2)
    halves = torch.stack(apart.chunk(2, dim=-1), dim=-2)
    # The square root has no slope at 0, which is where everybody stands relative to itself.
    lengths = (halves.square().sum(-1) + 1e-8).sqrt()
    both = present.unsqueeze(-1) & present.unsqueeze(-2)
    return torch.cat([apart, lengths], dim=-1) * both.unsqueeze(-1).to(states.dtype)
