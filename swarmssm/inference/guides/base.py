"""What every guide offers."""

from typing import Any, Self

import pyro.distributions as dist
import torch
from pyro.nn import PyroModule

from swarmssm.models import SwarmBatch, SwarmModel

__all__ = ["SwarmGuide"]


class SwarmGuide(PyroModule):  # type: ignore[misc]
    """A Pyro guide over the latent states of a :class:`swarmssm.models.SwarmModel`.

    A subclass writes :meth:`for_model`, which builds it, :meth:`forward`, a Pyro guide that samples
    the site ``"states"``, and :meth:`encode`, the same posterior for single frames.
    """

    @classmethod
    def for_model(cls, model: SwarmModel, **options: Any) -> Self:
        """Return a guide that fits the model's latent states."""
        raise TypeError(f"{cls.__name__} must define for_model(model, **options)")

    def forward(self, batch: SwarmBatch) -> None:
        """Sample the latent states of a batch of windows; to be run under a Pyro handler."""
        raise TypeError(f"{type(self).__name__} must define forward(batch)")

    def encode(self, states: torch.Tensor, adjacency: torch.Tensor) -> dist.Normal:
        """Return q(z | x, A) of each frame.

        Parameters
        ----------
        states
            Scaled, ``(..., individual, state)``.
        adjacency
            ``(..., individual, individual)``.

        Returns
        -------
        Normal of batch shape ``(..., individual, latent)``.
        """
        raise TypeError(f"{type(self).__name__} must define encode(states, adjacency)")
