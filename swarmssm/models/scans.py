"""Recurrences that are linear in what is carried along, fast in both directions.

Written as a loop over time in torch, each step would leave a dozen small operations to be
differentiated one by one. Here a step is one operation, and so is its derivative: the adjoint of a
linear recurrence is a linear recurrence the other way round.
"""

import itertools
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

__all__ = ["gated_scan", "linear_scan", "projective_scan"]


def linear_scan(gain: Tensor, shift: Tensor, *, reverse: bool = False) -> Tensor:
    r"""Return all :math:`x_t = A_t x_{t-1} + b_t`, from :math:`x_0 = b_0` on.

    Parameters
    ----------
    gain
        :math:`A_t`: numbers, ``(time, ...)`` of the shape of ``shift``; or matrices ``(time, row,
        feature, feature)``. The first is not looked at.
    shift
        :math:`b_t`, ``(time, ...)``, or ``(time, row, feature)`` beside matrices.
    reverse
        Whether time runs backwards: :math:`x_t = A_t x_{t+1} + b_t`, and the last gain is not
        looked at.

    Returns
    -------
    Same shape as ``shift``. Derivatives of any order are there.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    is_matrix = gain.dim() == shift.dim() + 1 == 4
    wanted = (*shift.shape, shift.shape[-1]) if is_matrix else tuple(shift.shape)
    if tuple(gain.shape) != wanted:
        raise ValueError(f"gain must have shape {wanted}, and it is {tuple(gain.shape)}")
    scanned: Tensor = _Scan.apply(gain, shift, reverse)  # type: ignore[no-untyped-call]
    return scanned


def projective_scan(gain: Tensor, first: Tensor, *, reverse: bool = False) -> Tensor:
    r"""Return all :math:`x_t \propto A_t x_{t-1}`, of which only ratios have a meaning.

    Each is scaled so that its first feature is 1, and so neither overflows nor vanishes. The scale
    is taken for a constant when differentiated: derivatives of ratios are right, others are not.

    Parameters
    ----------
    gain
        :math:`A_t`, ``(time, row, feature, feature)``; the first is not looked at.
    first
        :math:`x_0`, ``(row, feature)``, its first feature 1.
    reverse
        As in :func:`linear_scan`; ``first`` is then the last.

    Returns
    -------
    ``(time, row, feature)``.
    """
    scanned: Tensor = _Projective.apply(gain, first, reverse)  # type: ignore[no-untyped-call]
    return scanned


def gated_scan(told: Tensor, there: Tensor | None = None) -> Tensor:
    r"""Return a gated recurrence both ways in time.

    .. math::
        h_t = (1 - z_t) h_{t-1} + z_t c_t, \qquad z_t = \sigma(\cdot), \quad c_t = \tanh(\cdot)

    from :math:`h_0 = 0` on forwards, and the same from the last frame on backwards.

    Parameters
    ----------
    told
        What sigmoid and tanh are taken of, ``(time, ..., 4 * feature)``: gates forwards and
        backwards, then candidates forwards and backwards.
    there
        Factor of the gates, broadcasting against them, 0 where nothing is learned and nothing
        forgotten; ``None``, 1 everywhere. It has no gradient.

    Returns
    -------
    ``(time, ..., 2 * feature)``, forwards and backwards. It can be differentiated once.
    """
    scanned: Tensor = _Gated.apply(told, there)  # type: ignore[no-untyped-call]
    return scanned


class _Gated(torch.autograd.Function):
    """See :func:`gated_scan`."""

    @staticmethod
    def forward(ctx: Any, told: Tensor, there: Tensor | None) -> Tensor:
        gate, candidate = told.chunk(2, -1)
        gate, candidate = gate.sigmoid(), candidate.tanh()
        if there is not None:
            gate *= there
        states = gate * candidate
        keep = 1.0 - gate
        _both_ways(keep, states)
        ctx.save_for_backward(gate, candidate, keep, states)
        return states

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        gate, candidate, keep, states = ctx.saved_tensors
        half = states.shape[-1] // 2
        adjoint = gradient.clone(memory_format=torch.contiguous_format)
        _both_ways(keep, adjoint, is_adjoint=True)
        told = adjoint.new_empty(*adjoint.shape[:-1], 4 * half)
        of_gate, of_candidate = told.chunk(2, -1)
        adjoint *= gate
        # h_t less h_{t-1} is z (c - h_{t-1}), and a factor z (1 - z) belongs to the sigmoid.
        change = candidate.clone()
        change[1:, ..., :half] -= states[:-1, ..., :half]
        change[:-1, ..., half:] -= states[1:, ..., half:]
        torch.mul(adjoint, change.mul_(keep), out=of_gate)
        torch.addcmul(adjoint, adjoint * candidate, candidate, value=-1.0, out=of_candidate)
        return told, None


def _both_ways(keep: Tensor, states: Tensor, *, is_adjoint: bool = False) -> None:
    """Add up in place: the first half of the features forwards, the other backwards.

    The adjoint runs the other way round, and the gain into a frame then leads out of it.
    """
    for place, (gains, found) in enumerate(
        zip(keep.chunk(2, -1), states.chunk(2, -1), strict=True)
    ):
        order = range(len(states))
        if (place == 1) != is_adjoint:
            order = order[::-1]
        gain, carried = gains.unbind(0), found.unbind(0)
        for before, t in itertools.pairwise(order):
            carried[t].addcmul_(gain[before if is_adjoint else t], carried[before])


class _Scan(torch.autograd.Function):
    """See :func:`linear_scan`."""

    @staticmethod
    def forward(ctx: Any, gain: Tensor, shift: Tensor, reverse: bool) -> Tensor:
        # In place, or each step would copy as much as it adds.
        states = shift.clone(memory_format=torch.contiguous_format)
        order = range(len(shift))[::-1] if reverse else range(len(shift))
        is_matrix = gain.dim() > shift.dim()
        gains, found = gain.unbind(0), (states.unsqueeze(-1) if is_matrix else states).unbind(0)
        for before, t in itertools.pairwise(order):
            if is_matrix:
                found[t].baddbmm_(gains[t], found[before])
            else:
                found[t].addcmul_(gains[t], found[before])
        ctx.save_for_backward(gain, states)
        ctx.reverse = reverse
        return states

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        gain, states = ctx.saved_tensors
        adjoint, before = _adjoint(gain, states, gradient, ctx.reverse)
        if not ctx.needs_input_grad[0]:
            return None, adjoint, None
        if gain.dim() > states.dim():
            return adjoint.unsqueeze(-1) * before.unsqueeze(-2), adjoint, None
        return adjoint * before, adjoint, None


class _Projective(torch.autograd.Function):
    """See :func:`projective_scan`."""

    @staticmethod
    def forward(ctx: Any, gain: Tensor, first: Tensor, reverse: bool) -> Tensor:
        states = first.new_empty(len(gain), *first.shape)
        scale = torch.ones_like(states[..., :1])
        order = range(len(gain))[::-1] if reverse else range(len(gain))
        gains, found, scales = gain.unbind(0), states.unsqueeze(-1).unbind(0), scale.unbind(0)
        found[order[0]].copy_(first.unsqueeze(-1))
        for before, t in itertools.pairwise(order):
            moved = torch.bmm(gains[t], found[before])
            torch.reciprocal(moved[:, 0], out=scales[t])
            torch.mul(moved, scales[t].unsqueeze(-1), out=found[t])
        ctx.save_for_backward(gain, states, scale.unsqueeze(-1))
        ctx.reverse = reverse
        return states

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        # With the scale known, it is a linear scan.
        gain, states, scale = ctx.saved_tensors
        adjoint, before = _adjoint(gain * scale, states, gradient, ctx.reverse)
        of_gain = scale * adjoint.unsqueeze(-1) * before.unsqueeze(-2)
        return of_gain, adjoint[-1 if ctx.reverse else 0], None


def _adjoint(
    gain: Tensor, states: Tensor, gradient: Tensor, reverse: bool
) -> tuple[Tensor, Tensor]:
    """Return the derivative by each shift, and the state before each, 0 before the first."""
    # The gain into a later frame leads back from it.
    turned = gain.mT if gain.dim() > states.dim() else gain
    edge = torch.zeros_like(states[:1])
    if reverse:
        turned = torch.cat([turned[:1], turned[:-1]])
        before = torch.cat([states[1:], edge])
    else:
        turned = torch.cat([turned[1:], turned[-1:]])
        before = torch.cat([edge, states[:-1]])
    return linear_scan(turned, gradient, reverse=not reverse), before
