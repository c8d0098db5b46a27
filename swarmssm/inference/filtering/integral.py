r"""The integral over paths of a linearised kinematic swarm, with a hand-written derivative.

With :math:`\delta_k` the displacement of all positions of frame k, the log-density of a path and
its observations about a reference is a sum of terms of frames,

.. math:: h_t^\top d_t - \tfrac12 d_t^\top J_t d_t, \qquad d_t = [\delta_t, \delta_{t-1}],

each individual's own, and of terms of steps :math:`\log N(\rho_t; 0, Q_t)`,

.. math:: \rho_t = r_t + C_t d_t + \delta_{t+1} / dt .

Derivatives of the integral are means over the Gaussian posterior (Fisher's identity): of
:math:`-Q^{-1} \rho` by r, of :math:`-Q^{-1} \rho\, d^\top` by C, of
:math:`\tfrac12 Q^{-1} (\rho \rho^\top - Q) Q^{-1}` by Q, and of :math:`d` and
:math:`-\tfrac12 d d^\top` by h and J. They need moments within the band alone.
"""

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from swarmssm.inference.filtering.banded import (
    Band,
    BandMoments,
    Factor,
    factorize,
    moments,
    normalizer,
)

__all__ = ["PathTerms", "assemble", "own_blocks_of", "path_integral"]


class PathTerms(NamedTuple):
    """Terms of frames and steps; ``joint = individual * space``.

    Attributes
    ----------
    linear, curvature
        h and J: ``(batch, time, individual, 2 * space)`` and a square matrix more.
    residual, slopes
        r ``(batch, time - 1, joint)`` and C ``(batch, time - 1, joint, 2 * joint)``; 0 for
        individuals that do not stay.
    noise
        Q, ``(batch, time - 1, individual, space, space)``.
    stays
        ``(batch, time - 1, individual)`` of bool.
    idle
        Which positions have no part, ``(batch, time + 1, joint)`` of bool; ``None`` if all have.
    dt
        Seconds.
    """

    linear: Tensor
    curvature: Tensor
    residual: Tensor
    slopes: Tensor
    noise: Tensor
    persists: Tensor
    idle: Tensor | None
    dt: float


def path_integral(terms: PathTerms) -> Tensor:
    """Return the log of the integral over all positions, ``(batch,)``, once differentiable.

    Raises
    ------
    WorkError
        If the precision is not positive definite.
    """
    *tensors, persists, idle, dt = terms
    value: Tensor = _PathIntegral.apply(persists, idle, dt, *tensors)  # type: ignore[no-untyped-call]
    return value


def assemble(terms: PathTerms) -> tuple[Band, Tensor]:
    """Return the band, and the log-density of all steps at the reference ``(batch,)``."""
    batch, times, individuals, double = terms.linear.shape
    space, dt = double // 2, terms.dt
    size = individuals * space
    like = terms.linear
    diagonal = like.new_zeros(times + 1, batch, size, size)
    near = like.new_zeros(times, batch, size, size)
    far = like.new_zeros(times - 1, batch, size, size)
    linear = like.new_zeros(times + 1, batch, size)
    curvature, own = terms.curvature.transpose(0, 1), terms.linear.transpose(0, 1)
    _own_blocks(diagonal, individuals)[1:] += curvature[..., :space, :space]
    _own_blocks(diagonal, individuals)[:-1] += curvature[..., space:, space:]
    _own_blocks(near, individuals)[:] += curvature[..., :space, space:]
    linear[1:] += own[..., :space].flatten(-2)
    linear[:-1] += own[..., space:].flatten(-2)
    if terms.idle is not None:
        diagonal.diagonal(dim1=-2, dim2=-1).add_(terms.idle.transpose(0, 1))
    if times == 1:
        return Band(diagonal, near, far, linear), like.new_zeros(batch)
    precision, spread = _precision(terms)
    pull = _apply(precision, torch.cat([terms.slopes, terms.residual.unsqueeze(-1)], -1))
    square = (terms.slopes.mT @ pull).transpose(0, 1)
    pull = pull.transpose(0, 1)
    diagonal[:-2] += square[..., size:, size:-1]
    diagonal[1:-1] += square[..., :size, :size]
    _own_blocks(diagonal, individuals)[2:] += precision.transpose(0, 1) / dt**2
    near[:-1] += square[..., :size, size:-1]
    near[1:] += pull[..., :size] / dt
    far += pull[..., size:-1] / dt
    linear[:-2] -= square[..., size:, -1]
    linear[1:-1] -= square[..., :size, -1]
    linear[2:] -= pull[..., -1] / dt
    value = (terms.residual.transpose(0, 1) * pull[..., -1]).sum((0, -1))
    return Band(diagonal, near, far, linear), -0.5 * (value + spread)


def _precision(terms: PathTerms) -> tuple[Tensor, Tensor]:
    """Return the inverse of Q, 0 for who does not stay, and the sum of log det 2 pi Q."""
    factor = torch.linalg.cholesky(terms.noise)
    precision = torch.cholesky_inverse(factor)
    spread = 2.0 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    spread = spread + factor.shape[-1] * math.log(2.0 * math.pi)
    if not bool(terms.persists.all()):
        precision = torch.where(terms.persists[..., None, None], precision, 0.0)
        spread = torch.where(terms.persists, spread, 0.0)
    return precision, spread.sum((1, 2))


