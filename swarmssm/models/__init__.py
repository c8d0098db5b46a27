"""Generative models of swarms: distributions, layers, priors."""

from swarmssm.models.base import NextStep, SwarmModel
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.graph_vae import GraphVAE
from swarmssm.models.markov import MarkovChain, StepInputs
from swarmssm.models.registry import MODELS, find_model

__all__ = [
    "MODELS",
    "GraphVAE",
    "MarkovChain",
    "NextStep",
    "StepInputs",
    "SwarmBatch",
    "SwarmModel",
    "find_model",
]
