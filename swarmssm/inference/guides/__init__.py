"""Guides: variational posteriors over the latent states of a model."""

from swarmssm.inference.guides.base import OneStepGuide, ParameterGuide, PathGuide, SwarmGuide
from swarmssm.inference.guides.encoder import GraphEncoderGuide
from swarmssm.inference.guides.linearized import LinearizedGuide
from swarmssm.inference.guides.markov import MarkovGuide
from swarmssm.inference.guides.parameters import GlobalGuide
from swarmssm.inference.guides.registry import GUIDES, default_guide, describe_guide, find_guide
from swarmssm.inference.guides.smoothing import SmoothingGuide

__all__ = [
    "GUIDES",
    "GlobalGuide",
    "GraphEncoderGuide",
    "LinearizedGuide",
    "MarkovGuide",
    "OneStepGuide",
    "ParameterGuide",
    "PathGuide",
    "SmoothingGuide",
    "SwarmGuide",
    "default_guide",
    "describe_guide",
    "find_guide",
]
