"""Guides: variational posteriors over the latent states of a model."""

from swarmssm.inference.guides.base import SwarmGuide
from swarmssm.inference.guides.encoder import GraphEncoderGuide
from swarmssm.inference.guides.registry import GUIDES, find_guide

__all__ = ["GUIDES", "GraphEncoderGuide", "SwarmGuide", "find_guide"]
