r"""Evidence and smoothing of affine-Gaussian chains, with a hand-written derivative.

.. math::
    z_1 &\sim N(m_1, P_1), \qquad z_{t+1} = F_t z_t + c_t + q_t, \quad q_t \sim N(0, Q_t) \\
    x_t &= H_t z_t + d_t + r_t, \qquad r_t \sim N(0, R_t)

The Kalman filter runs without an autograd graph. Its derivative is the adjoint of the same
recursion: with :math:`A = I - K H`, :math:`s = S^{-1} y` and cotangents :math:`\hat g, \hat G` of
the filtered mean and covariance, those of the predicted ones are

.. math::
    g = A^\top \hat g + H^\top s, \qquad
    G = A^\top \hat G A + \mathrm{sym}(A^\top \hat g\, s^\top H)
        + \tfrac12 H^\top (s s^\top - S^{-1}) H

(the update in Joseph's form is stationary in the gain), and :math:`\hat g = F^\top g'`,
:math:`\hat G = F^\top G' F`. One loop backwards gives them for all frames; every other derivative
then is a batched product. The same loop is the smoother of Bryson and Frazier: the smoothed mean
is :math:`m + P g`, the smoothed covariance :math:`P - P (g g^\top - 2 G) P`.

Shapes here are time first, ``(time, batch, ...)``: the frames of a loop stand together in memory.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from swarmssm.errors import WorkError
from swarmssm.inference.filtering.affine import AffineSwarm

__all__ = [
    "AffineChain",
    "ForwardPass",
    "chain_evidence",
    "chain_smooth",
    "filter_chain",
    "linearized_evidence",
]

LOG_2PI = math.log(2.0 * math.pi)


class AffineChain(NamedTuple):
    """An affine-Gaussian chain and what was observed of it.

    Attributes
    ----------
    initial_mean, initial_cov
        ``(batch, state)``, ``(batch, state, state)``.
    transition_matrix, offset, process_cov
        F, c, Q of the steps: ``(time - 1, batch, state, state)``,
        ``(time - 1, batch, state)``, ``(time - 1, batch, state, state)``.
    emission_matrix, emission_offset, emission_cov
        H, d, R of the frames: ``(time, batch, observation, state)``,
        ``(time, batch, observation)``, ``(time, batch, observation, observation)``. Of what was not
        observed H is 0 and R is 1.
    observations
        x, ``(time, batch, observation)``; d where nothing was observed.
    num_observed
        ``(batch,)``: how many numbers were observed.
    """

    initial_mean: Tensor
    initial_cov: Tensor
    transition_matrix: Tensor
    offset: Tensor
    process_cov: Tensor
    emission_matrix: Tensor
    emission_offset: Tensor
    emission_cov: Tensor
    observations: Tensor
    num_observed: Tensor

    @classmethod
    def of(cls, system: AffineSwarm) -> "AffineChain":
        """Return the chain of a swarm's joint state."""
        window, steps, frames = system.window, system.steps, system.observations
        zero = _times(frames.jacobian, frames.point)
        offset = frames.mean - zero
        there = window.there[:, 0]
        return cls(
            torch.where(there, window.initial_mean, 0.0),
            window.initial_covariance * (there.unsqueeze(-1) & there.unsqueeze(-2)),
            _time_first(steps.jacobian),
            _time_first(steps.mean - _times(steps.jacobian, steps.point)),
            _time_first(steps.noise),
            _time_first(frames.jacobian),
            _time_first(offset),
            _time_first(frames.noise),
            _time_first(torch.where(window.mask, window.observations, offset)),
            window.mask.sum((-1, -2)),
        )


class ForwardPass(NamedTuple):
    """What the filter leaves for the way back, time first.

    Attributes
    ----------
    evidence
        ``(batch,)``.
    mean, covariance
        Predicted.
    filtered_mean, filtered_covariance
        After the frame.
    factor
        L, lower Cholesky factor of the covariance S of the innovations y.
    whitened, whitened_matrix, reach
        :math:`L^{-1} y`, :math:`L^{-1} H` and :math:`L^{-1} H P`.
    """

    evidence: Tensor
    mean: Tensor
    covariance: Tensor
    filtered_mean: Tensor
    filtered_covariance: Tensor
    factor: Tensor
    whitened: Tensor
    whitened_matrix: Tensor
    reach: Tensor


