r"""Exact smoothing of one individual: what is seen later, as a Gaussian message at each frame.

Given the state before, the posterior of the next state needs what is seen from there on, and
nothing else: :math:`p(z_t | z_{t-1}, x) \propto p(z_t | z_{t-1})\, p(x_{t:T} | z_t)`. The second
factor, a Gaussian in information form, comes from one recursion backwards in time. All individuals
of all windows go through it together.

States are deviations from a reference path, so that nothing is lost to rounding where positions are
large and the noise is small.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

__all__ = [
    "Chain",
    "Law",
    "NeighborTerm",
    "Observations",
    "Spread",
    "Start",
    "Steps",
    "normal_terms",
    "presence_transitions",
]

HALF_LOG_TWO_PI = 0.9189385332046727

#: From a step and the deviations before it, ``(batch, individual, state)``, to what neighbours add
#: to the mean of the free features, ``(batch, individual, free)``.
NeighborTerm = Callable[[int, Tensor], Tensor]


class Observations(NamedTuple):
    """Independent Gaussian sightings of each feature of a state.

    Attributes
    ----------
    location
        As a deviation from the reference, ``(batch, time, individual, state)``.
    precision
        Same shape; 0 where nothing was seen.
    """

    location: Tensor
    precision: Tensor


class Law(NamedTuple):
    r"""Affine law of one individual, :math:`\mu_t = J_t z_{t-1} + u_t`, noise of covariance
    :math:`Q_t`, for the free features of the next state.

    Attributes
    ----------
    drift
        u, ``(batch, time - 1, individual, free)``.
    noise
        Q: variances ``(batch, time - 1, individual, free)`` in a :class:`KinematicChain`, lower
        triangular square roots ``(..., free, free)`` in a :class:`FullChain`.
    gains
        J: what position and velocity of an axis do to its next velocity, each broadcasting against
        ``drift``; or one matrix that broadcasts against ``(..., free, state)``.
    """

    drift: Tensor
    noise: Tensor
    gains: tuple[Tensor, ...]


class Start(NamedTuple):
    """Mean, as a deviation from the reference, and variance of a first state, each
    ``(batch, time, individual, state)`` or broadcasting to it.
    """

    mean: Tensor
    variance: Tensor


@dataclass(frozen=True)
class Steps(ABC):
    """Conditional distributions of each free feature, given the state before.

    Attributes
    ----------
    stays, comes
        ``(batch, time - 1, individual)`` who is there at both ends of a step, and
        ``(batch, time, individual)`` who is there for the first time; of bool.
    """

    persists: Tensor
    enters: Tensor

    @abstractmethod
    def first(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return first states for each frame, from standard noise ``(batch, time, individual,
        state)``, and the logarithm of the determinant of their scale ``(batch, time, individual)``.
        """

    @abstractmethod
    def scaled(self, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return standard noise ``(batch, time - 1, individual, free)`` at its scale, and the
        logarithm of the determinant of the scale.
        """

    @abstractmethod
    def walk(self, first: Tensor, shift: Tensor | None, pull: NeighborTerm | None) -> Tensor:
        """Return the path, step by step.

        Parameters
        ----------
        first
            ``(batch, time, individual, state)``, taken where an individual comes.
        shift
            Added to the means of the free features; absent, the mean path is returned.
        pull
            What neighbours add.
        """

    def draw(
        self, log_scale_correction: Tensor, free_stretch: Tensor, pull: NeighborTerm | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return a path ``(batch, time, individual, state)`` and its log-density ``(batch,)``.

        Parameters
        ----------
        stretch, free_stretch
            Logarithms of factors by which the noise of first states ``(batch, time, individual,
            state)``, and of free features ``(batch, time - 1, individual, free)``, is larger.
        pull
            What neighbours add.
        """
        first_noise, noise = torch.randn_like(log_scale_correction), torch.randn_like(free_stretch)
        first, first_size = self.first(log_scale_correction.exp() * first_noise)
        shift, size = self.scaled(free_stretch.exp() * noise)
        path = self.walk(first, shift, pull)
        total = normal_terms(first_noise, first_size + log_scale_correction.sum(-1), self.enters)
        return path, total + normal_terms(noise, size + free_stretch.sum(-1), self.persists)

    def mean(self, like: Tensor) -> Tensor:
        """Return the mean path; ``like`` has its shape, and says type and device."""
        first, _ = self.first(torch.zeros_like(like))
        return self.walk(first, None, None)


def normal_terms(noise: Tensor, log_scale: Tensor, there: Tensor) -> Tensor:
    """Return the log-density ``(batch,)`` of what was made from standard noise, where ``there``.

    Parameters
    ----------
    noise
        ``(batch, time, individual, feature)``.
    log_scale
        Logarithm of the determinant of the scale, ``(batch, time, individual)``.
    there
        Same shape, of bool.
    """
    density = -0.5 * noise.square().sum(-1) - noise.shape[-1] * HALF_LOG_TWO_PI - log_scale
    return torch.where(there, density, 0.0).sum((-1, -2))


class Chain(ABC):
    """A kind of law for which messages can be passed backwards.

    Attributes
    ----------
    state_dim, noise_dim
        Features of a state, and those of them that noise moves.
    """

    state_dim: int
    noise_dim: int

    @abstractmethod
    def steps(self, sightings: Observations, law: Law, start: Start, present: Tensor) -> Steps:
        """Return the conditional distributions of each step given all that is seen from it on.

        Parameters
        ----------
        sightings, law, start
            What is seen, how individuals move, and where they come.
        present
            ``(batch, time, individual)`` of bool.
        """

    def mean(self, sightings: Observations, law: Law, start: Start, present: Tensor) -> Tensor:
        """Return the mean path ``(batch, time, individual, state)``, that of :meth:`steps`."""
        return self.steps(sightings, law, start, present).mean(sightings.location)

    @abstractmethod
    def spread(self, sightings: Observations, law: Law, start: Start, present: Tensor) -> "Spread":
        """Return the scales of a posterior without correlations between features and frames.

        For a linear law these are the optimal ones: the inverse square roots of the diagonal of
        the path's precision, in the coordinates first state and free features.
        """

    @abstractmethod
    def join(self, first: Tensor, free: Tensor, present: Tensor) -> Tensor:
        """Return the path of given first states, taken where an individual comes, and free
        features of all later ones, ``(batch, time, individual, state)``.

        First states are those of all frames; or of the first alone, if nobody comes later.
        """


class Spread(NamedTuple):
    """Scales of independent coordinates: of a first state ``(batch, time, individual, state)``, if
    the individual comes in that frame, and of free features ``(batch, time - 1, individual,
    free)``.
    """

    first: Tensor
    free: Tensor


def presence_transitions(present: Tensor) -> tuple[Tensor, Tensor]:
    """Return who stays in each step and who comes in each frame."""
    persists = present[:, 1:] & present[:, :-1]
    enters = present.clone()
    enters[:, 1:] &= ~present[:, :-1]
    return persists, enters
