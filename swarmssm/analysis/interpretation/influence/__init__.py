"""Who moves whom, and whether anybody leads."""

from swarmssm.analysis.interpretation.influence.delays import leadership_delays
from swarmssm.analysis.interpretation.influence.leaders import find_isolated, find_leader
from swarmssm.analysis.interpretation.influence.posterior import influence

__all__ = [
    "find_isolated",
    "find_leader",
    "influence",
    "leadership_delays",
]
