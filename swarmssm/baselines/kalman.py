r"""A Kalman filter for each individual, whose velocity is a random walk."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from filterpy.kalman import KalmanFilter

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.filtered import (
    LEAST_TRACKING_ERROR,
    FilteredBaseline,
    typical_noise,
)
from swarmssm.baselines.jump_filter import Beliefs, JumpModel
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["KalmanVelocity", "OneModeModel", "random_walk_noise", "straight_motion"]


class KalmanVelocity(FilteredBaseline):
    r"""Each individual is tracked by a constant-velocity Kalman filter, and goes straight on.

    .. math:: v(t + 1) = v(t) + w, \quad w \sim N(0, q I) \qquad p(t + 1) = p(t) + dt\, v(t + 1)
        \qquad z(t) = p(t) + e, \quad e \sim N(0, r I)

    Velocity is that of the step that led to a frame, as everywhere in tracks; textbooks' white
    acceleration has the velocity at the moment of the frame instead, and half the noise's
    displacement. The filter sees positions only. The standard deviations of both noises are those
    that make the positions of the training part most probable; they are the only two numbers it
    learns. Where tracking is exact the filter is plain constant velocity; its worth is in noisy
    tracks, and in draws whose spread grows as that of a random walk does.
    """

    name: ClassVar[str] = "kalman"
    title: ClassVar[str] = "Kalman constant velocity"
    paper: ClassVar[str] = "Kalman 1960, doi:10.1115/1.3662552"

    @property
    def num_parameters(self) -> int:
        """Two standard deviations."""
        return 0 if self.model is None else 2

    @property
    def process_noise(self) -> float:
        """Standard deviation of the change of each velocity coordinate in a frame."""
        return float("nan") if self.model is None else float(np.sqrt(self.model.noises[0, -1, -1]))

    @property
    def tracking_noise(self) -> float:
        """Standard deviation of the tracking error of each coordinate."""
        return float("nan") if self.model is None else float(np.sqrt(self.model.tracking_variance))

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Find the noise levels by maximum likelihood."""
        self.differenced = self._is_differenced(states, fps)
        space = states.shape[-1] // 2
        velocity, step = typical_noise(states, fps)
        least = LEAST_TRACKING_ERROR * step

        def build(parameters: Array) -> JumpModel:
            process, tracking = np.exp(parameters)
            return OneModeModel(
                straight_motion(space, fps)[None],
                random_walk_noise(process, space, fps)[None],
                np.ones((1, 1)),
                float(tracking + least) ** 2,
                fps,
            )

        begin = [float(np.log(velocity)), float(np.log(0.1 * step))]
        self.model = build(self._most_likely(build, begin, states, training))


@dataclass(frozen=True)
class OneModeModel(JumpModel):
    """A jump model of one mode, followed by filterpy's Kalman filter.

    Gains and covariances depend on which frames are observed, not on what is observed: filterpy
    computes them once for all individuals that are observed in the same frames.
    """

    def follow(self, states: Array) -> tuple[Array, Array, Beliefs]:
        """Run the filter over a history, as :meth:`JumpModel.follow` does."""
        space, length = states.shape[-1] // 2, states.shape[-3]
        tracks = np.swapaxes(states, -3, -2)
        lead = tracks.shape[:-2]
        tracks = tracks.reshape(-1, length, 2 * space)
        whole = known(tracks)
        begun = np.logical_or.accumulate(whole, axis=1)
        # 0: not begun or not observed, 1: observed, 2: the first frame.
        pattern = (begun & known(tracks[..., :space])).astype(np.int8)
        pattern[begun & (np.cumsum(begun, axis=1) == 1)] = 2
        expected = np.full(tracks.shape, np.nan)
        densities = np.full(tracks.shape[:-1], np.nan)
        means = np.full((len(tracks), 2 * space), np.nan)
        covariances = np.full((len(tracks), 2 * space, 2 * space), np.nan)
        kinds, kind = np.unique(pattern, axis=0, return_inverse=True)
        for number, frames in enumerate(kinds):
            if 2 not in frames:
                continue
            rows = np.flatnonzero(kind.ravel() == number)
            found = self._alike(tracks[rows], frames)
            expected[rows], densities[rows], means[rows], covariances[rows] = found
        beliefs = Beliefs(
            np.where(np.isnan(means[:, :1]), np.nan, 1.0).reshape(*lead, 1),
            means.reshape(*lead, 1, 2 * space),
            covariances.reshape(*lead, 1, 2 * space, 2 * space),
        )
        return (
            np.swapaxes(expected.reshape(*lead, length, 2 * space), -3, -2),
            np.swapaxes(densities.reshape(*lead, length), -2, -1),
            beliefs,
        )

    def _alike(
        self, tracks: Array, frames: npt.NDArray[np.int8]
    ) -> tuple[Array, Array, Array, Array]:
        """Follow individuals that are observed in the same frames, ``(individual, time, state)``.

        Returns
        -------
        Next expected states, log densities, and the last mean and covariance.
        """
        space = tracks.shape[-1] // 2
        judge = KalmanFilter(dim_x=2 * space, dim_z=space)
        judge.F, judge.Q, judge.H = self.transitions[0], self.noises[0], np.eye(space, 2 * space)
        judge.R = self.tracking_variance * np.eye(space)
        judge.P = self._first_covariance(space)
        expected = np.full(tracks.shape, np.nan)
        densities = np.full(tracks.shape[:-1], np.nan)
        first = int(np.argmax(frames == 2))
        mean = tracks[:, first]
        nothing = np.zeros(space)
        for frame in range(first, len(frames)):
            if frames[frame] == 1:
                judge.update(nothing)
                innovation = tracks[:, frame, :space] - mean[:, :space]
                weighted = innovation @ judge.SI
                surprise = (weighted * innovation).sum(-1)
                volume = np.linalg.slogdet(2.0 * np.pi * judge.S)[1]
                densities[:, frame] = -0.5 * (surprise + volume)
                mean = mean + innovation @ judge.K.T
            last = mean, judge.P.copy()
            judge.predict()
            mean = mean @ judge.F.T
            expected[:, frame] = mean
        return expected, densities, last[0], last[1]


def straight_motion(space: int, fps: float) -> Array:
    """Return F of a motion straight on, ``(2 * space, 2 * space)``."""
    return np.asarray(np.kron(np.array([[1.0, 1.0 / fps], [0.0, 1.0]]), np.eye(space)))


def random_walk_noise(deviation: float, space: int, fps: float) -> Array:
    """Return Q of a velocity that changes by so much in a frame, and the position with it."""
    lever = np.array([1.0 / fps, 1.0])
    return np.asarray(np.kron(deviation**2 * np.outer(lever, lever), np.eye(space)))
