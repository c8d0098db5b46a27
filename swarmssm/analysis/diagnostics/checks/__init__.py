"""Posterior predictive checks: whole swarms from the posterior beside the one that was seen.

- :func:`check`: compare a recording with replicates by a list of statistics, ready-made or own.
- :func:`sentence`: what a check found, in plain words.
- :func:`one_step_pit`: where each sighting falls in its one-step forecast; :func:`loo_pit`, of
  frames that trained the model.
"""

from swarmssm.analysis.diagnostics.checks.arenas import arena_of
from swarmssm.analysis.diagnostics.checks.comparison import check
from swarmssm.analysis.diagnostics.checks.loo_pit import loo_pit
from swarmssm.analysis.diagnostics.checks.observables import Axis
from swarmssm.analysis.diagnostics.checks.pit import one_step_pit, pit_sentence
from swarmssm.analysis.diagnostics.checks.statistics import STATISTICS, Statistic
from swarmssm.analysis.diagnostics.checks.swarm import Scales, Swarm
from swarmssm.analysis.diagnostics.checks.verdicts import sentence

__all__ = [
    "STATISTICS",
    "Axis",
    "Scales",
    "Statistic",
    "Swarm",
    "arena_of",
    "check",
    "loo_pit",
    "one_step_pit",
    "pit_sentence",
    "sentence",
]
