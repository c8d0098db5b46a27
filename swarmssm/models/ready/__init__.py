"""Ready-made models: functions of the tracks' scales and plain options."""

from swarmssm.models.ready.boids import boids
from swarmssm.models.ready.graph import graph_ssm
from swarmssm.models.ready.kernel import kernel
from swarmssm.models.ready.linear import linear

__all__ = ["boids", "graph_ssm", "kernel", "linear"]
