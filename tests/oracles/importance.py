"""Evidence without linearisation: paths of a Gaussian smoother, weighed by the model itself."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.inference.filtering.kalman_filter import Filtered
from swarmssm.inference.filtering.paths import draw_paths, path_log_density
from swarmssm.models import StateSpaceModel, SwarmBatch

__all__ = ["WeightedPaths", "weigh_paths"]


@dataclass(frozen=True)
class WeightedPaths:
    """Draws from a Gaussian posterior, with how much more the model thinks of each.

    Attributes
    ----------
    paths
        ``(draw, batch, time, individual, state)``.
    log_weights
        ``(draw, batch)``: log of p(paths, observations) / q(paths).
    """

    paths: Tensor
    log_weights: Tensor

    @property
    def log_evidence(self) -> Tensor:
        """Logarithm of an unbiased estimate of the evidence of each window, ``(batch,)``."""
        return self.log_weights.logsumexp(0) - math.log(len(self.log_weights))

    @property
    def effective_size(self) -> Tensor:
        """Effective number of draws in each window, ``(batch,)``.

        A few of many: the evidence cannot be trusted.
        """
        return (2 * self.log_weights.logsumexp(0) - (2 * self.log_weights).logsumexp(0)).exp()

    @property
    def mean(self) -> Tensor:
        """Weighted mean of the paths, ``(batch, time, individual, state)``."""
        weights = self.log_weights.softmax(0)[..., None, None, None]
        return (weights * self.paths).sum(0)


def weigh_paths(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor],
    filtered: Filtered,
    num: int,
    seed: int | torch.Generator | None = None,
) -> WeightedPaths:
    r"""Weigh paths drawn from a Gaussian posterior with the model's own density.

    .. math:: w_k = \frac{p(z^k_{1:T})\, p(x_{1:T} \mid z^k_{1:T})}{q(z^k_{1:T})},
        \qquad z^k \sim q

    For a linear model all weights are the evidence. Elsewhere their mean is an unbiased estimate
    of it, whose spread tells how much linearising has cost; far better than a particle filter as
    long as q is near the posterior, and for as many individuals as the joint filter can take.

    Parameters
    ----------
    model, batch, values
        As in :func:`swarmssm.inference.filtering.extended_kalman`.
    filtered
        Gaussian filter of the same windows, best an iterated one
        (:attr:`oracles.iterated.Iterated.filtered`).
    num
        Number of paths for each window.
    seed
        Of the draws; absent, torch's own generator goes on.

    Raises
    ------
    InputError
        If next states have no density, as with limits of speed.
    ValueError
        If the model has no emission.
    """
    if model.emission.is_exact:
        raise ValueError("a model that observes states exactly has no hidden paths to weigh")
    if not model.transition.is_smooth:
        raise InputError(
            "weigh_paths: this transition gives some next states a probability of their own, so "
            "that paths drawn from a Gaussian cannot be weighed."
        )
    paths = draw_paths(filtered, num, seed)
    with model.fixed(values):
        seen = model.emission(paths).log_prob(batch.observations)
    seen = torch.where(batch.mask & batch.present, seen, 0.0).sum((-1, -2))
    prior = model.chain(batch, values).log_prob(paths)
    return WeightedPaths(paths, prior + seen - path_log_density(filtered, paths))
