from . import analysis, datasets, inference, models
from .analysis import plots
from .inference import Fit, fit
from .io import read
from .simulate import simulate_boids

__version__: str

__all__ = [
    "Fit",
    "__version__",
    "analysis",
    "datasets",
    "fit",
    "inference",
    "models",
    "plots",
    "read",
    "simulate_boids",
]
