"""Whether a graph is a matrix of pairs or a list of edges: decided here, and nowhere else."""

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.graphs.edge_list import EdgeList
from swarmssm.graphs.messages import Graph
from swarmssm.graphs.neighbors import (
    TREE_FROM,
    check_positions,
    k_nearest_pairs,
    portions,
    radius_pairs,
)
from swarmssm.graphs.rules import GraphRule

__all__ = ["between", "edges_by_rule", "graph_by_rule", "represent", "suits_list", "take_frames"]

#: Up to this many individuals a matrix of pairs costs little, and its shape does not change from
#: batch to batch, which compiled code likes.
MATRIX_UP_TO = 32
#: Share of all pairs that are edges, from which a matrix is as fast for messages between pairs.
MATRIX_FROM_DENSITY = 0.25


def suits_list(individuals: int, density: float) -> bool:
    """Return whether a graph is better kept as a list of edges than as a matrix of pairs.

    Parameters
    ----------
    individuals
        Their number in a frame.
    density
        Edges as a share of all pairs ``individuals ** 2``, over all frames.
    """
    return individuals > MATRIX_UP_TO and density < MATRIX_FROM_DENSITY


def represent(graph: Graph, dtype: torch.dtype | None = None) -> Graph:
    """Return the same graph as a matrix or as a list of edges, whichever suits it.

    Parameters
    ----------
    graph
        Adjacency ``(..., individual, individual)`` of any dtype, or a list of edges.
    dtype
        Of the matrix, if it becomes or stays one; absent, that of the adjacency or of the weights,
        or torch's default.
    """
    if isinstance(graph, EdgeList):
        pairs = graph.num_frames * graph.individuals**2
        if suits_list(graph.individuals, graph.num_edges / max(pairs, 1)):
            return graph
        if dtype is None and graph.weight is None:
            dtype = torch.get_default_dtype()
        return graph.to_dense(dtype)
    individuals = graph.shape[-1]
    if individuals > MATRIX_UP_TO:
        density = int(torch.count_nonzero(graph)) / max(graph.numel(), 1)
        if suits_list(individuals, density):
            return EdgeList.from_dense(graph)
    return graph if dtype is None else graph.to(dtype)


def graph_by_rule(
    rule: GraphRule,
    positions: Tensor,
    velocities: Tensor | None = None,
    dtype: torch.dtype | None = None,
) -> Graph:
    """Return the graph of each frame, as a matrix or as a list of edges, whichever suits it.

    Parameters
    ----------
    rule
        How the graph follows from the states.
    positions
        Shape ``(..., individual, space)``, NaN = absent.
    velocities
        Same shape; a visual graph takes the headings from it.
    dtype
        Of the matrix, if it becomes one; absent, that of the positions.

    Returns
    -------
    Graph of leading shape ``(...)``. No gradient flows through it.

    Raises
    ------
    InputError
        As the rule itself does.
    """
    dtype = positions.dtype if dtype is None else dtype
    if positions.shape[-2] <= MATRIX_UP_TO or rule.kind == "complete":
        return rule(positions, velocities).to(dtype)
    return represent(edges_by_rule(rule, positions, velocities), dtype)


def edges_by_rule(rule: GraphRule, positions: Tensor, velocities: Tensor | None = None) -> EdgeList:
    """Return the list of edges of each frame.

    The same graph as ``rule(positions, velocities)``. Of large swarms, those within a radius and
    the k nearest are found by a k-d tree for each frame, and a matrix of pairs is never built;
    visual and complete graphs pass through one, a few frames at a time.

    Parameters
    ----------
    rule, positions, velocities
        As in :func:`graph_by_rule`.

    Returns
    -------
    Edges of leading shape ``(...)``.

    Raises
    ------
    InputError
        As the rule itself does.
    """
    check_positions(positions)
    if velocities is not None and velocities.shape != positions.shape:
        raise InputError(
            f"velocities: their shape must be that of the positions, {tuple(positions.shape)}, and "
            f"it is {tuple(velocities.shape)}."
        )
    *leading, individuals, space = positions.shape
    number = torch.Size(leading).numel()
    frames = positions.detach().reshape(number, individuals, space)
    by_tree = individuals > TREE_FROM and rule.kind in ("radius", "k-nearest")
    if by_tree:
        found = _by_tree(rule, frames)
    else:
        rows = None if velocities is None else velocities.detach().reshape(frames.shape)
        found = _by_matrix(rule, frames, rows)
    parts = [(torch.empty(0, dtype=torch.long), torch.empty(0, dtype=torch.long)), *found]
    receiver, sender = (torch.cat(ends).to(positions.device) for ends in zip(*parts, strict=True))
    return EdgeList(receiver, sender, tuple(leading), individuals)


def between(graph: Graph, present: Tensor) -> Graph:
    """Return the edges both of whose ends are there.

    Parameters
    ----------
    graph
        Of leading shape ``(...)``.
    present
        ``(..., individual)`` of bool.
    """
    if isinstance(graph, EdgeList):
        return graph.between(present)
    both = present.unsqueeze(-1) & present.unsqueeze(-2)
    return graph * both.to(graph.dtype)


def take_frames(graph: Graph, index: Tensor) -> Graph:
    """Return some of the frames, as often as they are named.

    Parameters
    ----------
    graph
        Of any leading shape, whose frames are numbered through.
    index
        Numbers of frames, of any shape; -1 is a frame without edges, as padding needs it.

    Returns
    -------
    Graph of leading shape ``index.shape``.
    """
    if isinstance(graph, EdgeList):
        return graph.frames(index)
    known = (index >= 0).unsqueeze(-1).unsqueeze(-1)
    rows = graph.flatten(0, -3) if graph.dim() > 2 else graph.unsqueeze(0)
    return rows[index.clamp(min=0)] * known.to(graph.dtype)


def _by_matrix(
    rule: GraphRule, positions: Tensor, velocities: Tensor | None
) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield the edges of a few frames at a time, from matrices of pairs."""
    individuals = positions.shape[-2]
    for rows in portions(len(positions), individuals**2):
        part = rule(positions[rows], None if velocities is None else velocities[rows])
        edges = EdgeList.from_dense(part)
        first = rows.start * individuals
        yield edges.receiver.cpu() + first, edges.sender.cpu() + first


def _by_tree(rule: GraphRule, positions: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield the edges of one frame at a time, from a k-d tree."""
    individuals = positions.shape[-2]
    for frame, points in enumerate(positions.cpu().numpy()):
        if rule.kind == "radius" and rule.radius is not None:
            i, j = radius_pairs(points, rule.radius, rule.box)
        else:
            i, j = k_nearest_pairs(points, rule.k or 1)
        order = np.argsort(i * individuals + j)
        first = frame * individuals
        yield torch.from_numpy(i[order] + first), torch.from_numpy(j[order] + first)
