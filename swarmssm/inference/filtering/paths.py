"""Whole paths of a filtered swarm: draws from their posterior, and its density."""

import torch
from torch import Tensor

from swarmssm.inference.filtering.affine import Window
from swarmssm.inference.filtering.kalman_filter import LOG_2_PI, Filtered, backward, gains_of
from swarmssm.inference.filtering.matrices import cholesky, root

__all__ = ["draw_paths", "path_log_density"]


def draw_paths(filtered: Filtered, num: int, seed: int | torch.Generator | None = None) -> Tensor:
    r"""Draw paths from the joint posterior of all frames.

    The simulation smoother of Durbin and Koopman (2002, Biometrika 89:603), written for errors:
    filtering errors :math:`e_t` are drawn forwards, :math:`e_{t+1} = F_t (A_t e_t - K_t r_t) + q_t`
    with :math:`A_t = I - K_t H_t`, and carried backwards together with the data. These are the
    closed-loop dynamics of the filter, so that nothing grows where the system itself is unstable;
    and no covariance of states is inverted.

    Under a kinematic transition noise is drawn for velocities alone. Of the drawn path, the states
    in which an individual enters and all later velocities are kept, and the positions between are
    those that follow from them, :math:`p' = p + dt\, v'`, to the last digit.

    Parameters
    ----------
    filtered
        Of any of the Gaussian filters. The draws are differentiable in what it was made of.
    num
        Number of paths for each window.
    seed
        Of the noise; absent, torch's own generator goes on.

    Returns
    -------
    ``(num, batch, time, individual, state)``; 0 where nobody is present.
    """
    system = filtered.system
    window, steps = system.window, system.steps
    generator = torch.Generator().manual_seed(seed) if isinstance(seed, int) else seed
    gains = gains_of(filtered)
    frames = filtered.mean.shape[:-2]

    # Draws are columns, so that each frame takes one product for all of them.
    def noise(size: int) -> Tensor:
        drawn = torch.randn(*frames, size, num, generator=generator, dtype=filtered.mean.dtype)
        return drawn.to(filtered.mean.device)

    disturbance = noise_roots(filtered) @ noise(steps.mean.shape[-1])
    tracking = root(system.observations.noise) @ noise(system.observations.mean.shape[-1])
    tracking = torch.where(window.mask.unsqueeze(-1), tracking, 0.0)

    lost = gains.gain @ tracking
    error = disturbance[..., 0, :, :]
    predicted, kept = [], []
    for time in range(window.num_times):
        if time:
            error = steps.jacobian[..., time - 1, :, :] @ error + disturbance[..., time, :, :]
        predicted.append(error)
        error = gains.left[..., time, :, :] @ error - lost[..., time, :, :]
        kept.append(error)
    drawn_innovation = tracking + system.observations.jacobian @ torch.stack(predicted, -3)
    forces = backward(filtered, gains, gains.innovation.unsqueeze(-1) - drawn_innovation)
    errors = torch.stack(kept, -3) - filtered.covariance @ forces
    joint = filtered.mean.flatten(-2) + errors.movedim(-1, 0)
    return settle_positions(window, joint)


def path_log_density(filtered: Filtered, paths: Tensor) -> Tensor:
    r"""Return the log-density of whole paths under the posterior that was filtered.

    .. math::
        \log q(z_{1:T} \mid x) = \log p(z_{1:T}) + \log p(x \mid z_{1:T}) - \log p(x)

    in the linear Gaussian system of the filter. Under a kinematic transition it is a density over
    the first states and later velocities.

    Parameters
    ----------
    filtered
        Of any of the Gaussian filters.
    paths
        ``(..., batch, time, individual, state)``, on the surface on which positions follow.

    Returns
    -------
    ``(..., batch)``.
    """
    system = filtered.system
    window, steps = system.window, system.steps
    joint = paths.flatten(-2)
    there = window.there[..., 0, :]
    first = joint[..., 0, :] - torch.where(there, window.initial_mean, 0.0)
    later = joint[..., 1:, :] - steps(joint[..., :-1, :])
    free = window.stochastic_features
    residual = torch.where(free, torch.cat([first.unsqueeze(-2), later], -2), 0.0)
    prior = _log_normal(residual, cholesky(_free_noise(filtered), "of the noise of a step"), free)
    gap = torch.where(window.mask, window.observations - system.observations(joint), 0.0)
    tracking = cholesky(system.observations.noise, "of the noise of an observation")
    seen = _log_normal(gap, tracking, window.mask)
    return prior + seen - filtered.log_evidence


def settle_positions(window: Window, joint: Tensor) -> Tensor:
    """Return drawn joint states as paths, with positions that follow from the velocities.

    Parameters
    ----------
    window
        Tells whose positions follow.
    joint
        ``(..., batch, time, joint)``.

    Returns
    -------
    ``(..., batch, time, individual, state)``; 0 where nobody is present.
    """
    states = window.split(torch.where(window.there, joint, 0.0))
    if window.dt is None:
        return states
    half = window.features // 2
    drawn, velocity = states[..., :half], states[..., half:]
    persists = window.split(window.persists)[..., :half]
    position = drawn[..., 0, :, :]
    positions = [position]
    for time in range(1, window.num_times):
        moved = position + window.dt * velocity[..., time, :, :]
        position = torch.where(persists[..., time - 1, :, :], moved, drawn[..., time, :, :])
        positions.append(position)
    return torch.cat([torch.stack(positions, -3), velocity], -1)


def noise_roots(filtered: Filtered) -> Tensor:
    """Return square roots of the covariances of the noise that leads to each frame.

    Returns
    -------
    ``(batch, time, joint, joint)``; of the first frame, of the initial distribution.
    """
    window = filtered.system.window
    free = window.stochastic_features
    factor = root(_free_noise(filtered))
    factor = torch.where(free.unsqueeze(-1) & free.unsqueeze(-2), factor, 0.0)
    if window.dt is None:
        return factor
    # A position that is not free has the noise of its own velocity, times dt.
    half = window.features // 2
    joint = factor.shape[-1]
    rows = factor.reshape(*factor.shape[:-2], window.individuals, window.features, joint)
    velocity = rows[..., half:, :]
    own = window.split(free)[..., :half]
    there = window.present.unsqueeze(-1)
    follows = (there & ~own).unsqueeze(-1)
    position = torch.where(follows, window.dt * velocity, rows[..., :half, :])
    return torch.cat([position, velocity], -2).flatten(-3, -2)


def _free_noise(filtered: Filtered) -> Tensor:
    """Return the noise of each frame's free features, and 1 for the rest."""
    window = filtered.system.window
    free = window.stochastic_features
    noise = torch.cat([window.initial_covariance.unsqueeze(-3), filtered.system.steps.noise], -3)
    eye = torch.eye(free.shape[-1], dtype=noise.dtype, device=noise.device)
    return torch.where(free.unsqueeze(-1) & free.unsqueeze(-2), noise, eye)


def _log_normal(residual: Tensor, factor: Tensor, counted: Tensor) -> Tensor:
    """Return the log-density of residuals, those not counted being 0 with variance 1."""
    shape = residual.shape
    white = torch.linalg.solve_triangular(
        factor, residual.reshape(-1, *factor.shape[:-1]).movedim(0, -1), upper=False
    )
    square = white.square().sum(-2).movedim(-1, 0).reshape(shape[:-1])
    logdet = factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    density: Tensor = (-0.5 * (square + counted.to(square.dtype).sum(-1) * LOG_2_PI) - logdet).sum(
        -1
    )
    return density
