"""What a fitted model says of frames it has not seen."""

from swarmssm.inference.prediction.base import Beginning, Kernels, Predictor, Trajectory, seeded
from swarmssm.inference.prediction.one_step import OneStepPredictor
from swarmssm.inference.prediction.state_space import StateSpacePredictor

__all__ = [
    "Beginning",
    "Kernels",
    "OneStepPredictor",
    "Predictor",
    "StateSpacePredictor",
    "Trajectory",
    "seeded",
]
