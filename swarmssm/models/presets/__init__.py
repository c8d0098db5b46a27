"""Ready-made models: functions of the tracks' scales and plain options."""

from swarmssm.models.presets.boids_model import boids
from swarmssm.models.presets.edges import EDGES, with_edges
from swarmssm.models.presets.graph import graph_ssm
from swarmssm.models.presets.kernel_model import kernel
from swarmssm.models.presets.linear_model import linear
from swarmssm.models.presets.pair_forces_model import pair_forces
from swarmssm.models.presets.self_terms import state_space_model

__all__ = [
    "EDGES",
    "boids",
    "graph_ssm",
    "kernel",
    "linear",
    "pair_forces",
    "state_space_model",
    "with_edges",
]
