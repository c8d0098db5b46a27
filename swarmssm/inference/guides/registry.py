"""Names of the guides of this package, and which one fits a model."""

from collections.abc import Callable
from typing import Any

from swarmssm.inference.guides.base import ParameterGuide
from swarmssm.inference.guides.encoder import GraphEncoderGuide
from swarmssm.inference.guides.linearized import LinearizedGuide
from swarmssm.inference.guides.markov import MarkovGuide
from swarmssm.inference.guides.smoothing import SmoothingGuide
from swarmssm.models import OneStepModel, StateSpaceModel, SwarmModel
from swarmssm.models.description import PartDescription, describe_part
from swarmssm.models.registry import Entry, find_builder

__all__ = ["GUIDES", "default_guide", "describe_guide", "find_guide"]

GUIDES: dict[str, Entry] = {
    "encoder": Entry(
        GraphEncoderGuide,
        "graph encoder of the thesis",
        "The thesis's encoder: a gated graph network and graph convolutions read each frame's "
        "states along its interaction graph, and give mean and variance of the latent states.",
    ),
    "linearized": Entry(
        LinearizedGuide,
        "Kalman smoother of the linearised model",
        "The states are summed out by a Kalman smoother about their own path (exactly, where the "
        "model is linear and normal); the parameters are normal about their mode, moved to where "
        "the ELBO is highest.",
    ),
    "markov": Entry(
        MarkovGuide,
        "Gaussian Markov chain",
        "Each state given the one before is normal, with means and spreads learned for each "
        "frame: what a smoother says, without its equations. The parameters have a guide of "
        "their own.",
    ),
    "parameters": Entry(
        ParameterGuide,
        "parameters alone",
        "The states are known as they are observed; only the parameters are inferred.",
    ),
    "smoothing": Entry(
        SmoothingGuide,
        "independent Gaussians about a smoother",
        "Each state is normal by itself, about the mean of a smoother that a network corrects: "
        "means are good, spreads too narrow. The parameters have a guide of their own.",
    ),
}


def find_guide(guide: str | Callable[..., Any]) -> Callable[..., Any]:
    """Return the function of a model and options that builds a guide.

    Parameters
    ----------
    guide
        A key of :data:`GUIDES`, ``module:attribute``, or the function itself; a class with a
        method ``for_model`` is built by this method.
    """
    return find_builder(guide, GUIDES, "guide", "for_model")


def describe_guide(guide: str | Callable[..., Any]) -> PartDescription:
    """Return what a guide is, with its options."""
    return describe_part(guide, GUIDES, find_guide(guide))


def default_guide(model: SwarmModel) -> str:
    """Return the name of the guide that is taken for a model where none is named.

    States that are observed exactly need none; those of a model whose unknowns are few numbers are
    summed out; those of a model with a network are drawn.
    """
    if isinstance(model, StateSpaceModel):
        if model.has_exact_states:
            return "parameters"
        return "markov" if model.has_networks else "linearized"
    return "encoder" if isinstance(model, OneStepModel) else "markov"
