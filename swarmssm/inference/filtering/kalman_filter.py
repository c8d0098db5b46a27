"""Kalman filter and smoother of the joint state of a swarm."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from swarmssm.inference.filtering.affine import (
    AffineMap,
    AffineSwarm,
    Linearizer,
    Taylor,
    Window,
    no_steps,
)
from swarmssm.inference.filtering.matrices import cholesky, own_blocks, symmetrize
from swarmssm.models import StateSpaceModel, SwarmBatch

__all__ = [
    "Filtered",
    "Gains",
    "Smoothed",
    "extended_kalman",
    "filter_with",
    "filtered_at",
    "gains_of",
    "kalman",
    "smooth",
]

LOG_2_PI = math.log(2 * math.pi)


@dataclass(frozen=True)
class Filtered:
    """States of a swarm given the past, and the evidence.

    ``joint = individual * state``; covariances are of the whole swarm. Absent individuals have mean
    and covariance 0.

    Attributes
    ----------
    predicted_mean, predicted_covariance
        Given the frames before: ``(batch, time, individual, state)`` and
        ``(batch, time, joint, joint)``.
    mean, covariance
        Given the frames up to the same one.
    log_increments
        ``(batch, time)``: log-density of each frame's observations given those before.
    system
        The linear Gaussian system that was filtered.
    """

    predicted_mean: Tensor
    predicted_covariance: Tensor
    mean: Tensor
    covariance: Tensor
    log_increments: Tensor
    system: AffineSwarm

    @property
    def log_evidence(self) -> Tensor:
        """Log-density of all observations of each window, ``(batch,)``."""
        return self.log_increments.sum(-1)

    @property
    def own_covariance(self) -> Tensor:
        """Each individual's own, ``(batch, time, individual, state, state)``."""
        return own_blocks(self.covariance, self.mean.shape[-2])


@dataclass(frozen=True)
class Smoothed:
    """States of a swarm given all frames of a window.

    Attributes
    ----------
    mean
        ``(batch, time, individual, state)``.
    covariance
        ``(batch, time, joint, joint)``.
    lag_covariance
        ``(batch, time - 1, joint, joint)``: of the states of a frame (rows) and of the next one
        (columns).
    """

    mean: Tensor
    covariance: Tensor
    lag_covariance: Tensor

    @property
    def own_covariance(self) -> Tensor:
        """Each individual's own, ``(batch, time, individual, state, state)``."""
        return own_blocks(self.covariance, self.mean.shape[-2])


#: From frame, mean ``(batch, joint)`` and covariance to the affine map there.
Source = Callable[[int, Tensor, Tensor], AffineMap]


def extended_kalman(
    model: StateSpaceModel, batch: SwarmBatch, values: Mapping[str, Tensor]
) -> Filtered:
    """Filter the joint state of a swarm, linearising each step at the filtered mean.

    Exact for a linear Gaussian model. Observations that were not made have no part in it: they are
    marginalised. An individual enters with the initial distribution, independent of all others, and
    is dropped from the joint state when it leaves.

    Parameters
    ----------
    model
        With an emission.
    batch
        Windows, filtered side by side.
    values
        Of the parameters that have priors, full name -> value, one for all windows or, with shapes
        such as ``(batch, 1)``, one for each. The result is differentiable in them, and in the
        model's own parameters.

    Raises
    ------
    ValueError
        If the model has no emission.
    WorkError
        If the covariance of an observation is not positive definite.
    """
    return filter_with(model, batch, values, Taylor())


def filter_with(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor],
    linearizer: Linearizer,
) -> Filtered:
    """Filter with a linearisation of one's own; see :func:`extended_kalman`.

    Parameters
    ----------
    model, batch, values
        As in :func:`extended_kalman`.
    linearizer
        Asked once for each step, at the filtered states, and once for each frame, at the
        predicted ones.
    """
    with model.fixed(values):
        return _run(*_sources(model, batch, linearizer))


