"""A type of edge for each pair and step: from the past alone, and from the whole recording."""

from typing import NamedTuple

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

__all__ = ["DynamicEdgeEncoder", "EdgeMemory"]


class EdgeMemory(NamedTuple):
    """What there is to remember after a frame.

    Attributes
    ----------
    hidden, cell
        Of the forward recurrence of each pair, ``(batch, individual, neighbor, hidden)``.
    last
        State of each individual, then 1 if it was there, else 0:
        ``(batch, individual, feature + 1)``.
    """

    hidden: Tensor
    cell: Tensor
    last: Tensor


class DynamicEdgeEncoder(nn.Module):
    r"""The encoder of dynamic neural relational inference: prior and posterior of edges per step.

    Each frame is put through :class:`~swarmssm.models.relational.PairEmbedding`; then, for each
    pair,

    .. math::
        \overrightarrow{h}_t &= \mathrm{LSTM}(h_t, \overrightarrow{h}_{t-1}), &
        p(z_t \mid x_{\le t}) &= \mathrm{softmax}\, f_p(\overrightarrow{h}_t), \\
        \overleftarrow{h}_t &= \mathrm{LSTM}(h_t, \overleftarrow{h}_{t+1}), &
        q(z_t \mid x_{1:T}) &= \mathrm{softmax}\, f_q(\overrightarrow{h}_t, \overleftarrow{h}_t).

    The edges :math:`z_t` carry the group from frame t to t + 1. The prior knows the past and the
    present, so that forecasts can use it; the posterior knows the future, too.

    Parameters
    ----------
    features
        Numbers in the state of an individual: positions, then as many velocities.
    num_types
        Number of edge types.
    hidden
        Width of the layers; 256 in the paper.
    recurrent
        Width of both recurrences; 64 in the paper.
    head
        Width of the three-layer networks :math:`f_p, f_q`; 128 in the paper.
    change, relative
        As for :class:`~swarmssm.models.relational.EdgeEncoder`.

    References
    ----------
    Graber and Schwing (2020), Dynamic neural relational inference, CVPR.
    """

    def __init__(
        self,
        features: int,
        num_types: int = 2,
        hidden: int = 64,
        *,
        recurrent: int = 64,
        head: int = 64,
        change: Tensor | None = None,
        relative: bool = False,
    ) -> None:
        super().__init__()
        if num_types < 2:
            raise InputError(f"edge_types: it must be at least 2, and it is {num_types}.")
        self.num_types, self.relative, self.recurrent = num_types, relative, recurrent
        of_pair = num_relative_features(features) if relative else 0
        of_each = num_individual_features(features, change is not None)
        self.embedding = PairEmbedding(of_each, hidden, of_pair)
        self.register_buffer("change", change)
        if change is not None:
            begin_without_changes(self.embedding.node.first, features)
        self.forward_rnn = nn.LSTM(hidden, recurrent, batch_first=True)
        self.backward_rnn = nn.LSTM(hidden, recurrent, batch_first=True)
        self.prior = _head(recurrent, head, num_types)
        self.posterior = _head(2 * recurrent, head, num_types)

    def forward(self, states: Tensor, present: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the logits of prior and posterior.

        Parameters
        ----------
        states
            Shape ``(batch, time, individual, feature)``, scaled to be about one in size; whatever
            stands where an individual is absent does not count.
        present
            Shape ``(batch, time, individual)`` of bool; default everybody always.

        Returns
        -------
        Both ``(batch, time, individual, neighbor, edge_type)``; 0 for pairs that are not two, or
        not both there in that frame.
        """
        prior, posterior, _ = self.encode(states, present)
        return prior, posterior

    def encode(
        self, states: Tensor, present: Tensor | None = None
    ) -> tuple[Tensor, Tensor, EdgeMemory]:
        """Return the logits of prior and posterior, and the memory after the last frame."""
        embedded, pairs, last = self._embed(states, present, None)
        ahead, hidden, cell = self._run(self.forward_rnn, embedded, None)
        back, _, _ = self._run(self.backward_rnn, embedded.flip(1), None)
        memory = EdgeMemory(hidden, cell, last)
        both = torch.cat([ahead, back.flip(1)], dim=-1)
        known = pairs.unsqueeze(-1).to(both.dtype)
        return self.prior(ahead) * known, self.posterior(both) * known, memory

    def filter(
        self,
        states: Tensor,
        present: Tensor | None = None,
        memory: EdgeMemory | None = None,
    ) -> tuple[Tensor, EdgeMemory]:
        """Return the logits of the prior for further frames, and the memory after the last.

        Parameters
        ----------
        states, present
            As for :meth:`forward`; any number of frames, for instance the one just predicted.
        memory
            What was returned for the frames before; ``None`` at the beginning.
        """
        embedded, pairs, last = self._embed(states, present, memory)
        ahead, hidden, cell = self._run(self.forward_rnn, embedded, memory)
        logits = self.prior(ahead) * pairs.unsqueeze(-1).to(ahead.dtype)
        return logits, EdgeMemory(hidden, cell, last)

    def _embed(
        self, states: Tensor, present: Tensor | None, memory: EdgeMemory | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return embeddings of the pairs of each frame, which there are, and the last frame."""
        if present is None:
            present = torch.ones(states.shape[:-1], dtype=torch.bool, device=states.device)
        states = torch.where(present.unsqueeze(-1), states, 0.0)
        before = None if memory is None else memory.last
        values = individual_features(states, present, self._buffers["change"], before)
        between = relative_features(states, present).flatten(0, 1) if self.relative else None
        pairs = pairs_of(present)
        embedded = self.embedding(values.flatten(0, 1), between, pairs.flatten(0, 1))
        last = torch.cat([states[:, -1], present[:, -1].unsqueeze(-1).to(states.dtype)], dim=-1)
        return embedded.view(*states.shape[:2], *embedded.shape[1:]), pairs, last

    def _run(
        self, rnn: nn.LSTM, embedded: Tensor, memory: EdgeMemory | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Run a recurrence over time, each pair for itself; return also hidden state and cell."""
        batch, time, size = embedded.shape[:3]
        rows = embedded.permute(0, 2, 3, 1, 4).reshape(batch * size * size, time, -1)
        begin = None
        if memory is not None:
            parts = (memory.hidden, memory.cell)
            begin = tuple(part.reshape(1, len(rows), -1) for part in parts)
        out, last = rnn(rows, begin)
        out = out.reshape(batch, size, size, time, -1).permute(0, 3, 1, 2, 4)
        hidden, cell = (values.reshape(batch, size, size, -1) for values in last)
        return out, hidden, cell


def _head(features: int, hidden: int, num_types: int) -> nn.Sequential:
    """Return three layers from a memory to logits."""
    return nn.Sequential(
        nn.Linear(features, hidden),
        nn.ELU(),
        nn.Linear(hidden, hidden),
        nn.ELU(),
        nn.Linear(hidden, num_types),
    )
