"""Recurrences that are linear in what is carried along, fast in both directions.

Written as a loop over time in torch, each step would leave a dozen small operations to be
differentiated one by one. Here a step is one operation, and so is its derivative: the adjoint of a
linear recurrence is a linear recurrence the other way round.
"""

import itertools
from typing import Any

import torch
from torch import Tensor

__all__ = ["linear_scan", "projective_scan"]


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
