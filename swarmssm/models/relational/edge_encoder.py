"""One type of edge for each pair, from a whole window of motion."""

import torch
from torch import Tensor, nn

from swarmssm.errors import InputError
from swarmssm.models.relational.motion_features import (
    begin_without_changes,
    individual_features,
    num_individual_features,
    num_relative_features,
    relative_features,
)
from swarmssm.models.relational.pair_embedding import PairEmbedding, pairs_of

__all__ = ["EdgeEncoder"]


class EdgeEncoder(nn.Module):
    """The encoder of neural relational inference: q(edge type | a window of states).

    A window is one long vector of each individual's states, put through
    :class:`~swarmssm.models.relational.PairEmbedding` and a last linear layer. Frames in which an
    individual is absent are 0 in it, and a mark for each frame says which these are.

    Parameters
    ----------
    features
        Numbers in the state of an individual: positions, then as many velocities.
    window
        Number of frames. A shorter recording is as if nobody were there before it; of a longer
        one, windows side by side are encoded (the last ends where the recording does, the first
        may overlap with the second) and their logits averaged.
    num_types
        Number of edge types.
    hidden
        Width of the layers; 256 in the paper.
    change
        Typical change of each feature in a frame, ``(feature,)``. With it the encoder is also given
        the changes from frame to frame in these units, in which accelerations stand out; the paper
        leaves them to the network. Their weights begin at 0: an encoder that listens to them from
        the start is apt to call all pairs the same before the decoder has learned anything.
    relative
        Whether each pair's relative positions and velocities, distance and relative speed are
        given, too. The paper leaves their discovery to the network.

    References
    ----------
    Kipf, Fetaya, Wang, Welling and Zemel (2018), Neural relational inference for interacting
    systems, ICML.
    """

    def __init__(
        self,
        features: int,
        window: int,
        num_types: int = 2,
        hidden: int = 64,
        *,
        change: Tensor | None = None,
        relative: bool = False,
    ) -> None:
        super().__init__()
        for name, value, least in (("window", window, 1), ("edge_types", num_types, 2)):
            if value < least:
                raise InputError(f"{name}: it must be at least {least}, and it is {value}.")
        self.window, self.num_types, self.relative = window, num_types, relative
        of_pair = window * num_relative_features(features) if relative else 0
        of_each = window * num_individual_features(features, change is not None)
        self.embedding = PairEmbedding(of_each, hidden, of_pair)
        self.register_buffer("change", change)
        self.out = nn.Linear(hidden, num_types)
        if change is not None:
            begin_without_changes(self.embedding.node.first, features)

    def forward(self, states: Tensor, present: Tensor | None = None) -> Tensor:
        """Return the logits of each pair's type.

        Parameters
        ----------
        states
            Shape ``(batch, time, individual, feature)``, scaled to be about one in size; whatever
            stands where an individual is absent does not count.
        present
            Shape ``(batch, time, individual)`` of bool; default everybody always.

        Returns
        -------
        Shape ``(batch, individual, neighbor, edge_type)``: what type of edge the neighbor has upon
        the individual. 0, all types equally likely, for pairs that are not two, or of which one is
        never there.
        """
        if present is None:
            present = torch.ones(states.shape[:-1], dtype=torch.bool, device=states.device)
        states = torch.where(present.unsqueeze(-1), states, 0.0)
        windows, there = self._windows(states), self._windows(present)
        batch, count = windows.shape[:2]
        logits = self._encode(windows.flatten(0, 1), there.flatten(0, 1))
        logits = logits.view(batch, count, *logits.shape[1:])
        seen = pairs_of(there.any(2)).unsqueeze(-1).to(logits.dtype)
        mean: Tensor = (logits * seen).sum(1) / seen.sum(1).clamp(min=1.0)
        return mean

    def _windows(self, values: Tensor) -> Tensor:
        """Cut ``(batch, time, ...)`` into ``(batch, window, frame, ...)``."""
        missing = self.window - values.shape[1]
        if missing >= 0:
            before = values.new_zeros((values.shape[0], missing, *values.shape[2:]))
            return torch.cat([before, values], dim=1).unsqueeze(1)
        ends = range(values.shape[1], 0, -self.window)
        starts = [max(0, end - self.window) for end in ends]
        return torch.stack([values[:, start : start + self.window] for start in starts], dim=1)

    def _encode(self, states: Tensor, present: Tensor) -> Tensor:
        """Return the logits of windows of full length."""
        change = self._buffers["change"]
        values = individual_features(states, present, change).transpose(1, 2).flatten(2)
        between = None
        if self.relative:
            between = relative_features(states, present).movedim(1, 3).flatten(3)
        logits: Tensor = self.out(self.embedding(values, between, pairs_of(present.any(1))))
        return logits
