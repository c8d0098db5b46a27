r"""Mean paths of bodies that move with their next velocity, and their derivatives, fast.

A mean path is where a quadratic function is least: with s the precisions and g the information of
what was seen of positions p and velocities v,

.. math::
    E = \sum_t \tfrac12 s_t \cdot x_t^2 - g_t \cdot x_t + \sum_t \frac{r_t^2}{2 q_t},
    \qquad r_t = v_{t+1} - k_t p_t - a_t v_t - u_t,\quad p_{t+1} = p_t + dt\, v_{t+1}

So the derivative of a loss needs no way back through a recursion. With :math:`\lambda` the path
that is least for the loss's own gradient in place of g, and u = 0, it is that of
:math:`-\lambda \cdot \nabla E` by the parameters with both paths held.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
import torch
from torch import Tensor

__all__ = ["mean_paths"]

Array = np.ndarray[Any, np.dtype[np.float64]]


def mean_paths(
    dt: float,
    sure: tuple[Tensor, Tensor],
    told: tuple[Tensor, Tensor],
    law: Sequence[Tensor],
    persists: Tensor,
    enters: Tensor,
) -> tuple[Tensor, Tensor] | None:
    """Return mean positions and velocities, 0 where nobody is.

    In double precision, on the processor. Derivatives of any order are there. Nothing is returned
    where even that is not precise enough, or something is not a number.

    Parameters
    ----------
    dt
        Seconds from one frame to the next.
    sure, told
        Precisions and information of positions and of velocities, ``(column, time)``; the prior of
        a first state is part of what is told where somebody comes.
    law
        Drift u, variance q, and the gains k and a, ``(column, time - 1)``.
    stays, comes
        Who takes a step, ``(column, time - 1)``, and who comes in a frame, ``(column, time)``; of
        bool.
    """
    parts = [part.double() for part in (*sure, *told, *law)]
    bands = _factorised(dt, [part.detach().numpy() for part in parts], persists, enters)
    if bands is None:
        return None
    position, velocity = _MeanPaths.apply(*parts, bands)  # type: ignore[no-untyped-call]
    return position.to(sure[0].dtype), velocity.to(sure[0].dtype)


@dataclass(frozen=True)
class _Bands:
    """The matrix of the quadratic function, factorised.

    The unknowns are positions, ``(column, time)`` in a row, and before each first one that from
    which its velocity leads there: in these a velocity is a difference of two neighbours, and the
    matrix has two bands beside its diagonal. All columns are one matrix.

    Attributes
    ----------
    factor
        Its Cholesky factor, as LAPACK keeps it.
    place
        Number of each position, ``(column, time)``.
    stays, comes, there
        Who takes a step, comes, and is there.
    weight, here, before
        Inverse variance of each step, 0 where nobody takes it; and what the position here, and the
        one before, take from the next velocity.
    dt
        Seconds.
    """

    factor: Array
    place: np.ndarray[Any, np.dtype[np.int64]]
    persists: Tensor
    enters: np.ndarray[Any, np.dtype[np.bool_]]
    there: np.ndarray[Any, np.dtype[np.bool_]]
    weight: Array
    here: Array
    before: Array
    dt: float

    def solve(self, told_p: Array, told_v: Array, drift: Array) -> tuple[Array, Array]:
        """Return the path of given information and drift."""
        pulled = self.weight * drift
        own, back = told_p + told_v / self.dt, told_v / -self.dt
        own[:, 1:] += pulled / self.dt
        own[:, :-1] -= self.here * pulled
        back[:, :-1] += self.before * pulled
        right = _rows(len(self.factor.T), own, back, self.place, self.enters, self.there)
        path, _ = scipy.linalg.lapack.dpbtrs(self.factor, right, lower=1, overwrite_b=1)
        position = path[self.place]
        velocity = (position - path[self.place - 1]) / self.dt
        return position * self.there, velocity * self.there


def _rows(size: int, own: Array, back: Array, place: Any, enters: Any, there: Any) -> Array:
    """Return one number for each unknown, of those that belong to positions and to the ones
    before them.
    """
    own[:, :-1] += back[:, 1:] * (there & ~enters)[:, 1:]
    rows = np.zeros(size)
    rows[place] = own * there
    rows[place[enters] - 1] = back[enters]
    return rows


def _factorised(
    dt: float, parts: Sequence[Array], persists: Tensor, enters: Tensor
) -> _Bands | None:
    """Return the bands, or nothing if they have no factor; ``parts`` are those of
    :func:`mean_paths`.
    """
    sure_p, sure_v, _, _, _, noise, k, a = parts
    arrives = enters.numpy()
    there = arrives.copy()
    there[:, 1:] |= persists.numpy()
    place = (1 + arrives).cumsum().reshape(arrives.shape) - 1
    weight = persists.numpy() / noise
    before = a / dt
    here = 1.0 / dt + k + before
    from_speed = sure_v / dt**2
    own, back, link = sure_p + from_speed, from_speed.copy(), -from_speed
    own[:, 1:] += weight / dt**2
    weighted = weight * here
    own[:, :-1] += weighted * here
    back[:, :-1] += weight * before**2
    link[:, :-1] -= weighted * before
    link[:, 1:] -= weighted / dt
    size = int(place[-1, -1]) + 1
    bands = np.zeros((size, 3))
    bands[:, 0] = _rows(size, own, back, place, arrives, there)
    bands[place[~there], 0] = 1.0
    bands[place - 1, 1] = link
    bands[place[:, :-1] - 1, 2] = weight * before / dt
    factor, failed = scipy.linalg.lapack.dpbtrf(bands.T, lower=1, overwrite_ab=1)
    if failed:
        return None
    return _Bands(factor, place, persists, arrives, there, weight, here, before, dt)


class _MeanPaths(torch.autograd.Function):
    """See :func:`mean_paths`."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, Tensor]:
        *parts, bands = inputs
        told_p, told_v, drift = (part.detach().numpy() for part in parts[2:5])
        path = tuple(map(torch.from_numpy, bands.solve(told_p, told_v, drift)))
        ctx.save_for_backward(*parts, *path)
        ctx.bands = bands
        return path[0], path[1]

    @staticmethod
    def backward(ctx: Any, *gradient: Tensor) -> tuple[Tensor | None, ...]:
        bands: _Bands = ctx.bands
        sure_p, sure_v, _, _, drift, noise, k, a, p, v = ctx.saved_tensors
        own_p, own_v = _MeanPaths.apply(  # type: ignore[no-untyped-call]
            sure_p, sure_v, *gradient, torch.zeros_like(drift), noise, k, a, bands
        )
        scaled = bands.persists / noise
        surprise = (v[:, 1:] - k * p[:, :-1] - a * v[:, :-1] - drift) * scaled
        own = (own_v[:, 1:] - k * own_p[:, :-1] - a * own_v[:, :-1]) * scaled
        return (
            -own_p * p,
            -own_v * v,
            own_p,
            own_v,
            own,
            own * surprise,
            p[:, :-1] * own + own_p[:, :-1] * surprise,
            v[:, :-1] * own + own_v[:, :-1] * surprise,
            None,
        )
