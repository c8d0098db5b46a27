"""Sums over neighbours, the same numbers on an adjacency matrix and on a list of edges.

The leading dimensions of graph and values broadcast against each other, whichever the graph is; a
list of edges must have no more of them than the values. Weights of either take part in every sum.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from swarmssm.graphs.edge_list import EdgeList

__all__ = ["Graph", "Pairs", "degree", "dense", "neighbor_mean", "neighbor_sum", "pair_sum"]

#: ``adjacency[..., i, j]`` is the weight with which i sees j; or a list of edges.
Graph = Tensor | EdgeList


def neighbor_sum(values: Tensor, graph: Graph) -> Tensor:
    r"""Return :math:`\sum_j A_{ij} x_j`.

    Parameters
    ----------
    values
        ``(..., individual, feature)``.
    graph
        Adjacency ``(..., individual, individual)`` of any dtype, or a list of edges.

    Returns
    -------
    ``(..., individual, feature)``.

    Raises
    ------
    ValueError
        If a list of edges belongs to frames of another shape; the message has both.
    """
    return Pairs(graph, values).neighbor_sum(values)


def degree(values: Tensor, graph: Graph) -> Tensor:
    """Return the (weighted) number of neighbours, ``(..., individual, 1)``, of values' dtype."""
    if not isinstance(graph, EdgeList):
        return graph.to(values.dtype).sum(-1, keepdim=True)
    if graph.weight is None:
        # Counted anew, since what a list keeps must not be made inside a transform of functions.
        total = torch.bincount(graph.receiver, minlength=graph.num_nodes).to(values.dtype)
    else:
        total = _apply(graph.weight.to(values.dtype).unsqueeze(-1), graph, "sum")
    return total.reshape(*graph.leading, graph.individuals, 1)


def neighbor_mean(values: Tensor, graph: Graph) -> tuple[Tensor, Tensor]:
    """Return the (weighted) mean over neighbours, and who has any, ``(..., individual, 1)``.

    The mean is 0 for an individual without neighbours.
    """
    total = degree(values, graph)
    has_neighbor = total > 0
    return neighbor_sum(values, graph) / torch.where(has_neighbor, total, 1.0), has_neighbor


