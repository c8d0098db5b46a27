"""Location and covariance of distributions over vectors, whatever they are called there."""

from typing import Any

import torch
from pyro.distributions import MultivariateStudentT, TorchDistribution

from swarmssm.models.distributions.kinematic import Kinematic

__all__ = ["covariance_of", "location_of"]


def location_of(following: TorchDistribution) -> torch.Tensor:
    """Return the location of next states; of bodies, that of their next velocities.

    Of a distribution that is limited in speed, the one before the limits.
    """
    if isinstance(following, Kinematic):
        return location_of(following.velocity)
    inner: Any = getattr(following, "base_dist", following)
    location: torch.Tensor = getattr(inner, "loc", None)  # type: ignore[assignment]
    return following.mean if location is None else location


def covariance_of(distribution: TorchDistribution) -> torch.Tensor:
    """Return the covariance matrices of a distribution over vectors."""
    # What Pyro calls the covariance of a Student's t is its squared scale.
    if isinstance(distribution, MultivariateStudentT):
        degrees = distribution.df[..., None, None]
        factor = torch.where(degrees > 2, degrees / (degrees - 2), torch.inf)
        scaled: torch.Tensor = distribution.covariance_matrix * factor
        return scaled
    if hasattr(distribution, "covariance_matrix"):
        matrix: torch.Tensor = distribution.covariance_matrix
        return matrix
    return torch.diag_embed(distribution.variance)
