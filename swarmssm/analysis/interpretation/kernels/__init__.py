"""What a neighbour at each distance does, with bands."""

from swarmssm.analysis.interpretation.kernels.posterior import interaction_kernels
from swarmssm.analysis.interpretation.kernels.truth import kernel_agreement, true_kernels

__all__ = [
    "interaction_kernels",
    "kernel_agreement",
    "true_kernels",
]