def pair_sum(values: Tensor, graph: Graph, message: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    r"""Return :math:`\sum_j A_{ij}\, m(x_i, x_j)` for any function of two individuals.

    Parameters
    ----------
    values
        ``(..., individual, feature)``.
    graph
        As in :func:`neighbor_sum`.
    message
        Maps features of receivers and senders, which broadcast against each other, to messages
        ``(..., out)``. On a matrix it is also asked for pairs without an edge, the diagonal
        included: what it says there must be finite.

    Returns
    -------
    ``(..., individual, out)``.
    """
    pairs = Pairs(graph, values)
    return pairs.sum(message(pairs.receivers(values), pairs.senders(values)))


class Pairs:
    """Receivers and senders of a graph, laid out so that one function serves both kinds of graph.

    On a matrix all pairs are there, receivers along the last but one dimension of individuals and
    senders along the last; of a list of edges only the edges are, along the first dimension.

    Parameters
    ----------
    graph
        Adjacency ``(..., individual, individual)`` of any dtype, or a list of edges.
    like
        Values ``(..., individual, feature)`` whose leading shape and dtype those of all others
        have.

    Raises
    ------
    ValueError
        If a list of edges belongs to frames of another shape; the message has both.
    """

    def __init__(self, graph: Graph, like: Tensor) -> None:
        if not isinstance(graph, EdgeList):
            self.graph: Graph = graph.to(like.dtype)
            return
        count = len(graph.leading)
        try:
            shape: torch.Size = torch.broadcast_shapes(  # type: ignore[no-untyped-call]
                like.shape[:-2], graph.leading
            )
        except RuntimeError:
            shape = torch.Size()
        if like.dim() < 2 or like.shape[-2] != graph.individuals or len(shape) < count:
            raise ValueError(
                f"the edges belong to frames of shape {(*graph.leading, graph.individuals)}, and "
                f"the values have {tuple(like.shape[:-1])}"
            )
        split = len(shape) - count
        self._layout = _Layout(shape[:split], shape[split:], graph.individuals)
        self.graph = graph.expand(*self._layout.frames)

    def receivers(self, values: Tensor) -> Tensor:
        """Return the receiver's values, which broadcast against those of the senders."""
        if not isinstance(self.graph, EdgeList):
            return values.unsqueeze(-2)
        rows = _apply(self._layout.rows(values), self.graph, "receivers")
        return self._layout.open(rows)

    def senders(self, values: Tensor) -> Tensor:
        """Return the sender's values."""
        if not isinstance(self.graph, EdgeList):
            return values.unsqueeze(-3)
        rows = _apply(self._layout.rows(values), self.graph, "senders")
        return self._layout.open(rows)

    def sum(self, messages: Tensor) -> Tensor:
        """Return the (weighted) sum over each receiver's senders, ``(..., individual, feature)``.

        Parameters
        ----------
        messages
            Made of what :meth:`receivers` and :meth:`senders` return, features last.
        """
        if not isinstance(self.graph, EdgeList):
            return (self.graph.unsqueeze(-2) @ messages).squeeze(-2)
        if self.graph.weight is not None:
            weight = self.graph.weight.to(messages.dtype)
            messages = messages * weight.reshape(-1, *([1] * (messages.dim() - 1)))
        return self._layout.restore(_apply(messages.flatten(1), self.graph, "sum"))

    def degree(self, like: Tensor) -> Tensor:
        """Return :func:`degree` for each of the values, ``(..., individual, 1)``."""
        own = degree(like, self.graph)
        shape: torch.Size = torch.broadcast_shapes(  # type: ignore[no-untyped-call]
            own.shape[:-1], like.shape[:-1]
        )
        return own.expand(*shape, 1)

    def neighbor_sum(self, values: Tensor) -> Tensor:
        """Return :func:`neighbor_sum`, the same as ``sum(senders(values))``."""
        if not isinstance(self.graph, EdgeList):
            return self.graph @ values
        if self.graph.weight is not None:
            return self.sum(self.senders(values))
        return self._layout.restore(_apply(self._layout.rows(values), self.graph, "neighbors"))


def dense(graph: Graph, dtype: torch.dtype | None = None) -> Tensor:
    """Return the adjacency matrix of a graph of either kind."""
    return graph.to_dense(dtype) if isinstance(graph, EdgeList) else graph


class _Layout(NamedTuple):
    """How values were laid out in rows, one for each individual of each frame."""

    front: torch.Size
    frames: torch.Size
    individuals: int

    def rows(self, values: Tensor) -> Tensor:
        """Number the individuals of all frames through: ``(node, front * feature)``.

        Dimensions in front of the frames, such as draws, share the edges and go to the features.
        """
        features = values.shape[-1]
        nodes, front = self.frames.numel() * self.individuals, self.front.numel()
        values = values.expand(*self.front, *self.frames, self.individuals, features)
        if not self.front:
            return values.reshape(nodes, features)
        return values.reshape(front, nodes, features).transpose(0, 1).reshape(nodes, -1)

    def open(self, rows: Tensor) -> Tensor:
        """Part ``(row, front * feature)`` into ``(row, front, feature)``, if anything is front."""
        if not self.front:
            return rows
        return rows.reshape(len(rows), self.front.numel(), rows.shape[-1] // self.front.numel())

    def restore(self, rows: Tensor) -> Tensor:
        """Return ``(*front, *frames, individual, feature)``."""
        nodes, front = len(rows), self.front.numel()
        features = rows.shape[-1] // front
        if self.front:
            rows = rows.reshape(nodes, front, features).transpose(0, 1)
        return rows.reshape(*self.front, *self.frames, self.individuals, features)


#: What is done to rows, and what to the gradient of the result: the product with a matrix of 0
#: and 1, and that with its transpose.
ADJOINTS = {
    "receivers": "sum",
    "sum": "receivers",
    "senders": "sum by sender",
    "sum by sender": "senders",
    "neighbors": "neighbors by sender",
    "neighbors by sender": "neighbors",
}


class _Linear(torch.autograd.Function):
    """One of :data:`ADJOINTS`, with a derivative as fast as itself.

    The derivatives of torch's own functions add up row by row, which takes several times longer.
    """

    @staticmethod
    def forward(rows: Tensor, graph: EdgeList, what: str) -> Tensor:
        if what == "receivers":
            return rows.index_select(0, graph.receiver)
        if what == "senders":
            return rows.index_select(0, graph.sender)
        if what == "sum":
            index, offsets = torch.arange(len(rows), device=rows.device), graph.offsets
        elif what == "neighbors":
            index, offsets = graph.sender, graph.offsets
        else:
            order, receiver, offsets = graph.by_sender
            index = order if what == "sum by sender" else receiver
        return functional.embedding_bag(index, rows, offsets, mode="sum", include_last_offset=True)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        _, ctx.graph, ctx.what = inputs

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        return _apply(gradient, ctx.graph, ADJOINTS[ctx.what]), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor, *_: None) -> Tensor:
        return _apply(tangent, ctx.graph, ctx.what)

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], rows: Tensor, graph: EdgeList, what: str
    ) -> tuple[Tensor, int]:
        # More rows at once are more columns.
        last = rows.movedim(in_dims[0], -1)
        done = _apply(last.flatten(1), graph, what)
        return done.reshape(len(done), *last.shape[1:]), last.dim() - 1


def _apply(rows: Tensor, graph: EdgeList, what: str) -> Tensor:
    """Apply one of :data:`ADJOINTS` to ``(row, feature)``."""
    result: Tensor = _Linear.apply(rows, graph, what)  # type: ignore[no-untyped-call]
    return result