def _apply(precision: Tensor, rows: Tensor) -> Tensor:
    """Multiply rows ``(..., joint, any)`` by each individual's own matrix."""
    individuals, space = precision.shape[-3:-1]
    split = torch.unflatten(rows, -2, (individuals, space))
    found = precision[..., :, :1] * split[..., :1, :]
    for axis in range(1, space):
        found = torch.addcmul(found, precision[..., :, axis, None], split[..., axis, None, :])
    return found.flatten(-3, -2)


def _own_blocks(matrix: Tensor, individuals: int) -> Tensor:
    """View the diagonal blocks ``(..., individual, space, space)`` of ``(..., joint, joint)``."""
    space = matrix.shape[-1] // individuals
    size = (individuals, space)
    split = torch.unflatten(torch.unflatten(matrix, -1, size), -3, size)
    return split.diagonal(dim1=-4, dim2=-2).movedim(-1, -3)


def own_blocks_of(found: BandMoments, individuals: int) -> Tensor:
    """Return each individual's own covariance of d.

    ``(batch, time, individual, 2 * space, 2 * space)``.
    """
    here = _own_blocks(found.diagonal, individuals)
    across = _own_blocks(found.next, individuals)
    upper = torch.cat([here[1:], across], -1)
    lower = torch.cat([across.mT, here[:-1]], -1)
    return torch.cat([upper, lower], -2).transpose(0, 1)


class _PathIntegral(torch.autograd.Function):
    """The integral as a function of the terms."""

    @staticmethod
    def forward(
        ctx: Any, persists: Tensor, idle: Tensor | None, dt: float, *tensors: Tensor
    ) -> Tensor:
        terms = PathTerms._make([*tensors, persists, idle, dt])
        band, value = assemble(terms)
        factor = factorize(band)
        ctx.save_for_backward(*tensors, *factor)
        ctx.rest = (persists, idle, dt)
        found = value + normalizer(factor)
        if idle is not None:
            found = found - 0.5 * math.log(2.0 * math.pi) * idle.sum((1, 2)).to(found)
        return found

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, weight: Tensor) -> tuple[Any, ...]:
        *tensors, lower, whitened = ctx.saved_tensors
        terms = PathTerms._make([*tensors, *ctx.rest])
        _, times, individuals, double = terms.linear.shape
        space, dt = double // 2, terms.dt
        found = moments(Factor(lower, whitened))
        mean = found.mean.transpose(0, 1)
        split = torch.unflatten(mean, -1, (individuals, space))
        by_linear = torch.cat([split[:, 1:], split[:, :-1]], -1)
        by_curvature = own_blocks_of(found, individuals)
        by_curvature = by_curvature + by_linear.unsqueeze(-1) * by_linear.unsqueeze(-2)
        each = weight[:, None, None, None]
        frames = (each * by_linear, -0.5 * each.unsqueeze(-1) * by_curvature)
        if times == 1:
            return (None, None, None, *frames, *[torch.zeros_like(t) for t in tensors[2:]])
        # Second moments of d (both), and of the position after with d (ahead).
        diagonal = found.diagonal.transpose(0, 1)
        near = found.next.transpose(0, 1)
        after = mean[:, 2:]
        here = torch.cat([mean[:, 1:-1], mean[:, :-2]], -1)
        both = torch.cat(
            [
                torch.cat([diagonal[:, 1:-1], near[:, :-1]], -1),
                torch.cat([near[:, :-1].mT, diagonal[:, :-2]], -1),
            ],
            -2,
        )
        ahead = torch.cat([near[:, 1:], found.after_next.transpose(0, 1)], -1)
        expected = terms.residual + after / dt
        expected = expected + (terms.slopes @ here.unsqueeze(-1)).squeeze(-1)
        # Covariance of rho with d and with the position after.
        crossed = torch.baddbmm(
            ahead.flatten(0, 1) / dt, terms.slopes.flatten(0, 1), both.flatten(0, 1)
        ).view_as(ahead)
        product = crossed + expected.unsqueeze(-1) * here.unsqueeze(-2)
        precision, _ = _precision(terms)
        scaled = -weight[:, None, None, None, None] * precision
        by_slopes = _apply(scaled, product)
        by_residual = _apply(scaled, expected.unsqueeze(-1)).squeeze(-1)
        # Cov(rho) = Cov(rho, d) C' + C Cov(d, after) / dt + Cov(after) / dt^2
        own = _own_products(crossed, terms.slopes, individuals)
        own = own + _own_products(terms.slopes, ahead, individuals) / dt
        own = own + _own_blocks(diagonal[:, 2:], individuals) / dt**2
        rho = torch.unflatten(expected, -1, (individuals, space))
        own = own + rho.unsqueeze(-1) * rho.unsqueeze(-2)
        by_noise = precision @ own @ precision - precision
        by_noise = 0.5 * weight[:, None, None, None, None] * by_noise
        return (None, None, None, *frames, by_residual, by_slopes, by_noise)


def _own_products(left: Tensor, right: Tensor, individuals: int) -> Tensor:
    """Return the diagonal blocks of ``left @ right.mT``."""
    split = (individuals, left.shape[-2] // individuals)
    return torch.unflatten(left, -2, split) @ torch.unflatten(right, -2, split).mT
