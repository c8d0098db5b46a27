r"""Integrals over Gaussian vectors whose precision is a band of blocks.

With blocks :math:`u_0, \dots, u_{K-1}` that are coupled to their next two,

.. math::
    Z = \int \exp\bigl(g^\top u - \tfrac12 u^\top \Lambda u\bigr) du, \qquad
    \log Z = \tfrac12 g^\top \Lambda^{-1} g - \tfrac12 \log \lvert\Lambda\rvert
             + \tfrac{n K}{2} \log 2 \pi,

the band's Cholesky factor is found in one loop forwards. Its derivatives are the mean
:math:`m = \Lambda^{-1} g` and, within the band, :math:`-\tfrac12 (m m^\top + \Sigma)`; the
blocks of :math:`\Sigma = \Lambda^{-1}` in the band come from one loop backwards (Takahashi's
recursion). A kinematic swarm of N individuals in the plane has blocks of 2 N positions, where a
Kalman filter has a state of 4 N.
"""

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from swarmssm.errors import WorkError

__all__ = [
    "Band",
    "BandMoments",
    "Factor",
    "band_mean",
    "band_moments",
    "factorize",
    "log_integral",
    "moments",
    "normalizer",
]


class Band(NamedTuple):
    r"""A precision and a linear term; block first.

    Attributes
    ----------
    diagonal
        :math:`\Lambda_{k,k}`, ``(block, batch, n, n)``.
    next
        :math:`\Lambda_{k+1,k}`, ``(block - 1, batch, n, n)``.
    after_next
        :math:`\Lambda_{k+2,k}`, ``(block - 2, batch, n, n)``.
    linear
        :math:`g`, ``(block, batch, n)``.
    """

    diagonal: Tensor
    next: Tensor
    after_next: Tensor
    linear: Tensor


class BandMoments(NamedTuple):
    """Mean, and covariances within the band, laid out as in :class:`Band`."""

    mean: Tensor
    diagonal: Tensor
    next: Tensor
    after_next: Tensor


class Factor(NamedTuple):
    """L of each diagonal block, and :math:`L^{-1}` times [the two blocks below it | g]."""

    lower: Tensor
    whitened: Tensor


def log_integral(band: Band) -> Tensor:
    """Return log Z, ``(batch,)``, once differentiable by all parts of the band.

    Raises
    ------
    WorkError
        If the precision is not positive definite.
    """
    value: Tensor = _LogIntegral.apply(*band)  # type: ignore[no-untyped-call]
    return value


def band_moments(band: Band) -> BandMoments:
    """Return mean and covariances, without gradient.

    Raises
    ------
    WorkError
        If the precision is not positive definite.
    """
    with torch.no_grad():
        return moments(factorize(band))


def band_mean(band: Band) -> Tensor:
    """Return the mean alone, ``(block, batch, n)``, without gradient."""
    with torch.no_grad():
        factor = factorize(band)
        solved = torch.linalg.solve_triangular(factor.lower.mT, factor.whitened, upper=True)
        size = solved.shape[-2]
        later = solved.new_zeros(solved.shape[1], 2 * size, 1)
        found = []
        for block in solved.flip(0):
            mean = torch.baddbmm(block[..., -1:], block[..., :-1], later, alpha=-1)
            later = torch.cat([mean, later[:, :size]], 1)
            found.append(mean)
        return torch.stack(found[::-1]).squeeze(-1)


