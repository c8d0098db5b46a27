"""Names of the ready-made guides."""

from typing import Any

from swarmssm.inference.guides.base import ParameterGuide
from swarmssm.inference.guides.encoder import GraphEncoderGuide
from swarmssm.inference.guides.linearized import LinearizedGuide
from swarmssm.inference.guides.markov import MarkovGuide
from swarmssm.inference.guides.smoothing import SmoothingGuide
from swarmssm.models import OneStepModel, StateSpaceModel, SwarmModel
from swarmssm.models.registry import find_part

__all__ = ["GUIDES", "default_guide", "find_guide"]

GUIDES: dict[str, Any] = {
    "encoder": GraphEncoderGuide,
    "linearized": LinearizedGuide,
    "markov": MarkovGuide,
    "parameters": ParameterGuide,
    "smoothing": SmoothingGuide,
}
#: Models whose few parameters are best fitted with the latent states summed out.
COLLAPSIBLE = ("boids", "kernel", "linear")


def find_guide(name: str) -> Any:
    """Return the class that builds a guide, by name or ``module:attribute``."""
    return find_part(name, GUIDES, "guide")


def default_guide(name: str, model: SwarmModel) -> str:
    """Return the name of the guide that is taken for a model if none is named."""
    if isinstance(model, OneStepModel):
        return "encoder"
    if isinstance(model, StateSpaceModel) and model.emission is None:
        return "parameters"
    return "linearized" if name in COLLAPSIBLE else "markov"
