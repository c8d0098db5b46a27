"""What every emission offers: the distribution of what is seen of a state."""

from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple

import torch
from pyro.distributions import TorchDistribution
from pyro.nn import PyroModule
from torch.func import jvp

from swarmssm.models.distributions.moments import covariance_of

__all__ = ["Emission", "LinearizedEmission", "Observes", "slopes"]

#: Which features of the tracks are observed: positions alone, or velocities too.
Observes = Literal["positions", "states"]


class LinearizedEmission(NamedTuple):
    r"""Observations as an affine function of one's own state:
    :math:`x_i \approx m' + H (z_i - m_i) + \epsilon,\; \epsilon \sim N(0, R)`.

    Attributes
    ----------
    mean
        ``(..., individual, observation)``.
    jacobian
        H, ``(..., individual, observation, state)``.
    noise
        R, ``(..., individual, observation, observation)``.
    """

    mean: torch.Tensor
    jacobian: torch.Tensor
    noise: torch.Tensor


class Emission(PyroModule):  # type: ignore[misc]
    """Law of observation :math:`p(x_t | z_t)`, each individual for itself.

    A subclass writes :meth:`forward`. Parameters are given as in
    :class:`swarmssm.models.transitions.Transition`.
    """

    #: Which features of the tracks are observed.
    observes: Observes = "positions"
    #: Whether the states themselves are observed, so that none are latent.
    is_exact: ClassVar[bool] = False
    #: Whether the mean is an affine function of the state.
    is_linear: ClassVar[bool] = False

    @property
    def has_heavy_tails(self) -> bool:
        """Whether the noise is not Gaussian, so that :meth:`weights` differ from 1."""
        return False

    def forward(self, states: torch.Tensor) -> TorchDistribution:
        """Return the distribution of the observations.

        Parameters
        ----------
        states
            ``(..., individual, state)``.

        Returns
        -------
        Batch shape ``(..., individual)``, event shape ``(observation,)``.
        """
        raise TypeError(f"{type(self).__name__} must define forward(states)")

    def linearize(self, states: torch.Tensor) -> LinearizedEmission:
        """Linearise at given states, by forward-mode differentiation of the mean."""
        here = self(states)

        def mean_of(at: torch.Tensor) -> torch.Tensor:
            mean: torch.Tensor = self(at).mean
            return mean

        return LinearizedEmission(here.mean, slopes(mean_of, states), covariance_of(here))

    def weights(self, residuals: torch.Tensor) -> torch.Tensor:
        r"""Return how much observations weigh in a Gaussian filter that is run again.

        A robust filter divides the noise of :meth:`linearize` by these. 1 unless the emission has
        heavy tails.

        Parameters
        ----------
        residuals
            Observations less their means, ``(..., individual, observation)``.

        Returns
        -------
        ``(..., individual)``.
        """
        return torch.ones_like(residuals[..., 0])


def slopes(function: Callable[[torch.Tensor], torch.Tensor], states: torch.Tensor) -> torch.Tensor:
    """Return the derivative of a function of each individual's own state.

    Parameters
    ----------
    function
        From ``(..., individual, state)`` to ``(..., individual, out)``; that of i depends on the
        state of i alone.
    states
        Where, ``(..., individual, state)``.

    Returns
    -------
    ``(..., individual, out, state)``.
    """
    # One direction moves a feature of everybody at once: nobody's result mixes with another's.
    directions = torch.eye(states.shape[-1], dtype=states.dtype, device=states.device)
    columns = [jvp(function, (states,), (row.expand_as(states),))[1] for row in directions]
    return torch.stack(columns, dim=-1)
