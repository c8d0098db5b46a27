"""Graphs as lists of edges, for swarms too large for a matrix of pairs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import torch
from torch import Tensor
from torch.nn import functional

from swarmssm.errors import InputError

__all__ = ["EdgeList"]


@dataclass(frozen=True, eq=False)
class EdgeList:
    """Edges of many frames at once; the sparse twin of an adjacency matrix.

    All individuals of all frames are numbered through: individual i of the frame at flat index f
    of ``leading`` has number ``f * individuals + i``. A frame may have no edges.

    The edges must be sorted by receiver, and that is not looked into here: :meth:`from_pairs` sorts
    and checks, and :meth:`from_dense` makes them of a matrix.

    Attributes
    ----------
    receiver, sender
        ``(edge,)`` of whole numbers: the receiver sees the sender, within one frame; sorted by
        receiver, so that edges of a frame stand together.
    leading
        Shape of the frames, such as ``(batch, time)``.
    individuals
        Their number in each frame.
    weight
        ``(edge,)``: how much each edge counts, as an adjacency between 0 and 1 would say;
        gradients flow into it. ``None``: all count 1.
    """

    receiver: Tensor
    sender: Tensor
    leading: tuple[int, ...]
    individuals: int
    weight: Tensor | None = None

    @classmethod
    def from_dense(cls, adjacency: Tensor) -> "EdgeList":
        """Return the edges of adjacencies ``(..., individual, individual)``.

        Entries other than 0 and 1 become weights, and so does every adjacency that needs a
        gradient. An entry of 0 is no edge, and has no gradient.

        Raises
        ------
        InputError
            If the last two dimensions are not equal.
        """
        if adjacency.dim() < 2 or adjacency.shape[-1] != adjacency.shape[-2]:
            raise InputError(
                "adjacency: the shape must be (..., individual, individual), and it is "
                f"{tuple(adjacency.shape)}."
            )
        *leading, n, _ = adjacency.shape
        rows = adjacency.reshape(torch.Size(leading).numel() * n, n)
        receiver, seen = torch.nonzero(rows, as_tuple=True)
        weight = None
        if adjacency.is_floating_point():
            entries = rows[receiver, seen]
            if entries.requires_grad or not bool((entries == 1).all()):
                weight = entries
        sender = torch.div(receiver, n, rounding_mode="floor") * n + seen
        return cls(receiver, sender, tuple(leading), n, weight)

    @classmethod
    def from_pairs(
        cls,
        receiver: Tensor,
        sender: Tensor,
        leading: Sequence[int],
        individuals: int,
        weight: Tensor | None = None,
    ) -> "EdgeList":
        """Return a list of edges in any order, checked and sorted.

        Parameters
        ----------
        receiver, sender, leading, individuals, weight
            As in the class.

        Raises
        ------
        InputError
            If there are not as many receivers as senders and weights, a number is out of range, or
            an edge joins two frames.
        """
        sizes = {tuple(part.shape) for part in (receiver, sender, weight) if part is not None}
        if sizes != {(receiver.numel(),)}:
            raise InputError(
                "edges: receivers, senders and weights must be as many, (edge,), and their shapes "
                f"are {', '.join(map(str, sorted(sizes)))}."
            )
        whole = not (receiver.is_floating_point() or sender.is_floating_point())
        nodes = torch.Size(leading).numel() * individuals
        both = torch.cat([receiver, sender])
        if not whole or (both.numel() and not 0 <= int(both.min()) <= int(both.max()) < nodes):
            raise InputError(f"edges: their ends must be whole numbers from 0 to {nodes - 1}.")
        receiver, sender = receiver.long(), sender.long()
        # Without edges there may be no individuals to divide by either.
        size = max(individuals, 1)
        if not torch.equal(receiver // size, sender // size):
            raise InputError("edges: receiver and sender of an edge must be of the same frame.")
        order = torch.argsort(receiver * nodes + sender)
        receiver, sender = receiver[order], sender[order]
        twice = (receiver[1:] == receiver[:-1]) & (sender[1:] == sender[:-1])
        if bool(twice.any()):
            raise InputError("edges: an edge from one individual to another may stand only once.")
        return cls(
            receiver,
            sender,
            tuple(leading),
            individuals,
            None if weight is None else weight[order],
        )

    def __repr__(self) -> str:
        weighted = "" if self.weight is None else ", weighted"
        return (
            f"EdgeList({self.num_edges} edges, leading={self.leading}, "
            f"individuals={self.individuals}{weighted})"
        )

    def to_dense(self, dtype: torch.dtype | None = None) -> Tensor:
        """Return adjacencies ``(*leading, individual, individual)``: the weights, or 0 and 1."""
        n = self.individuals
        if dtype is None and self.weight is not None:
            dtype = self.weight.dtype
        matrix = torch.zeros(self.num_nodes, n, dtype=dtype, device=self.receiver.device)
        if self.num_edges:
            entries = matrix.new_ones(()) if self.weight is None else self.weight.to(matrix.dtype)
            matrix = matrix.index_put((self.receiver, self.sender % n), entries)
        return matrix.reshape(*self.leading, n, n)

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return torch.Size(self.leading).numel()

    @property
    def num_nodes(self) -> int:
        """Number of individuals in all frames together."""
        return self.num_frames * self.individuals

    @property
    def num_edges(self) -> int:
        """Number of edges in all frames together."""
        return len(self.receiver)

    @cached_property
    def offsets(self) -> Tensor:
        """Where the edges of each receiver begin, and where the last end: ``(num_nodes + 1,)``."""
        return _offsets(self.receiver, self.num_nodes)

    @cached_property
    def by_sender(self) -> tuple[Tensor, Tensor, Tensor]:
        """The same edges sorted by sender.

        Returns
        -------
        Which edges, ``(edge,)``; their receivers, ``(edge,)``; and where the edges of each sender
        begin, and where the last end, ``(num_nodes + 1,)``.
        """
        if self.sender.device.type == "cpu":
            # Turning rows into columns takes linear time, where sorting does not.
            parts = (np.arange(self.num_edges), self.sender.numpy(), self.offsets.numpy())
            columns = scipy.sparse.csr_array(parts, shape=(self.num_nodes, self.num_nodes)).tocsc()
            order = torch.from_numpy(columns.data)
            receiver = torch.from_numpy(columns.indices.astype(np.int64))
            return order, receiver, torch.from_numpy(columns.indptr.astype(np.int64))
        order = torch.argsort(self.sender, stable=True)
        return order, self.receiver[order], _offsets(self.sender, self.num_nodes)

    def frames(self, index: Tensor) -> "EdgeList":
        """Return the edges of some frames, in any order and as often as they are named.

        Parameters
        ----------
        index
            Flat numbers of frames, of any shape, which becomes the leading one. -1 is a frame
            without edges, as padding needs it.
        """
        n, flat = self.individuals, index.reshape(-1)
        starts = self.offsets[::n] if n else self.offsets.new_zeros(self.num_frames + 1)
        known = flat.clamp(min=0)
        first = starts[known]
        counts = torch.where(flat >= 0, starts[known + 1] - first, 0)
        # Edges of one frame stand together: number those that are taken, and shift them.
        place = torch.repeat_interleave(counts)
        order = torch.arange(len(place), device=index.device)
        edge = order + (first - counts.cumsum(0) + counts)[place]
        shift = ((torch.arange(len(flat), device=index.device) - flat) * n)[place]
        return EdgeList(
            self.receiver[edge] + shift,
            self.sender[edge] + shift,
            tuple(index.shape),
            n,
            None if self.weight is None else self.weight[edge],
        )

    def __getitem__(self, index: Any) -> "EdgeList":
        """Return the edges of the frames that an index into the leading dimensions picks.

        Whatever a tensor of shape ``leading`` can be indexed with: numbers, slices, tensors of
        whole numbers (with repetition) or of bool, and tuples of these.
        """
        return self.frames(self._numbers()[index])

    def select(self, dim: int, start: int, stop: int) -> "EdgeList":
        """Return the frames ``start`` to ``stop`` (exclusive) along a leading dimension."""
        return self.frames(self._numbers().narrow(dim, start, stop - start))

    def squeeze(self, dim: int) -> "EdgeList":
        """Return the same edges without a leading dimension of size 1.

        Raises
        ------
        ValueError
            If its size is another.
        """
        place = dim % len(self.leading)
        if self.leading[place] != 1:
            raise ValueError(f"dimension {dim} of {self.leading} is not 1")
        return replace(self, leading=(*self.leading[:place], *self.leading[place + 1 :]))

    def expand(self, *leading: int) -> "EdgeList":
        """Return the edges repeated along dimensions that are new in front or had size 1."""
        if leading == self.leading:
            return self
        return self.frames(self._numbers().expand(*leading))

    def between(self, present: Tensor) -> "EdgeList":
        """Return the edges both of whose ends are there.

        Parameters
        ----------
        present
            ``(*leading, individual)`` of bool.
        """
        there = present.reshape(-1)
        if present.shape != (*self.leading, self.individuals):
            raise ValueError(
                f"present must have shape {(*self.leading, self.individuals)}, and it is "
                f"{tuple(present.shape)}"
            )
        kept = there[self.receiver] & there[self.sender]
        return replace(
            self,
            receiver=self.receiver[kept],
            sender=self.sender[kept],
            weight=None if self.weight is None else self.weight[kept],
        )

    def to(self, device: torch.device | str) -> "EdgeList":
        """Return the edges on another device."""
        return replace(
            self,
            receiver=self.receiver.to(device),
            sender=self.sender.to(device),
            weight=None if self.weight is None else self.weight.to(device),
        )

    def _numbers(self) -> Tensor:
        """Return the flat number of each frame, of shape ``leading``."""
        numbers = torch.arange(self.num_frames, device=self.receiver.device)
        return numbers.reshape(self.leading)


def _offsets(numbers: Tensor, size: int) -> Tensor:
    """Return where each number begins among sorted ones, and where the last ends."""
    return functional.pad(torch.bincount(numbers, minlength=size).cumsum(0), (1, 0))
