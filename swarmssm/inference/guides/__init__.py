"""Guides: variational posteriors over the latent states of a model."""
