"""What a fitted model says of frames it has not seen."""

from swarmssm.inference.prediction.base import (
    InitialCondition,
    PredictiveMixture,
    Predictor,
    Trajectory,
    seeded,
)
from swarmssm.inference.prediction.one_step import OneStepPredictor
from swarmssm.inference.prediction.state_space import StateSpacePredictor

__all__ = [
    "InitialCondition",
    "OneStepPredictor",
    "PredictiveMixture",
    "Predictor",
    "StateSpacePredictor",
    "Trajectory",
    "seeded",
]