def filtered_at(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor],
    windows: Tensor,
    frames: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return what :func:`extended_kalman` knows at some frames, and keep nothing else.

    Parameters
    ----------
    model, batch, values
        As in :func:`extended_kalman`.
    windows, frames
        ``(origin,)``: window and frame of each state that is wanted.

    Returns
    -------
    Mean ``(origin, individual, state)`` and covariance ``(origin, joint, joint)``, given the
    frames up to the same one.
    """
    order, means, covariances = [], [], []
    with model.fixed(values):
        window, step, observe = _sources(model, batch, Taylor())
        for time, frame in enumerate(_through(window, step, observe)):
            wanted = torch.nonzero(frames == time).flatten()
            if len(wanted):
                mean, covariance = frame.filtered
                order.append(wanted)
                means.append(window.split(mean)[windows[wanted]])
                covariances.append(covariance[windows[wanted]])
    back = torch.argsort(torch.cat(order))
    return torch.cat(means)[back], torch.cat(covariances)[back]


def _sources(
    model: StateSpaceModel, batch: SwarmBatch, linearizer: Linearizer
) -> tuple[Window, Source, Source]:
    """Return what a filter asks at each frame of a model whose parameters are fixed."""
    window = Window.of(model, batch)

    def step(time: int, mean: Tensor, covariance: Tensor) -> AffineMap:
        states = window.split(mean)
        line = linearizer.step(model, states, covariance, window.inputs.at(time))
        return window.settle_step(line, time)

    def observe(time: int, mean: Tensor, covariance: Tensor) -> AffineMap:
        line = linearizer.observe(model, window.split(mean), covariance)
        return window.settle_observation(line, window.mask[..., time, :])

    return window, step, observe


def kalman(system: AffineSwarm) -> Filtered:
    """Filter a linear Gaussian system: exact."""
    return _run(
        system.window,
        lambda time, mean, covariance: system.steps.at(time),
        lambda time, mean, covariance: system.observations.at(time),
        system,
    )


def _run(
    window: Window, step: Source, observe: Source, system: AffineSwarm | None = None
) -> Filtered:
    """Predict and update, frame by frame."""
    frames = list(_through(window, step, observe))
    if system is None:
        steps = [frame.step for frame in frames if frame.step is not None]
        row = _stack(steps) if steps else no_steps(window.initial_mean)
        system = AffineSwarm(window, row, _stack([frame.observation for frame in frames]))
    return Filtered(
        window.split(torch.stack([frame.predicted[0] for frame in frames], -2)),
        torch.stack([frame.predicted[1] for frame in frames], -3),
        window.split(torch.stack([frame.filtered[0] for frame in frames], -2)),
        torch.stack([frame.filtered[1] for frame in frames], -3),
        torch.stack([frame.increment for frame in frames], -1),
        system,
    )


class _Frame(NamedTuple):
    """One frame of a filter: means and covariances, the maps used, and the evidence it adds."""

    predicted: tuple[Tensor, Tensor]
    filtered: tuple[Tensor, Tensor]
    increment: Tensor
    step: AffineMap | None
    observation: AffineMap


def _through(window: Window, step: Source, observe: Source) -> Iterator[_Frame]:
    """Predict and update, frame by frame."""
    there = window.there[..., 0, :]
    mean = torch.where(there, window.initial_mean, 0.0)
    covariance = window.initial_covariance * (there.unsqueeze(-1) & there.unsqueeze(-2))
    for time in range(window.num_times):
        moved = None
        if time:
            moved = step(time - 1, mean, covariance)
            mean = moved(mean)
            covariance = symmetrize(moved.jacobian @ covariance @ moved.jacobian.mT + moved.noise)
        predicted = mean, covariance
        shown = observe(time, mean, covariance)
        seen = window.mask[..., time, :]
        innovation = torch.where(seen, window.observations[..., time, :] - shown(mean), 0.0)
        mean, covariance, increment = _update(mean, covariance, shown, innovation, seen, time)
        yield _Frame(predicted, (mean, covariance), increment, moved, shown)


def _update(
    mean: Tensor,
    covariance: Tensor,
    map_: AffineMap,
    innovation: Tensor,
    seen: Tensor,
    time: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Take one frame in. Joseph's form: it stays positive where the difference would not."""
    moved = map_.jacobian @ covariance
    factor = cholesky(moved @ map_.jacobian.mT + map_.noise, f"of the observations of frame {time}")
    gain = torch.cholesky_solve(moved, factor).mT
    left = torch.eye(mean.shape[-1], dtype=mean.dtype, device=mean.device) - gain @ map_.jacobian
    white = torch.linalg.solve_triangular(factor, innovation.unsqueeze(-1), upper=False)
    # What was not seen has innovation 0 and variance 1, and so no term besides that of 2 pi.
    increment = -factor.diagonal(dim1=-2, dim2=-1).log().sum(-1) - 0.5 * (
        white.square().sum((-1, -2)) + seen.to(white.dtype).sum(-1) * LOG_2_PI
    )
    return (
        mean + (gain @ innovation.unsqueeze(-1)).squeeze(-1),
        symmetrize(left @ covariance @ left.mT + gain @ map_.noise @ gain.mT),
        increment,
    )


def _stack(maps: list[AffineMap]) -> AffineMap:
    """Put maps of single frames in a row."""
    return AffineMap(
        torch.stack([m.point for m in maps], -2),
        torch.stack([m.mean for m in maps], -2),
        torch.stack([m.jacobian for m in maps], -3),
        torch.stack([m.noise for m in maps], -3),
    )


