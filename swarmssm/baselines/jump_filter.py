r"""Filtering of individuals that each move in one of several linear ways, and switch between them.

In mode *m* the state :math:`s = (p, v)` of an individual goes

.. math:: s(t + 1) = F_m s(t) + w, \quad w \sim N(0, Q_m) \qquad
    z(t) = p(t) + e, \quad e \sim N(0, r I)

and the mode is a Markov chain. With one mode the filter is that of Kalman (1960); with several it
is the interacting multiple model estimator of Blom and Bar-Shalom (1988), which before each step
blends the modes' beliefs into one normal distribution a mode. The recursions are those of
filterpy's ``IMMEstimator``, to which tests hold them, written for all individuals of all trials at
once. filterpy follows one individual at a time, and the covariances of several modes depend on what
is observed, so that nothing can be shared: a frame of four modes takes it 720 microseconds, and 7
here. Learning and scoring look at about a million frames: 12 minutes, or 7 seconds. With one mode
covariances can be shared, and filterpy computes them, see
:class:`swarmssm.baselines.kalman.OneModeModel`.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["Beliefs", "JumpModel"]


@dataclass(frozen=True)
class Beliefs:
    """What a filter believes of individuals in one frame; NaN before they were seen.

    Attributes
    ----------
    weights
        Probability of each mode, ``(..., individual, mode)``.
    means
        Shape ``(..., individual, mode, state)``.
    covariances
        Shape ``(..., individual, mode, state, state)``.
    """

    weights: Array
    means: Array
    covariances: Array

    @property
    def mean(self) -> Array:
        """Mean over the modes, ``(..., individual, state)``."""
        return np.asarray((self.weights[..., None] * self.means).sum(axis=-2))

    def repeated(self, times: int) -> "Beliefs":
        """Return the same beliefs so many times, along a new first axis."""
        parts = (self.weights, self.means, self.covariances)
        return Beliefs(*(np.broadcast_to(part, (times, *part.shape)) for part in parts))


@dataclass(frozen=True)
class JumpModel:
    """Linear motions, and how the mode changes from one to another.

    Attributes
    ----------
    transitions, noises
        F and Q of each mode, ``(mode, state, state)``.
    switching
        Probability of going from one mode to another, ``(mode, mode)``; rows sum to 1.
    tracking_variance
        *r*, in squared units of length.
    fps
        Frames per second.
    """

    transitions: Array
    noises: Array
    switching: Array
    tracking_variance: float
    fps: float

    def follow(self, states: Array) -> tuple[Array, Array, Beliefs]:
        """Run the filter over a history.

        It begins where an individual's position and velocity are first known, the velocity taken
        for a backward difference of tracked positions; from there on it sees positions only. Where
        there is none, it goes on without.

        Parameters
        ----------
        states
            Shape ``(..., time, individual, state)``.

        Returns
        -------
        The next state to be expected from each frame, ``(..., time, individual, state)``; the log
        density of each position given those before it, ``(..., time, individual)``, NaN where
        there is none; and the beliefs in the last frame.
        """
        num_modes, space = len(self.transitions), states.shape[-1] // 2
        uniform = np.full(num_modes, 1.0 / num_modes)
        first = self._first_covariance(space)
        shape = (*states.shape[:-3], *states.shape[-2:])
        ahead = Beliefs(
            np.full((*shape[:-1], num_modes), np.nan),
            np.full((*shape[:-1], num_modes, shape[-1]), np.nan),
            np.full((*shape[:-1], num_modes, shape[-1], shape[-1]), np.nan),
        )
        expected = np.full_like(states, np.nan)
        densities = np.full(states.shape[:-1], np.nan)
        begun = np.zeros(shape[:-1], dtype=bool)
        now = ahead
        for frame in range(states.shape[-3]):
            seen = states[..., frame, :, :]
            measured = begun & known(seen[..., :space])
            begins = ~begun & known(seen)
            now = ahead
            if measured.any():
                now, density = self._update(ahead, seen[..., :space], measured)
                densities[..., frame, :] = density
            if begins.any():
                here = begins[..., None]
                now = Beliefs(
                    np.where(here, uniform, now.weights),
                    np.where(here[..., None], seen[..., None, :], now.means),
                    np.where(here[..., None, None], first, now.covariances),
                )
                begun = begun | begins
            ahead = self._predict(now)
            expected[..., frame, :, :] = ahead.mean
        return expected, densities, now

    def expect(self, beliefs: Beliefs, horizon: int) -> Array:
        """Return the expected states of the next steps, ``(..., horizon, individual, state)``."""
        path = []
        weights, means = beliefs.weights, beliefs.means
        for _ in range(horizon):
            # Mean and probability of each mode travel together: exact for a linear motion.
            following = weights @ self.switching
            shares = self.switching * weights[..., :, None] / following[..., None, :]
            blended = np.swapaxes(shares, -1, -2) @ means
            means = (self.transitions @ blended[..., None])[..., 0]
            weights = following
            path.append((weights[..., None] * means).sum(axis=-2))
        return np.stack(path, axis=-3)

    def draw(self, beliefs: Beliefs, horizon: int, generator: np.random.Generator) -> Array:
        """Draw states of the next steps as they would be tracked.

        Returns
        -------
        Shape ``(..., horizon, individual, state)``; positions with their tracking error.
        """
        shape = beliefs.means.shape[:-2]
        space = beliefs.means.shape[-1] // 2
        mode = _draw_mode(np.cumsum(beliefs.weights, axis=-1), generator)
        picked = np.take_along_axis(beliefs.means, mode[..., None, None], axis=-2)[..., 0, :]
        spread = np.take_along_axis(beliefs.covariances, mode[..., None, None, None], axis=-3)
        # A NaN belief has no root; NaN means keep who is not followed out of the result.
        roots = _root(np.where(np.isnan(spread[..., 0, :, :]), 0.0, spread[..., 0, :, :]))
        size = (*shape, 2 * space)
        state = picked + (roots @ generator.standard_normal((*size, 1)))[..., 0]
        noise_roots, chances = _root(self.noises), np.cumsum(self.switching, axis=-1)
        error = np.sqrt(self.tracking_variance)
        path = []
        for _ in range(horizon):
            mode = _draw_mode(chances[mode], generator)
            noise = noise_roots[mode] @ generator.standard_normal((*size, 1))
            state = (self.transitions[mode] @ state[..., None] + noise)[..., 0]
            tracked = state.copy()
            tracked[..., :space] += error * generator.standard_normal((*shape, space))
            path.append(tracked)
        return np.stack(path, axis=-3)

    def _predict(self, now: Beliefs) -> Beliefs:
        """Blend the beliefs of the modes, and move each on."""
        weights = now.weights @ self.switching
        # shares[i, j]: of what is in mode j in the next step, how much comes from mode i.
        shares = self.switching * now.weights[..., :, None] / weights[..., None, :]
        means = np.swapaxes(shares, -1, -2) @ now.means
        covariances = now.covariances
        if len(self.transitions) > 1:
            apart = now.means[..., :, None, :] - means[..., None, :, :]
            apart = np.swapaxes(apart, -3, -2)
            weighted = np.swapaxes(shares, -1, -2)[..., None] * apart
            flat = covariances.reshape(*covariances.shape[:-2], -1)
            within = (np.swapaxes(shares, -1, -2) @ flat).reshape(covariances.shape)
            covariances = within + np.swapaxes(weighted, -1, -2) @ apart
        turned = self.transitions.swapaxes(-1, -2)
        return Beliefs(
            weights,
            (self.transitions @ means[..., None])[..., 0],
            self.transitions @ covariances @ turned + self.noises,
        )

    def _update(
        self, ahead: Beliefs, position: Array, measured: npt.NDArray[np.bool_]
    ) -> tuple[Beliefs, Array]:
        """Take in positions of those who are measured; return beliefs and log densities."""
        space = position.shape[-1]
        innovation = position[..., None, :] - ahead.means[..., :space]
        spread = ahead.covariances[..., :space, :space] + self.tracking_variance * np.eye(space)
        # Who is not measured may have no belief yet.
        spread = np.where(measured[..., None, None, None], spread, np.eye(space))
        inverse = np.linalg.inv(spread)
        gain = ahead.covariances[..., :, :space] @ inverse
        surprise = (innovation * (inverse @ innovation[..., None])[..., 0]).sum(axis=-1)
        log_volume = np.log(np.linalg.det(2.0 * np.pi * spread))
        log_density = -0.5 * (surprise + log_volume)
        joint = np.log(ahead.weights) + log_density
        highest = joint.max(axis=-1, keepdims=True)
        total = highest + np.log(np.exp(joint - highest).sum(axis=-1, keepdims=True))
        means = ahead.means + (gain @ innovation[..., None])[..., 0]
        # Joseph's form stays positive where the tracking error is next to nothing.
        kept = np.eye(2 * space) - np.concatenate([gain, np.zeros_like(gain)], axis=-1)
        error = self.tracking_variance * gain @ gain.swapaxes(-1, -2)
        covariances = kept @ ahead.covariances @ kept.swapaxes(-1, -2) + error
        here = measured[..., None]
        beliefs = Beliefs(
            np.where(here, np.exp(joint - total), ahead.weights),
            np.where(here[..., None], means, ahead.means),
            np.where(here[..., None, None], covariances, ahead.covariances),
        )
        return beliefs, np.where(measured, total[..., 0], np.nan)

    def _first_covariance(self, space: int) -> Array:
        """Return the covariance of a tracked position and the difference of two of them."""
        one = np.array([[1.0, self.fps], [self.fps, 2.0 * self.fps**2]])
        return np.asarray(np.kron(self.tracking_variance * one, np.eye(space)))


def _draw_mode(chances: Array, generator: np.random.Generator) -> npt.NDArray[np.int64]:
    """Draw modes by their cumulated probabilities, ``(..., mode)``."""
    drawn = generator.random(chances.shape[:-1])
    mode: npt.NDArray[np.int64] = (drawn[..., None] > chances[..., :-1]).sum(axis=-1)
    return mode


def _root(matrices: Array) -> Array:
    """Return roots of covariances that may be singular."""
    values, vectors = np.linalg.eigh(matrices)
    return np.asarray(vectors * np.sqrt(values.clip(min=0.0))[..., None, :])
