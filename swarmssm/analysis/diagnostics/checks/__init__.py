"""Posterior predictive checks: swarms simulated from the posterior beside the recording.

- :func:`check`: compare a recording with replicates by statistics, built-in or own.
- :func:`one_step_pit`: whether one-step forecasts are calibrated; :func:`loo_pit`, for frames that
  trained the model.
"""

from swarmssm.analysis.diagnostics.checks.arenas import arena_of
from swarmssm.analysis.diagnostics.checks.comparison import check
from swarmssm.analysis.diagnostics.checks.leave_one_out import loo_pit
from swarmssm.analysis.diagnostics.checks.observables import Axis
from swarmssm.analysis.diagnostics.checks.pit import ForecastCalibration, one_step_pit
from swarmssm.analysis.diagnostics.checks.result import PredictiveCheck
from swarmssm.analysis.diagnostics.checks.statistics import STATISTICS, Statistic
from swarmssm.analysis.diagnostics.checks.swarm import BinScales, ObservedSwarm

__all__ = [
    "STATISTICS",
    "Axis",
    "BinScales",
    "ForecastCalibration",
    "ObservedSwarm",
    "PredictiveCheck",
    "Statistic",
    "arena_of",
    "check",
    "loo_pit",
    "one_step_pit",
]
