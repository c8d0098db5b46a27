"""Posteriors as labelled ArviZ objects, and log-likelihoods with the latent states summed out."""

from swarmssm.analysis.posterior.inference_data import to_inference_data
from swarmssm.analysis.posterior.log_likelihood import (
    pointwise_log_likelihood,
    window_log_likelihood,
)

__all__ = ["pointwise_log_likelihood", "to_inference_data", "window_log_likelihood"]
