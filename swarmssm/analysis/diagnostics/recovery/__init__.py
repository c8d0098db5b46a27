"""How many data it takes to find the parameters again."""

from swarmssm.analysis.diagnostics.recovery.settings import Setting
from swarmssm.analysis.diagnostics.recovery.study import recovery_study
from swarmssm.analysis.diagnostics.recovery.table import (
    recovery_needs,
    recovery_sentence,
    recovery_table,
)

__all__ = [
    "Setting",
    "recovery_needs",
    "recovery_sentence",
    "recovery_study",
    "recovery_table",
]
