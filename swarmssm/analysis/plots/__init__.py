"""Figures: they draw what is given and compute nothing. ``ax=None`` in, ``(fig, ax)`` out.

None of them touches pyplot: a figure is gone when nobody holds it. In space the axes have one
scale, and y grows upwards whatever the recording's own picture does.
"""

from swarmssm.analysis.plots.curves import plot_collective, plot_horizon_errors, plot_training
from swarmssm.analysis.plots.graphs import plot_edge_accuracy, plot_graphs
from swarmssm.analysis.plots.trajectories import (
    plot_imitation,
    plot_random_starts,
    plot_snapshots,
    plot_trajectories,
)

__all__ = [
    "plot_collective",
    "plot_edge_accuracy",
    "plot_graphs",
    "plot_horizon_errors",
    "plot_imitation",
    "plot_random_starts",
    "plot_snapshots",
    "plot_training",
    "plot_trajectories",
]
