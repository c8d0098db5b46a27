"""Where the graph of a step comes from: the data, a rule, or inference."""

from swarmssm.models.edges.dynamic import DynamicRelationalEdges
from swarmssm.models.edges.inferred import EdgeFilter, EdgeState, InferredEdges
from swarmssm.models.edges.latent import LatentEdges
from swarmssm.models.edges.observed import Edges, ObservedEdges
from swarmssm.models.edges.relational import RelationalEdges
from swarmssm.models.edges.types import EdgeTypes

__all__ = [
    "DynamicRelationalEdges",
    "EdgeFilter",
    "EdgeState",
    "EdgeTypes",
    "Edges",
    "InferredEdges",
    "LatentEdges",
    "ObservedEdges",
    "RelationalEdges",
]
