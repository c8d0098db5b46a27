"""Generative models of swarms: distributions, layers, priors."""

if __name__ != "swarmssm.models":
    raise ImportError("Write swarmssm.models: models at the root is but a link.")

from swarmssm.models.base import NextStep, OneStepModel, SwarmModel
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.description import PartDescription, describe_model
from swarmssm.models.distributions.kinematic import Kinematic
from swarmssm.models.edges import (
    DynamicRelationalEdges,
    Edges,
    InferredEdges,
    LatentEdges,
    ObservedEdges,
    RelationalEdges,
)
from swarmssm.models.emissions import (
    Emission,
    ExactEmission,
    NeuralEmission,
    NoisyEmission,
    PositionEmission,
    StateEmission,
)
from swarmssm.models.graph_vae import GraphVAE
from swarmssm.models.initial import InitialStates
from swarmssm.models.markov import MarkovChain, StepInputs
from swarmssm.models.parameters import assign
from swarmssm.models.presets.pair_forces_model import pair_forces
from swarmssm.models.presets.self_terms import state_space_model
from swarmssm.models.priors import parameters_of, parse_distribution, with_priors
from swarmssm.models.registry import MODELS, find_model
from swarmssm.models.scales import Scales, scales_of
from swarmssm.models.simulation import Simulation
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions import KinematicTransition, LinearTransition, Transition

__all__ = [
    "MODELS",
    "DynamicRelationalEdges",
    "Edges",
    "Emission",
    "ExactEmission",
    "GraphVAE",
    "InferredEdges",
    "InitialStates",
    "Kinematic",
    "KinematicTransition",
    "LatentEdges",
    "LinearTransition",
    "MarkovChain",
    "NeuralEmission",
    "NextStep",
    "NoisyEmission",
    "ObservedEdges",
    "OneStepModel",
    "PartDescription",
    "PositionEmission",
    "RelationalEdges",
    "Scales",
    "Simulation",
    "StateEmission",
    "StateSpaceModel",
    "StepInputs",
    "SwarmBatch",
    "SwarmModel",
    "Transition",
    "assign",
    "describe_model",
    "find_model",
    "pair_forces",
    "parameters_of",
    "parse_distribution",
    "scales_of",
    "state_space_model",
    "with_priors",
]
