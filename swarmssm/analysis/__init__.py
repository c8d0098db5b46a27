"""Labelled posteriors, forces, checks, comparison, plots and the report."""

from swarmssm.analysis.evaluate import evaluate
from swarmssm.analysis.evaluation import Evaluation

__all__ = ["Evaluation", "evaluate"]