#: From the step and the filtered mean and covariance to the next mean, F and Q.
Predict = Callable[[int, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]
#: From the step and cotangents of the next mean, of F and of Q to one of the filtered mean.
Pullback = Callable[[int, Tensor, Tensor, Tensor], Tensor]


def filter_chain(chain: AffineChain, predict: Predict | None = None) -> ForwardPass:
    """Run the filter forwards, without gradient.

    Parameters
    ----------
    chain
        The chain. With ``predict`` its transition is not looked at.
    predict
        Linearises as it goes.

    Raises
    ------
    WorkError
        If a covariance of the innovations is not positive definite.
    """
    with torch.no_grad():
        try:
            return _forwards(chain, predict)
        except torch.linalg.LinAlgError as error:  # type: ignore[attr-defined]
            raise WorkError(
                "The covariance of the observations is not positive definite. Parameters are out "
                "of bounds, or the model needs float64."
            ) from error


def _forwards(chain: AffineChain, predict: Predict | None) -> ForwardPass:
    """Predict and update, frame by frame."""
    mean, covariance = chain.initial_mean, chain.initial_cov
    state = mean.shape[-1]
    residuals = chain.observations - chain.emission_offset
    rows: list[tuple[Tensor, ...]] = []
    last = len(residuals) - 1
    for t in range(last + 1):
        h = chain.emission_matrix[t]
        cross = h @ covariance
        factor = torch.linalg.cholesky(torch.baddbmm(chain.emission_cov[t], cross, h.mT))
        residual = torch.baddbmm(residuals[t].unsqueeze(-1), h, mean.unsqueeze(-1), alpha=-1)
        stacked = torch.cat([cross, h, residual], dim=-1)
        solved = torch.linalg.solve_triangular(factor, stacked, upper=False)
        reach, white, e = solved[..., :state], solved[..., state:-1], solved[..., -1]
        filtered_mean = mean + _times(reach.mT, e)
        filtered_covariance = torch.baddbmm(covariance, reach.mT, reach, alpha=-1)
        rows.append((mean, covariance, filtered_mean, filtered_covariance, factor, e, white, reach))
        if t == last:
            break
        if predict is None:
            f, q = chain.transition_matrix[t], chain.process_cov[t]
            mean = chain.offset[t] + _times(f, filtered_mean)
        else:
            mean, f, q = predict(t, filtered_mean, filtered_covariance)
        covariance = torch.baddbmm(q, f @ filtered_covariance, f.mT)
        covariance = 0.5 * (covariance + covariance.mT)
    found = [torch.stack(row) for row in zip(*rows, strict=True)]
    factors, whitened = found[4], found[5]
    spread = factors.diagonal(dim1=-2, dim2=-1).log().sum((0, -1))
    evidence = (
        -0.5 * (whitened.square().sum((0, -1)) + LOG_2PI * chain.num_observed.to(whitened)) - spread
    )
    return ForwardPass(evidence, *found)


class Cotangents(NamedTuple):
    """Derivatives of the evidence by predicted and filtered moments, time first."""

    mean: Tensor
    covariance: Tensor
    filtered_mean: Tensor
    filtered_covariance: Tensor


def run_adjoint(
    matrix: Tensor, run: ForwardPass, weight: Tensor, pullback: Pullback | None = None
) -> Cotangents:
    """Run the adjoint backwards.

    Parameters
    ----------
    matrix
        F of all steps.
    run
        The filter's.
    weight
        ``(batch,)``: cotangent of the evidence.
    pullback
        What the linearisation does with a change of the place where it is made.
    """
    push = _times(run.whitened_matrix.mT, run.whitened)  # H' S^-1 y
    eye = torch.eye(run.mean.shape[-1], dtype=push.dtype, device=push.device)
    keep = eye - run.reach.mT @ run.whitened_matrix
    own = push.unsqueeze(-1) * push.unsqueeze(-2) - run.whitened_matrix.mT @ run.whitened_matrix
    own = 0.5 * own * weight[:, None, None]
    pushed = push * weight[:, None]
    filtered_mean = torch.zeros_like(run.mean[0])
    filtered_covariance = torch.zeros_like(run.covariance[0])
    rows: list[tuple[Tensor, ...]] = []
    for t in reversed(range(len(run.mean))):
        a = keep[t]
        back = _times(a.mT, filtered_mean)
        mean = back + pushed[t]
        outer = back.unsqueeze(-1) * (0.5 * push[t]).unsqueeze(-2)
        covariance = torch.baddbmm(own[t] + outer + outer.mT, a.mT @ filtered_covariance, a)
        rows.append((mean, covariance, filtered_mean, filtered_covariance))
        if t == 0:
            break
        f = matrix[t - 1]
        moved = covariance @ f
        filtered_mean = _times(f.mT, mean)
        if pullback is not None:
            by_matrix = 2.0 * moved @ run.filtered_covariance[t - 1]
            filtered_mean = pullback(t - 1, mean, by_matrix, covariance)
        filtered_covariance = f.mT @ moved
    rows.reverse()
    return Cotangents(*map(torch.stack, zip(*rows, strict=True)))


def emission_cotangents(
    run: ForwardPass, found: Cotangents, weight: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return derivatives by H, d and R."""
    inverse = torch.cholesky_inverse(run.factor)
    s = torch.linalg.solve_triangular(run.factor.mT, run.whitened.unsqueeze(-1), upper=True)
    gain = torch.linalg.solve_triangular(run.factor.mT, run.reach, upper=True)  # K'
    scaled = weight[:, None, None]
    back = gain @ found.filtered_mean.unsqueeze(-1)
    surprise = scaled * (s @ s.mT - inverse)
    half = gain @ found.filtered_covariance
    cross = back @ s.mT
    by_cov = 0.5 * (surprise - cross - cross.mT) + half @ gain.mT
    by_offset = scaled * s - back
    reach = run.factor @ run.reach  # H P
    by_emission_matrix = by_offset @ run.mean.unsqueeze(-2) + surprise @ reach
    by_emission_matrix = (
        by_emission_matrix + s @ (run.filtered_covariance @ found.filtered_mean.unsqueeze(-1)).mT
    )
    by_emission_matrix = (
        by_emission_matrix - back @ (reach.mT @ s).mT - 2.0 * half @ run.filtered_covariance
    )
    return by_emission_matrix, by_offset.squeeze(-1), by_cov


class _Evidence(torch.autograd.Function):
    """The evidence of a chain as a function of its tensors."""

    @staticmethod
    def forward(
        ctx: Any,
        run: ForwardPass | None,
        pullback: Pullback | None,
        count: Tensor,
        *tensors: Tensor,
    ) -> Tensor:
        chain = AffineChain._make([*tensors, count])
        ctx.run = filter_chain(chain) if run is None else run
        ctx.pullback = pullback
        ctx.save_for_backward(chain.transition_matrix)
        evidence: Tensor = ctx.run.evidence.clone()
        return evidence

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, weight: Tensor) -> tuple[Any, ...]:
        (matrix,) = ctx.saved_tensors
        run = ctx.run
        found = run_adjoint(matrix, run, weight, ctx.pullback)
        mean, covariance = found.mean[1:], found.covariance[1:]
        by_matrix = 2.0 * covariance @ (matrix @ run.filtered_covariance[:-1])
        if ctx.pullback is None:
            by_matrix += mean.unsqueeze(-1) * run.filtered_mean[:-1].unsqueeze(-2)
        by_emission_matrix = by_offset = by_cov = by_observed = None
        if any(ctx.needs_input_grad[8:]):
            by_emission_matrix, by_offset, by_cov = emission_cotangents(run, found, weight)
            by_observed = -by_offset
        first = (found.mean[0], found.covariance[0])
        step = (by_matrix, mean, covariance)
        return (None, None, None, *first, *step, by_emission_matrix, by_offset, by_cov, by_observed)


def chain_evidence(chain: AffineChain) -> Tensor:
    r"""Return :math:`\log p(x_{1:T})`, ``(batch,)``, once differentiable by all tensors.

    Raises
    ------
    WorkError
        If a covariance of the innovations is not positive definite.
    """
    *tensors, count = chain
    evidence: Tensor = _Evidence.apply(None, None, count, *tensors)  # type: ignore[no-untyped-call]
    return evidence


def linearized_evidence(chain: AffineChain, run: ForwardPass, pullback: Pullback) -> Tensor:
    """Return the evidence of a filter that linearised as it went, once differentiable.

    Parameters
    ----------
    chain
        With F, Q and, in place of c, the next means, as functions of the parameters at the
        filtered means that the filter found.
    run
        The filter's.
    pullback
        See :data:`Pullback`.
    """
    *tensors, count = chain
    evidence: Tensor = _Evidence.apply(  # type: ignore[no-untyped-call]
        run, pullback, count, *tensors
    )
    return evidence


def chain_smooth(chain: AffineChain, run: ForwardPass | None = None) -> tuple[Tensor, Tensor]:
    """Return smoothed means and covariances ``(time, batch, state[, state])``, without gradient."""
    with torch.no_grad():
        run = filter_chain(chain) if run is None else run
        found = run_adjoint(chain.transition_matrix, run, run.mean.new_ones(run.mean.shape[1]))
        g = found.mean.unsqueeze(-1)
        mean = run.mean + (run.covariance @ g).squeeze(-1)
        curvature = g @ g.mT - 2.0 * found.covariance
        covariance = run.covariance - run.covariance @ curvature @ run.covariance
        return mean, 0.5 * (covariance + covariance.mT)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def _time_first(values: Tensor) -> Tensor:
    return values.transpose(0, 1).contiguous()
