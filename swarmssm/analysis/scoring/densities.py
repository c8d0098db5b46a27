"""Forecast densities of positions: draws of futures, or normals about what is expected."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from swarmssm import metrics
from swarmssm.metrics.log_score import (
    gaussian_log_score,
    mixture_log_score,
    moments_of_draws,
)
from swarmssm.tracks import Array

__all__ = ["Density", "DrawnDensity", "NormalDensity", "drawn_from_mixture"]


class Density(Protocol):
    """Forecast densities of positions, tracking noise included."""

    @property
    def mean(self) -> Array:
        """``(origin, step, individual, space)``."""

    def log_score(self, truth: Array) -> Array:
        """Return ``(origin, step, individual)``, nats per coordinate."""

    def crps(self, truth: Array) -> Array:
        """Return ``(origin, step, individual, space)``."""

    def energy_score(self, truth: Array) -> Array:
        """Return ``(origin, step, individual)``."""

    def intervals(self, levels: Sequence[float]) -> tuple[Array, Array]:
        """Return lower and upper ends ``(level, origin, step, individual, space)``."""


@dataclass(frozen=True)
class DrawnDensity:
    """Draws of positions as they may be observed.

    Attributes
    ----------
    draws
        ``(draw, origin, step, individual, space)``; infinite where a future diverged.
    mixture
        What each draw expects of its last step: ``location``, ``variance`` of the shape of
        ``draws``, and degrees of freedom, see :func:`swarmssm.metrics.mixture_log_score`; ``None``
        where the forecaster does not provide it.
    """

    draws: Array
    mixture: tuple[Array, Array, float] | None = None

    @functools.cached_property
    def mean(self) -> Array:
        """Mean of what the draws expect, infinite where one diverged."""
        values = self.draws if self.mixture is None else self.mixture[0]
        infinite = np.isinf(values)
        mean: Array = np.where(infinite, 0.0, values).mean(0)
        return np.where(infinite.any(0), np.inf, mean)

    def log_score(self, truth: Array) -> Array:
        """Return the score of the mixture, or of a normal with the draws' moments."""
        if self.mixture is not None:
            return mixture_log_score(truth, *self.mixture)
        # A forecast that diverged in one draw gives the observation no probability at all.
        broken = np.isinf(self.draws).any(axis=(0, -1))
        mean, covariance = moments_of_draws(np.where(np.isinf(self.draws), 0.0, self.draws))
        covariance[broken] = 0.0
        return gaussian_log_score(truth, mean, covariance)

    def crps(self, truth: Array) -> Array:
        """Return the fair score of the draws."""
        return metrics.ensemble_crps(truth, self.draws)

    def energy_score(self, truth: Array) -> Array:
        """Return the fair score of the draws."""
        return metrics.ensemble_energy_score(truth, self.draws)

    def intervals(self, levels: Sequence[float]) -> tuple[Array, Array]:
        """Return intervals between ranks of the draws."""
        return metrics.ensemble_intervals(self.draws, levels)


@dataclass(frozen=True)
class NormalDensity:
    """Normal densities.

    Attributes
    ----------
    mean
        ``(origin, step, individual, space)``.
    covariance
        ``(step, 1, space, space)``.
    """

    mean: Array
    covariance: Array

    @property
    def sd(self) -> Array:
        """Standard deviation of each coordinate, ``(step, 1, space)``."""
        deviations: Array = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        return deviations

    def log_score(self, truth: Array) -> Array:
        """Return the log-density."""
        return gaussian_log_score(truth, self.mean, self.covariance)

    def crps(self, truth: Array) -> Array:
        """Return the closed form."""
        return metrics.gaussian_crps(truth, self.mean, self.sd)

    def energy_score(self, truth: Array) -> Array:
        """Return the closed form, by quadrature."""
        return metrics.gaussian_energy_score(truth, self.mean, self.covariance)

    def intervals(self, levels: Sequence[float]) -> tuple[Array, Array]:
        """Return the intervals of each coordinate."""
        return metrics.gaussian_intervals(self.mean, self.sd, levels)


def drawn_from_mixture(
    location: Array, variance: Array, degrees: float, generator: np.random.Generator
) -> Array:
    """Draw one observation from each component of a mixture.

    Parameters
    ----------
    location, variance
        ``(..., space)``.
    degrees
        Of freedom of Student's t, whose variance is given; infinite for a normal.
    generator
        Of the draws.

    Returns
    -------
    Of the same shape; infinite where somebody present has no finite place.
    """
    noise = generator.standard_normal(location.shape)
    if not math.isinf(degrees):
        # A multivariate Student's t: all coordinates of a step share their scale.
        scale = (degrees - 2.0) / generator.chisquare(degrees, location.shape[:-1])
        noise *= np.sqrt(scale)[..., None]
    with np.errstate(invalid="ignore"):
        draws = location + np.sqrt(variance) * noise
    lost = np.isinf(draws) | (np.isnan(draws) & ~np.isnan(location))
    return np.where(lost, np.inf, draws)
