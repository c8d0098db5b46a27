"""Scores of predictions, of groups and of graphs, as numpy arrays with NaN for the unknown.

- :mod:`swarmssm.metrics.prediction`: errors of predicted states, equations (4.1) to (4.3).
- :mod:`swarmssm.metrics.log_score`: how probable a forecast made what was observed.
- :mod:`swarmssm.metrics.probabilistic`: CRPS, energy score and intervals of a forecast.
- :mod:`swarmssm.metrics.collective`: cohesion, alignment and order of a group, (4.4) and (4.5).
- :mod:`swarmssm.metrics.edges`: a predicted interaction graph against the true one.
"""

from swarmssm.metrics.collective import (
    amd,
    avd,
    nearest_neighbor_distance,
    polarization,
    rotation,
    speeds,
)
from swarmssm.metrics.edges import edge_accuracy, edge_auc, edge_precision, edge_recall
from swarmssm.metrics.log_score import gaussian_log_score, mixture_log_score, moments_of_draws
from swarmssm.metrics.prediction import HorizonErrors, horizon_errors, mae, mse, step_length
from swarmssm.metrics.probabilistic import (
    ensemble_crps,
    ensemble_energy_score,
    ensemble_intervals,
    gaussian_crps,
    gaussian_energy_score,
    gaussian_intervals,
)

__all__ = [
    "HorizonErrors",
    "amd",
    "avd",
    "edge_accuracy",
    "edge_auc",
    "edge_precision",
    "edge_recall",
    "ensemble_crps",
    "ensemble_energy_score",
    "ensemble_intervals",
    "gaussian_crps",
    "gaussian_energy_score",
    "gaussian_intervals",
    "gaussian_log_score",
    "horizon_errors",
    "mae",
    "mixture_log_score",
    "moments_of_draws",
    "mse",
    "nearest_neighbor_distance",
    "polarization",
    "rotation",
    "speeds",
    "step_length",
]
