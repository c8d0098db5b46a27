"""Generative models of swarms: distributions, layers, priors."""
