"""Smoothers that linearise a model about their own result, again and again."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from swarmssm.inference.filtering.affine import AffineSwarm, Linearizer, Taylor
from swarmssm.inference.filtering.kalman_filter import (
    Filtered,
    Smoothed,
    filter_with,
    kalman,
    smooth,
)
from swarmssm.models import StateSpaceModel, SwarmBatch

__all__ = ["Iterated", "iterated_smoother"]


@dataclass(frozen=True)
class Iterated:
    """What an iterated smoother ends with.

    Attributes
    ----------
    filtered
        Filter of the last linear system: to be drawn from.
    smoothed
        Its smoothed moments.
    change
        ``(batch,)``: the farthest that a smoothed mean went in the last iteration, in posterior
        standard deviations of its own; 0 if there was none. A large one says that it has not
        converged.
    """

    filtered: Filtered
    smoothed: Smoothed
    change: Tensor

    @property
    def log_evidence(self) -> Tensor:
        """Evidence of each window under the last linear system, ``(batch,)``."""
        return self.filtered.log_evidence


def iterated_smoother(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor],
    iterations: int = 3,
    linearizer: Linearizer | None = None,
) -> Iterated:
    r"""Smooth a window, linearising all its frames about the smoothed states.

    It begins with a filter and smoother that linearise as they go. Each iteration linearises every
    step and frame about the smoothed means, in one batched call of the transition, and solves the
    linear system that comes of it exactly. With first-order linearisation this is Gauss-Newton for
    the most probable path (the iterated extended Kalman smoother of Bell, 1994, SIAM J. Optim.
    4:626); with sigma points the iterated posterior linearisation smoother of Garcia-Fernandez et
    al. (2017, IEEE Trans. Signal Process. 65:5560).

    The evidence needs no correction of its own at a fixed point :math:`\bar z`. Of any path it
    is true that :math:`p_{lin}(x) = p_{lin}(x, \bar z) / q_{lin}(\bar z)`. About
    :math:`\bar z` itself the linear system has the model's own density,
    :math:`p_{lin}(x, \bar z) = p(x, \bar z)`, and if that is the posterior mean too,
    :math:`q_{lin}(\bar z) = |2 \pi \Sigma|^{-1/2}`; what results,

    .. math:: \log p_{lin}(x) = \log p(x, \bar z) + \tfrac12 \log |2 \pi \Sigma|,

    is Laplace's approximation with the Gauss-Newton Hessian. The filter's own evidence, in which
    each frame is linearised about another path, is no such thing. (Where the noise of a
    transition depends on the states, that dependence is kept only through its value there.)

    Parameters
    ----------
    model, batch, values
        As in :func:`swarmssm.inference.filtering.extended_kalman`. Gradients flow through all
        iterations.
    iterations
        0 or more; each costs about as much as one filter.
    linearizer
        :class:`swarmssm.inference.filtering.Taylor` unless given;
        :class:`oracles.sigma_points.SigmaPoints` averages over the uncertainty of the
        states.

    Raises
    ------
    ValueError
        If ``iterations`` is negative or the model has no emission.
    WorkError
        If the covariance of an observation is not positive definite.
    """
    if iterations < 0:
        raise ValueError(f"iterations must be 0 or more, and it is {iterations}")
    linearizer = Taylor() if linearizer is None else linearizer
    filtered = filter_with(model, batch, values, linearizer)
    smoothed = smooth(filtered)
    change = torch.zeros_like(filtered.log_evidence)
    for _ in range(iterations):
        before = smoothed
        system = AffineSwarm.about(model, batch, values, before.mean, before.covariance, linearizer)
        filtered = kalman(system)
        smoothed = smooth(filtered)
        change = _distance(before, smoothed)
    return Iterated(filtered, smoothed, change)


def _distance(before: Smoothed, after: Smoothed) -> Tensor:
    """Return the largest change of a mean, in its own standard deviations."""
    with torch.no_grad():
        variance = after.covariance.diagonal(dim1=-2, dim2=-1)
        gap = (after.mean - before.mean).flatten(-2).abs()
        apart = torch.where(variance > 0, gap / variance.clamp_min(1e-30).sqrt(), 0.0)
        return apart.amax((-1, -2))
