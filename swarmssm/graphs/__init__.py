"""Interaction graphs: who is influenced by whom, from positions and headings.

``A[..., i, j]`` is true when individual i sees, and may be influenced by, individual j. Graphs are
directed, their diagonal is false, and an absent individual (NaN) has no edges.
"""

from swarmssm.graphs.headings import headings_from_velocity
from swarmssm.graphs.neighbors import (
    complete_graph,
    k_nearest_graph,
    nearest_distances,
    radius_graph,
)
from swarmssm.graphs.normalization import normalized_adjacency
from swarmssm.graphs.rules import (
    GraphRule,
    add_adjacency,
    body_length_of,
    default_rule,
    rule_of,
)
from swarmssm.graphs.visual import visual_field_graph

__all__ = [
    "GraphRule",
    "add_adjacency",
    "body_length_of",
    "complete_graph",
    "default_rule",
    "headings_from_velocity",
    "k_nearest_graph",
    "nearest_distances",
    "normalized_adjacency",
    "radius_graph",
    "rule_of",
    "visual_field_graph",
]
