"""Figures: they draw what is given and compute nothing. ``ax=None`` in, ``(fig, ax)`` out.

None of them touches pyplot: a figure is gone when nobody holds it. In space the axes have one
scale, and y points as in the recording's own picture.
"""

from swarmssm.analysis.plots.animation import animate, write_animation
from swarmssm.analysis.plots.calibration import (
    plot_calibration,
)
from swarmssm.analysis.plots.checks import (
    plot_check_overview,
    plot_order_parameters,
    plot_pit,
    plot_statistic,
    plot_statistics,
)
from swarmssm.analysis.plots.curves import plot_collective, plot_horizon_errors, plot_training
from swarmssm.analysis.plots.delays import plot_delays
from swarmssm.analysis.plots.forces import (
    plot_force_arrows,
    plot_force_magnitudes,
    plot_force_shares,
)
from swarmssm.analysis.plots.forecasts import plot_forecast, plot_forecast_over_time
from swarmssm.analysis.plots.gathered import plot_gathered_shares, plot_log_scores
from swarmssm.analysis.plots.graphs import plot_edge_accuracy, plot_graphs
from swarmssm.analysis.plots.inferred_edges import plot_edge_probabilities
from swarmssm.analysis.plots.influence import (
    plot_influence,
    plot_influence_matrix,
    plot_influence_network,
    plot_leadership,
)
from swarmssm.analysis.plots.kernels import plot_force_maps, plot_kernels, plot_modulation
from swarmssm.analysis.plots.latent_paths import plot_latent_paths
from swarmssm.analysis.plots.latents import (
    plot_latents,
    plot_rotated_axes,
    plot_sources,
)
from swarmssm.analysis.plots.model_graph import plot_model
from swarmssm.analysis.plots.presence import plot_presence
from swarmssm.analysis.plots.recovery import plot_recovery
from swarmssm.analysis.plots.scores import plot_forecast_coverage, plot_scores
from swarmssm.analysis.plots.style import save_figure
from swarmssm.analysis.plots.tracks import plot_tracks
from swarmssm.analysis.plots.trajectories import (
    plot_imitation,
    plot_random_starts,
    plot_snapshots,
    plot_trajectories,
)

__all__ = [
    "animate",
    "plot_calibration",
    "plot_check_overview",
    "plot_collective",
    "plot_delays",
    "plot_edge_accuracy",
    "plot_edge_probabilities",
    "plot_force_arrows",
    "plot_force_magnitudes",
    "plot_force_maps",
    "plot_force_shares",
    "plot_forecast",
    "plot_forecast_coverage",
    "plot_forecast_over_time",
    "plot_gathered_shares",
    "plot_graphs",
    "plot_horizon_errors",
    "plot_imitation",
    "plot_influence",
    "plot_influence_matrix",
    "plot_influence_network",
    "plot_kernels",
    "plot_latent_paths",
    "plot_latents",
    "plot_leadership",
    "plot_log_scores",
    "plot_model",
    "plot_modulation",
    "plot_order_parameters",
    "plot_pit",
    "plot_presence",
    "plot_random_starts",
    "plot_recovery",
    "plot_rotated_axes",
    "plot_scores",
    "plot_snapshots",
    "plot_sources",
    "plot_statistic",
    "plot_statistics",
    "plot_tracks",
    "plot_training",
    "plot_trajectories",
    "save_figure",
    "write_animation",
]
