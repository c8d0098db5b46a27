r"""A Kalman filter for each individual, whose velocity is a random walk."""

from typing import ClassVar

import numpy as np

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.filtered import (
    LEAST_TRACKING_ERROR,
    FilteredBaseline,
    typical_noise,
)
from swarmssm.baselines.jump_filter import JumpModel
from swarmssm.tracks import Array

__all__ = ["KalmanVelocity", "random_walk_noise", "straight_motion"]


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
            return JumpModel(
                straight_motion(space, fps)[None],
                random_walk_noise(process, space, fps)[None],
                np.ones((1, 1)),
                float(tracking + least) ** 2,
                fps,
            )

        begin = [float(np.log(velocity)), float(np.log(0.1 * step))]
        self.model = build(self._most_likely(build, begin, states, training))


def straight_motion(space: int, fps: float) -> Array:
    """Return F of a motion straight on, ``(2 * space, 2 * space)``."""
    return np.asarray(np.kron(np.array([[1.0, 1.0 / fps], [0.0, 1.0]]), np.eye(space)))


def random_walk_noise(deviation: float, space: int, fps: float) -> Array:
    """Return Q of a velocity that changes by so much in a frame, and the position with it."""
    lever = np.array([1.0 / fps, 1.0])
    return np.asarray(np.kron(deviation**2 * np.outer(lever, lever), np.eye(space)))
