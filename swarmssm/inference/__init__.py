"""Guides, fitting, forecasting and checkpoints."""

if __name__ != "swarmssm.inference":
    raise ImportError(
        "Write swarmssm.inference: inference at the root of a checkout is but a link."
    )

from swarmssm.inference.collapsed_fit import fit_collapsed
from swarmssm.inference.collapsed_model import collapsed
from swarmssm.inference.fitted import Fit
from swarmssm.inference.fitting import fit
from swarmssm.inference.guides import (
    GUIDES,
    GraphEncoderGuide,
    LinearizedGuide,
    MarkovGuide,
    PathGuide,
    SmoothingGuide,
    find_guide,
)
from swarmssm.inference.held import fixed_transition
from swarmssm.inference.laplace_method import Laplace, laplace
from swarmssm.inference.settings import FitSettings
from swarmssm.inference.training import TrainingProgress

__all__ = [
    "GUIDES",
    "Fit",
    "FitSettings",
    "GraphEncoderGuide",
    "Laplace",
    "LinearizedGuide",
    "MarkovGuide",
    "PathGuide",
    "SmoothingGuide",
    "TrainingProgress",
    "collapsed",
    "find_guide",
    "fit",
    "fit_collapsed",
    "fixed_transition",
    "laplace",
]
