"""Who moves whom, read from motion alone: networks that give each pair a type of edge."""

from swarmssm.models.relational.dynamic_edge_encoder import DynamicEdgeEncoder, EdgeMemory
from swarmssm.models.relational.edge_encoder import EdgeEncoder
from swarmssm.models.relational.edge_sampling import categorical_kl, sample_edges, sparse_logits
from swarmssm.models.relational.pair_embedding import PairEmbedding, pairs_of

__all__ = [
    "DynamicEdgeEncoder",
    "EdgeEncoder",
    "EdgeMemory",
    "PairEmbedding",
    "categorical_kl",
    "pairs_of",
    "sample_edges",
    "sparse_logits",
]
