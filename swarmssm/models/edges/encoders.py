"""Networks that tell types of edges by how pairs move: of whole windows, and frame by frame."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from swarmssm.models.edges.pair_features import PairFeatures
from swarmssm.models.edges.seen import Seen
from swarmssm.models.layers import check_sizes
from swarmssm.models.scales import Scales

#: Place of the distance among the features of a pair, and the distance at which closeness says
#: nothing, in spacings, to begin with.
DISTANCE, MIDDLE = 1, 2.0

__all__ = ["Closeness", "Memory", "PairEncoder", "StepEncoder", "WindowEncoder"]


class Memory(NamedTuple):
    """What a recurrence knows after a frame.

    Attributes
    ----------
    hidden
        Of each pair, ``(..., individual, neighbor, hidden)``.
    velocities
        In that frame, ``(..., individual, space)``.
    """

    hidden: Tensor
    velocities: Tensor


class PairEncoder(nn.Module):
    r"""Embeddings of ordered pairs, by one round of messages from edges to nodes and back.

    As in neural relational inference, :math:`h_{ij} = f_1(x_{ij})`, :math:`h_i` the mean of
    :math:`h_{ij}` over j, and :math:`h'_{ij} = f_2(h_{ij}, h_i, h_j)`; but :math:`x_{ij}` are
    features that look the same turned, mirrored or moved
    (:class:`~swarmssm.models.edges.pair_features.PairFeatures`), where the original has the states
    of both.

    Parameters
    ----------
    in_features
        Features of a pair.
    hidden
        Width.
    """

    def __init__(self, in_features: int, hidden: int) -> None:
        super().__init__()
        check_sizes(in_features=in_features, hidden=hidden)
        self.first = nn.Sequential(
            nn.Linear(in_features, hidden), nn.ELU(), nn.Linear(hidden, hidden), nn.ELU()
        )
        self.pair = nn.Linear(hidden, hidden)
        self.ends = nn.Linear(hidden, 2 * hidden, bias=False)
        self.second = nn.Sequential(nn.ELU(), nn.Linear(hidden, hidden), nn.ELU())

    def forward(self, features: Tensor, pairs: Tensor) -> Tensor:
        """Return embeddings ``(..., individual, neighbor, hidden)``.

        Parameters
        ----------
        features
            ``(..., individual, neighbor, feature)``.
        pairs
            Which pairs there are, ``(..., individual, neighbor)`` of bool.
        """
        embedded = self.first(features)
        there = pairs.unsqueeze(-1).to(embedded.dtype)
        total = (embedded * there).sum(-2) / there.sum(-2).clamp(min=1.0)
        mine, theirs = self.ends(total).chunk(2, -1)
        found: Tensor = self.second(self.pair(embedded) + mine.unsqueeze(-2) + theirs.unsqueeze(-3))
        return found


class Closeness(nn.Module):
    r"""Log-odds of an edge that fall with distance, :math:`-s\,(d - d_0)`, both learned.

    Parameters
    ----------
    slope
        s to begin with, per spacing.
    """

    def __init__(self, slope: float) -> None:
        super().__init__()
        self.slope = nn.Parameter(torch.tensor(float(slope)))
        self.middle = nn.Parameter(torch.tensor(MIDDLE))

    def forward(self, logits: Tensor, features: Tensor) -> Tensor:
        """Return logits with these of all types but the first.

        Parameters
        ----------
        logits
            ``(..., type)``.
        features
            Of the pairs, ``(..., feature)``, as
            :class:`~swarmssm.models.edges.pair_features.PairFeatures` has them.
        """
        near = self.slope * (self.middle - features[..., DISTANCE : DISTANCE + 1])
        return torch.cat([logits[..., :1], logits[..., 1:] + near], -1)


class WindowEncoder(nn.Module):
    """One type for each pair from a whole window: the encoder of neural relational inference.

    Each frame is embedded by a :class:`PairEncoder`, the mean over the frames by another.

    Parameters
    ----------
    scales
        Typical sizes of the tracks.
    num_types
        K.
    hidden
        Width; the original has 256.
    near
        Of :class:`Closeness`; ``None``, there is none.
    """

    def __init__(
        self, scales: Scales, num_types: int, hidden: int = 32, near: float | None = None
    ) -> None:
        super().__init__()
        self.closeness = None if near is None else Closeness(near)
        self.features = PairFeatures(scales, future=True)
        self.frame = PairEncoder(self.features.size, hidden)
        self.whole = PairEncoder(hidden, hidden)
        self.head = nn.Linear(2 * hidden, num_types)

    def forward(self, seen: Seen) -> Tensor:
        """Return logits ``(batch, 1, individual, neighbor, type)``."""
        pairs = seen.pairs
        features = self.features.of_window(seen.states)
        there = pairs.unsqueeze(-1).to(features.dtype)
        count = there.sum(1, keepdim=True).clamp(min=1.0)
        mean = (self.frame(features, pairs) * there).sum(1, keepdim=True) / count
        whole = self.whole(mean, pairs.any(1, keepdim=True))
        logits: Tensor = self.head(torch.cat([mean, whole], -1))
        if self.closeness is None:
            return logits
        nearer: Tensor = self.closeness(logits, (features * there).sum(1, keepdim=True) / count)
        return nearer


class StepEncoder(nn.Module):
    """Types of each frame, by a recurrence over the embeddings of each pair.

    Parameters
    ----------
    scales
        Typical sizes of the tracks.
    num_types
        K.
    hidden
        Width of embeddings, and of the recurrence each way; the original has 256 and 64.
    smoothing
        True: the recurrence goes both ways, and next velocities are told; a frame knows the whole
        window. False: it knows itself and the frames before it.
    near
        Of :class:`Closeness`; ``None``, there is none.
    """

    def __init__(
        self,
        scales: Scales,
        num_types: int,
        hidden: int = 32,
        *,
        smoothing: bool,
        near: float | None = None,
    ) -> None:
        super().__init__()
        self.closeness = None if near is None else Closeness(near)
        self.smoothing, self.hidden = smoothing, hidden
        self.features = PairFeatures(scales, future=smoothing)
        self.embed = PairEncoder(self.features.size, hidden)
        self.recurrence = nn.GRU(hidden, hidden, batch_first=True, bidirectional=smoothing)
        known = hidden * (3 if smoothing else 2)
        self.head = nn.Sequential(nn.Linear(known, hidden), nn.ELU(), nn.Linear(hidden, num_types))

    def forward(self, seen: Seen) -> Tensor:
        """Return logits ``(batch, time, individual, neighbor, type)``."""
        logits, _ = self.scan(seen)
        return logits

    def scan(self, seen: Seen) -> tuple[Tensor, Tensor]:
        """Return the logits, and what the recurrence knows after each frame.

        Hidden states are ``(batch, time, individual, neighbor, hidden)``, forwards first.
        """
        features = self.features.of_window(seen.states)
        embedded = self.embed(features, seen.pairs)
        batch, times, count = embedded.shape[:3]
        rows = embedded.movedim(1, 3).reshape(-1, times, self.hidden)
        told, _ = self.recurrence(rows)
        told = told.reshape(batch, count, count, times, -1).movedim(3, 1)
        return self._logits(features, embedded, told), told

    def _logits(self, features: Tensor, embedded: Tensor, told: Tensor) -> Tensor:
        """Return logits from features, embedding and recurrence of pairs."""
        logits: Tensor = self.head(torch.cat([embedded, told], -1))
        if self.closeness is None:
            return logits
        near: Tensor = self.closeness(logits, features)
        return near

    def step(self, states: Tensor, present: Tensor, memory: Memory | None) -> tuple[Tensor, Memory]:
        """Return the logits of one more frame, and what is known after it.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        present
            ``(..., individual)`` of bool.
        memory
            Of the frame before; ``None`` at the first.

        Raises
        ------
        ValueError
            If the encoder looks into the future.
        """
        if self.smoothing:
            raise ValueError("an encoder that smooths cannot go step by step")
        velocities = states[..., self.features.space :]
        before = velocities if memory is None else memory.velocities
        pairs = Seen(states, present).pairs
        features = self.features(states, before)
        embedded = self.embed(features, pairs)
        rows = embedded.reshape(-1, 1, self.hidden)
        start = None if memory is None else memory.hidden.reshape(1, -1, self.hidden)
        told, _ = self.recurrence(rows, start)
        told = told.reshape(embedded.shape)
        return self._logits(features, embedded, told), Memory(told, velocities)
