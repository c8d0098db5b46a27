"""Recovery of known parameters: how much data it takes, and how good."""

from swarmssm.analysis.diagnostics.recovery.designs import Design
from swarmssm.analysis.diagnostics.recovery.table import Recovery

__all__ = ["Design", "Recovery"]
