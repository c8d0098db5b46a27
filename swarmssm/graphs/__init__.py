"""Interaction graphs: who is influenced by whom, from positions and headings.

``A[..., i, j]`` is true when individual i sees, and may be influenced by, individual j. Graphs are
directed, their diagonal is false, and an absent individual (NaN) has no edges.
"""

from swarmssm.graphs.edge_list import EdgeList
from swarmssm.graphs.headings import headings_from_velocity
from swarmssm.graphs.messages import (
    Graph,
    Pairs,
    degree,
    dense,
    neighbor_mean,
    neighbor_sum,
    pair_sum,
)
from swarmssm.graphs.neighbors import (
    complete_graph,
    k_nearest_graph,
    nearest_distances,
    radius_graph,
)
from swarmssm.graphs.normalization import normalized_adjacency
from swarmssm.graphs.representation import (
    between,
    edges_by_rule,
    graph_by_rule,
    represent,
    take_frames,
)
from swarmssm.graphs.rules import (
    GraphRule,
    add_adjacency,
    body_length_of,
    default_rule,
    rule_of,
)
from swarmssm.graphs.visual import visual_field_graph

__all__ = [
    "EdgeList",
    "Graph",
    "GraphRule",
    "Pairs",
    "add_adjacency",
    "between",
    "body_length_of",
    "complete_graph",
    "default_rule",
    "degree",
    "dense",
    "edges_by_rule",
    "graph_by_rule",
    "headings_from_velocity",
    "k_nearest_graph",
    "nearest_distances",
    "neighbor_mean",
    "neighbor_sum",
    "normalized_adjacency",
    "pair_sum",
    "radius_graph",
    "represent",
    "rule_of",
    "take_frames",
    "visual_field_graph",
]
