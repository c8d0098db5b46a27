"""Laws of observation: what is seen of a latent state."""

from swarmssm.models.emissions.base import Emission, LinearizedEmission, Observes
from swarmssm.models.emissions.exact import ExactEmission
from swarmssm.models.emissions.neural import NeuralEmission
from swarmssm.models.emissions.noisy import NoisyEmission, Tails
from swarmssm.models.emissions.physical import PositionEmission, StateEmission
from swarmssm.models.emissions.student import DiagonalStudentT

__all__ = [
    "DiagonalStudentT",
    "Emission",
    "ExactEmission",
    "LinearizedEmission",
    "NeuralEmission",
    "NoisyEmission",
    "Observes",
    "PositionEmission",
    "StateEmission",
    "Tails",
]
