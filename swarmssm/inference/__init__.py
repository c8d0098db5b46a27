"""Guides, fitting, forecasting and checkpoints."""

from swarmssm.inference.fitted import Fit
from swarmssm.inference.fitting import fit
from swarmssm.inference.guides import GUIDES, GraphEncoderGuide, find_guide
from swarmssm.inference.settings import FitSettings
from swarmssm.inference.training import Progress

__all__ = ["GUIDES", "Fit", "FitSettings", "GraphEncoderGuide", "Progress", "find_guide", "fit"]
