"""What the latent states of a model hold of the forces."""

from swarmssm.analysis.interpretation.latents.alignment import (
    compare_latents,
    latent_force_alignment,
)

__all__ = [
    "compare_latents",
    "latent_force_alignment",
]
