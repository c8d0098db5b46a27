r"""Interacting multiple models: an individual goes straight on, swerves, or turns."""

from typing import ClassVar

import numpy as np

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.filtered import (
    LEAST_TRACKING_ERROR,
    FilteredBaseline,
    typical_noise,
)
from swarmssm.baselines.jump_filter import JumpModel
from swarmssm.baselines.kalman import random_walk_noise, straight_motion
from swarmssm.tracks import Array

__all__ = ["InteractingModels", "turning_motion"]


class InteractingModels(FilteredBaseline):
    r"""Each individual is tracked by several Kalman filters that exchange what they believe.

    The modes are those of
    :class:`~swarmssm.baselines.kalman.KalmanVelocity` with little process noise
    (cruising) and with much (manoeuvring) and, in two dimensions, two coordinated turns at a
    constant rate :math:`\omega`, to the left and to the right, with little noise:

    .. math:: v(t + 1) = R(\pm \omega\, dt)\, v(t) + w \qquad p(t + 1) = p(t) + dt\, v(t + 1)

    An individual stays in its mode with one probability, and leaves it for each of the others
    alike. Blom and Bar-Shalom leave the levels of noise, the rate and the probability to the
    user's knowledge of the vehicle; here they are those that make the positions of the training
    part most probable under the filter: two process noises, the tracking noise, the probability and
    the rate, five numbers.
    """

    name: ClassVar[str] = "imm"
    title: ClassVar[str] = "interacting multiple models"
    paper: ClassVar[str] = "Blom and Bar-Shalom 1988, doi:10.1109/9.1299"

    @property
    def num_parameters(self) -> int:
        """Noise levels, probability of staying and, in two dimensions, the rate of turning."""
        if self.model is None:
            return 0
        return 5 if self.model.transitions.shape[-1] == 4 else 4

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Find the five numbers by maximum likelihood."""
        self.differenced = self._is_differenced(states, fps)
        space = states.shape[-1] // 2
        velocity, step = typical_noise(states, fps)
        least = LEAST_TRACKING_ERROR * step

        def build(parameters: Array) -> JumpModel:
            low, more, tracking = np.exp(parameters[:3])
            stay = 1.0 / (1.0 + np.exp(-parameters[3]))
            cruising = random_walk_noise(low, space, fps)
            transitions = [straight_motion(space, fps)] * 2
            noises = [cruising, random_walk_noise(low + more, space, fps)]
            if space == 2:
                # Parameters are free numbers; a turn is at most a half one in a frame.
                rate = np.pi / (1.0 + np.exp(-parameters[4]))
                transitions += [turning_motion(rate, fps), turning_motion(-rate, fps)]
                noises += [cruising, cruising]
            modes = len(noises)
            switching = np.full((modes, modes), (1.0 - stay) / (modes - 1))
            np.fill_diagonal(switching, stay)
            variance = float(tracking + least) ** 2
            return JumpModel(np.stack(transitions), np.stack(noises), switching, variance, fps)

        begin = [np.log(0.5 * velocity), np.log(velocity), np.log(0.1 * step), 2.0]
        if space == 2:
            angle = np.clip(velocity / (fps * step), 1e-3, 1.0)
            begin.append(np.log(angle / (np.pi - angle)))
        begin = [float(value) for value in begin]
        self.model = build(self._most_likely(build, begin, states, training))


def turning_motion(angle: float, fps: float) -> Array:
    """Return F of a turn by an angle in each frame, counterclockwise, ``(4, 4)``."""
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    still = np.eye(2)
    return np.block([[still, turned / fps], [np.zeros((2, 2)), turned]])