@dataclass(frozen=True)
class Gains:
    r"""What the backward recursions need of a filter, all frames at once.

    Attributes
    ----------
    gain
        K, ``(batch, time, joint, out)``.
    left
        :math:`I - K H`, ``(batch, time, joint, joint)``.
    whitened
        :math:`L^{-1} H` with the innovations' covariance :math:`S = L L^\top`,
        ``(batch, time, out, joint)``.
    factor
        L, ``(batch, time, out, out)``.
    innovation
        ``(batch, time, out)``; 0 where nothing was seen.
    """

    gain: Tensor
    left: Tensor
    whitened: Tensor
    factor: Tensor
    innovation: Tensor


def gains_of(filtered: Filtered) -> Gains:
    """Compute the gains of a filter again, in one batched call."""
    map_, window = filtered.system.observations, filtered.system.window
    covariance = filtered.predicted_covariance
    moved = map_.jacobian @ covariance
    factor = cholesky(moved @ map_.jacobian.mT + map_.noise, "of the observations")
    gain = torch.cholesky_solve(moved, factor).mT
    eye = torch.eye(covariance.shape[-1], dtype=covariance.dtype, device=covariance.device)
    innovation = window.observations - map_(filtered.predicted_mean.flatten(-2))
    return Gains(
        gain,
        eye - gain @ map_.jacobian,
        torch.linalg.solve_triangular(factor, map_.jacobian, upper=False),
        factor,
        torch.where(window.mask, innovation, 0.0),
    )


def backward(filtered: Filtered, gains: Gains, innovation: Tensor) -> Tensor:
    r"""Return :math:`\hat\lambda_t`, by which the future moves the filtered mean:
    :math:`E[z_t \mid x_{1:T}] = m_t - P_t \hat\lambda_t`.

    Parameters
    ----------
    filtered, gains
        Of one filter.
    innovation
        Those of as many data sets as there are columns, ``(batch, time, out, column)``.

    Returns
    -------
    ``(batch, time, joint, column)``.
    """
    jacobian = filtered.system.steps.jacobian
    closed = gains.left[..., 1:, :, :] @ jacobian
    white = torch.linalg.solve_triangular(gains.factor, innovation, upper=False)[..., 1:, :, :]
    pushed = (gains.whitened[..., 1:, :, :] @ jacobian).mT @ white
    current = torch.zeros_like(filtered.covariance[..., 0, :, :1]).expand(
        *filtered.covariance.shape[:-3], -1, innovation.shape[-1]
    )
    found = [current]
    for time in reversed(range(jacobian.shape[-3])):
        current = closed[..., time, :, :].mT @ current - pushed[..., time, :, :]
        found.append(current)
    return torch.stack(found[::-1], -3)


def smooth(filtered: Filtered) -> Smoothed:
    r"""Return the states given all frames.

    The Rauch-Tung-Striebel smoother in the form of Bryson and Frazier (Bierman, 1973, Automatica
    9:503): with :math:`A_t = I - K_t H_t` and :math:`\hat\Lambda_T = 0`,

    .. math::
        \tilde\Lambda_t &= H_t^\top S_t^{-1} H_t + A_t^\top \hat\Lambda_t A_t, \qquad
        \hat\Lambda_{t-1} = F_{t-1}^\top \tilde\Lambda_t F_{t-1} \\
        P_{t|T} &= P_t - P_t \hat\Lambda_t P_t, \qquad
        \mathrm{Cov}(z_t, z_{t+1}) = P_t F_t^\top (I - \tilde\Lambda_{t+1} P_{t+1|t})

    It inverts the innovations' covariance alone, so that predicted covariances may be singular: of
    absent individuals, of positions that follow from velocities, or without process noise.
    """
    window, steps = filtered.system.window, filtered.system.steps
    gains = gains_of(filtered)
    covariance = filtered.covariance
    forces = backward(filtered, gains, gains.innovation.unsqueeze(-1))
    mean = filtered.mean - window.split((covariance @ forces).squeeze(-1))

    closed = gains.left[..., 1:, :, :] @ steps.jacobian
    pushed = gains.whitened[..., 1:, :, :] @ steps.jacobian
    current = torch.zeros_like(covariance[..., 0, :, :])
    found = [current]
    for time in reversed(range(window.num_times - 1)):
        turn, push = closed[..., time, :, :], pushed[..., time, :, :]
        current = symmetrize(push.mT @ push + turn.mT @ current @ turn)
        found.append(current)
    information = torch.stack(found[::-1], -3)
    smoothed = symmetrize(covariance - covariance @ information @ covariance)
    left, white = gains.left[..., 1:, :, :], gains.whitened[..., 1:, :, :]
    later = white.mT @ white + left.mT @ information[..., 1:, :, :] @ left
    eye = torch.eye(covariance.shape[-1], dtype=covariance.dtype, device=covariance.device)
    lag = (covariance[..., :-1, :, :] @ steps.jacobian.mT) @ (
        eye - later @ filtered.predicted_covariance[..., 1:, :, :]
    )
    return Smoothed(mean, smoothed, lag)
