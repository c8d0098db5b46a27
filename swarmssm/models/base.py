"""What every generative model of a swarm offers."""

from typing import Any, ClassVar, NamedTuple

import pyro.distributions as dist
import torch
from pyro.nn import PyroModule

from swarmssm.models.batch import SwarmBatch

__all__ = ["NextStep", "SwarmModel"]


class NextStep(NamedTuple):
    """What a model says of the step after a latent state.

    Attributes
    ----------
    states
        Normal distribution of the scaled states, batch shape ``(..., individual, state)``.
    edge_logits
        Log-odds of the next adjacency, ``(..., individual, individual)``; the diagonal means
        nothing.
    """

    states: dist.Normal
    edge_logits: torch.Tensor


class SwarmModel(PyroModule):  # type: ignore[misc]
    """A Pyro model of windows of a swarm.

    A subclass writes :meth:`forward`, a Pyro model with the latent site ``"states"``, and
    :meth:`decode`, which says what one step of the latent path means for the next observation.
    Its constructor takes ``state_dim``, the number of features of an observed state, and named
    options with plain values, which it stores in :attr:`options` so that a run folder can build
    it again.
    """

    default_epochs: ClassVar[int] = 300

    def __init__(self, state_dim: int, **options: Any) -> None:
        super().__init__()
        self.state_dim = state_dim
        self.options = options

    def forward(self, batch: SwarmBatch) -> None:
        """Score a batch of windows; to be run under a Pyro handler."""
        raise TypeError(f"{type(self).__name__} must define forward(batch)")

    def decode(self, latent: torch.Tensor) -> NextStep:
        """Return the distribution of the next step.

        Parameters
        ----------
        latent
            Shape ``(..., individual, latent)``.
        """
        raise TypeError(f"{type(self).__name__} must define decode(latent)")
