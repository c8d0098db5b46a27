"""Ready-made models: functions of the tracks' scales and plain options."""

from swarmssm.models.ready.boids import boids
from swarmssm.models.ready.edges import EDGES, with_edges
from swarmssm.models.ready.graph import graph_ssm
from swarmssm.models.ready.kernel import kernel
from swarmssm.models.ready.linear import linear

__all__ = ["EDGES", "boids", "graph_ssm", "kernel", "linear", "with_edges"]
