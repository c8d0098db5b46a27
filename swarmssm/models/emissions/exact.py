"""States that are observed as they are."""

from typing import ClassVar

import pyro.distributions as dist
import torch

from swarmssm.models.emissions.base import Emission, LinearizedEmission, Observes

__all__ = ["ExactEmission"]


class ExactEmission(Emission):
    r"""Positions and velocities without noise, :math:`x_i = z_i`.

    A model with it has no latent states: its site ``"states"`` is observed.
    """

    observes: Observes = "states"
    is_exact: ClassVar[bool] = True
    is_linear: ClassVar[bool] = True

    def forward(self, states: torch.Tensor) -> dist.Delta:
        """Return the distribution that has the states as its only values."""
        return dist.Delta(states, event_dim=1)

    def linearize(self, states: torch.Tensor) -> LinearizedEmission:
        """Return the identity, without noise."""
        eye = torch.eye(states.shape[-1], dtype=states.dtype, device=states.device)
        eye = eye.expand(*states.shape, states.shape[-1])
        return LinearizedEmission(states, eye, torch.zeros_like(eye))
