"""Which forces act on whom: draws of their posterior, and maps of a focal individual."""

from swarmssm.analysis.interpretation.forces.maps import (
    default_extent,
    force_map,
    force_map_agreement,
    force_maps,
    raw_force_map,
)
from swarmssm.analysis.interpretation.forces.posterior import TERMS, force_summary, posterior_forces
from swarmssm.analysis.interpretation.forces.truth import force_agreement, true_forces

__all__ = [
    "TERMS",
    "default_extent",
    "force_agreement",
    "force_map",
    "force_map_agreement",
    "force_maps",
    "force_summary",
    "posterior_forces",
    "raw_force_map",
    "true_forces",
]
