"""What every generative model of a swarm offers."""

from typing import ClassVar, NamedTuple

import pyro.distributions as dist
import torch
from pyro.nn import PyroModule

from swarmssm.models.batch import SwarmBatch
from swarmssm.models.pyro_modules import keep_own_parameters

__all__ = ["NextStep", "OneStepModel", "SwarmModel"]


class SwarmModel(PyroModule):  # type: ignore[misc]
    """A Pyro model of windows of a swarm.

    A subclass writes :meth:`forward`, a Pyro model with the latent site ``"states"``. It is built
    by a callable that takes :class:`swarmssm.models.Scales` and named options with plain values,
    so that a run folder can build it again: a function, or a class with a ``for_scales`` method.
    """

    default_epochs: ClassVar[int] = 300
    #: How tracks are scaled for it unless the user says otherwise (:mod:`swarmssm.tracks.scaling`).
    scaler: ClassVar[str] = "minmax"

    def __init__(self, state_dim: int) -> None:
        super().__init__()
        self.state_dim = state_dim
        keep_own_parameters(self)

    @property
    def observes(self) -> str:
        """Which features of the tracks it is given: ``"positions"`` or ``"states"``."""
        return "states"

    def augmented(self, batch: SwarmBatch) -> SwarmBatch:
        """Return the windows as training should see them this time: themselves, or an image.

        A model that looks the same in a mirror learns from mirrored windows as well.
        """
        return batch

    def forward(self, batch: SwarmBatch) -> torch.Tensor | None:
        """Score a batch of windows; to be run under a Pyro handler."""
        raise TypeError(f"{type(self).__name__} must define forward(batch)")


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


class OneStepModel(SwarmModel):
    """A model whose latent states say the next step each for itself, with no dynamics of their own.

    A subclass also writes :meth:`decode`.
    """

    def decode(self, latent: torch.Tensor) -> NextStep:
        """Return the distribution of the next step.

        Parameters
        ----------
        latent
            Shape ``(..., individual, latent)``.
        """
        raise TypeError(f"{type(self).__name__} must define decode(latent)")