def factorize(band: Band) -> Factor:
    """Return the Cholesky factor of the band, with the linear term carried along."""
    blocks, batch, size = band.linear.shape
    none = band.diagonal.new_zeros(1, batch, size, size)
    # Rows of a window: the block itself, the next, the one after; the linear term as last column.
    below = torch.cat([band.next, none])
    far = torch.cat([band.after_next, none, none])
    diagonal = band.diagonal
    linear = band.linear.unsqueeze(-1)
    lowers, whitened = [], []
    corner = diagonal[0]
    column = below[0]
    first, second = linear[0], linear[min(1, blocks - 1)]
    try:
        for k in range(blocks):
            lower = torch.linalg.cholesky(corner)
            right = torch.cat([column.mT, far[k].mT, first], -1)
            white = torch.linalg.solve_triangular(lower, right, upper=False)
            lowers.append(lower)
            whitened.append(white)
            if k == blocks - 1:
                break
            taken = white[..., :-1].mT @ white
            if k == 0:
                carried = diagonal[1]
            corner = carried - taken[:, :size, :size]
            column = below[k + 1] - taken[:, size:, :size]
            first = second - taken[:, :size, -1:]
            if k + 2 < blocks:
                carried = diagonal[k + 2] - taken[:, size:, size:-1]
                second = linear[k + 2] - taken[:, size:, -1:]
    except torch.linalg.LinAlgError as error:  # type: ignore[attr-defined]
        raise WorkError(
            "The precision of the paths is not positive definite: at some parameters the motion "
            "has next to no noise, as noise in proportion to speed has where somebody rests. Take "
            "noise=additive, or priors that keep to larger noise."
        ) from error
    return Factor(torch.stack(lowers), torch.stack(whitened))


def normalizer(factor: Factor) -> Tensor:
    """Return log Z, ``(batch,)``."""
    blocks, _, size, _ = factor.lower.shape
    spread = factor.lower.diagonal(dim1=-2, dim2=-1).log().sum((0, -1))
    quadratic = factor.whitened[..., -1].square().sum((0, -1))
    return 0.5 * quadratic - spread + 0.5 * size * blocks * math.log(2.0 * math.pi)


def moments(factor: Factor) -> BandMoments:
    """Run Takahashi's recursion backwards."""
    solved = torch.linalg.solve_triangular(factor.lower.mT, factor.whitened, upper=True)
    own = torch.cholesky_inverse(factor.lower)
    blocks, batch, size = own.shape[:3]
    gains = solved[..., :-1]
    # Covariance of the next two blocks, and their mean as last column.
    later = own.new_zeros(batch, 2 * size, 2 * size + 1)
    means, diagonal, crossed = [], [], []
    for k in reversed(range(blocks)):
        gain = gains[k]
        cross = gain @ later  # minus the covariance with the next two | what to take off the mean
        mean = solved[k, ..., -1:] - cross[..., -1:]
        # What is not symmetric in rounding errors would grow from block to block.
        covariance = torch.baddbmm(own[k], cross[..., :-1], gain.mT)
        covariance = 0.5 * (covariance + covariance.mT)
        means.append(mean)
        diagonal.append(covariance)
        crossed.append(cross[..., :-1])
        near = cross[..., :size]
        later = torch.cat(
            [
                torch.cat([covariance, -near, mean], -1),
                torch.cat([-near.mT, later[:, :size, :size], later[:, :size, -1:]], -1),
            ],
            1,
        )
    cross = torch.stack(crossed[::-1])
    return BandMoments(
        torch.stack(means[::-1]).squeeze(-1),
        torch.stack(diagonal[::-1]),
        -cross[:-1, ..., :size].mT,
        -cross[:-2, ..., size:].mT,
    )


class _LogIntegral(torch.autograd.Function):
    """log Z as a function of the band."""

    @staticmethod
    def forward(ctx: Any, *parts: Tensor) -> Tensor:
        factor = factorize(Band(*parts))
        ctx.save_for_backward(*factor)
        return normalizer(factor)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, weight: Tensor) -> tuple[Any, ...]:
        found = moments(Factor(*ctx.saved_tensors))
        mean, scale = found.mean, -weight[:, None, None]
        column, row = mean.unsqueeze(-1), mean.unsqueeze(-2)
        return (
            0.5 * scale * torch.addcmul(found.diagonal, column, row),
            scale * torch.addcmul(found.next, column[1:], row[:-1]),
            scale * torch.addcmul(found.after_next, column[2:], row[:-2]),
            weight[:, None] * mean,
        )
