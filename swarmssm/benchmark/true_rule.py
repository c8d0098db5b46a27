"""The rule that simulated tracks were made by, as a method that nobody can beat but by chance."""

from typing import ClassVar

import numpy as np
import torch

from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.benchmark.task import Task
from swarmssm.errors import InputError
from swarmssm.metrics.masked import known
from swarmssm.simulate import Dynamics, dynamics_of
from swarmssm.simulate.particles import Particles
from swarmssm.tracks import Array

__all__ = ["TrueRule", "has_floor", "true_rule"]


class TrueRule(Baseline):
    """Step of the law from the true state, without noise; with a generator, with the law's own.

    Who sees somebody whose state is unknown has no known step: nobody is forecast then.
    """

    name: ClassVar[str] = "noise-floor"
    title: ClassVar[str] = "true rule (noise floor)"
    knows_true_form: ClassVar[bool] = True

    def __init__(self, law: Dynamics) -> None:
        super().__init__()
        self.law = law

    def step(self, window: Array, fps: float) -> Array:
        """Return the next state free of noise."""
        return self._moved(window[..., -1, :, :], None)

    def predict(
        self,
        states: Array,
        horizon: int,
        fps: float,
        generator: np.random.Generator | None = None,
    ) -> Array:
        """Go on from the last frame."""
        noise = None
        if generator is not None:
            noise = torch.Generator().manual_seed(int(generator.integers(2**62)))
        now = states[..., -1, :, :]
        path = []
        for _ in range(horizon):
            now = self._moved(now, noise)
            path.append(now)
        return np.stack(path, axis=-3)

    def _moved(self, states: Array, generator: torch.Generator | None) -> Array:
        """Return the next states, NaN in frames in which somebody is unknown."""
        shape = states.shape
        flat = states.reshape(-1, *shape[-2:])
        whole = np.logical_and.reduce(known(flat), axis=-1)
        out = np.full(flat.shape, np.nan)
        if whole.any():
            position, velocity = np.split(flat[whole], 2, axis=-1)
            at, speed = torch.from_numpy(position.copy()), torch.from_numpy(velocity.copy())
            force, _ = self.law.forces(at, speed)
            out[whole] = torch.cat(self.law.move(at, speed, force, generator), dim=-1).numpy()
        return out.reshape(shape)


def has_floor(task: Task) -> bool:
    """Return whether the tracks are simulated, with noise, and their true states are known."""
    try:
        true_rule(task)
    except InputError:
        return False
    return True


def true_rule(task: Task) -> TrueRule:
    """Return the rule of a task's tracks.

    Raises
    ------
    InputError
        If it is not known, needs states that are not, or is free of noise.
    """
    law = dynamics_of(task.tracks)
    if isinstance(law, Particles):
        raise InputError("noise-floor: the particles move without noise, so that the floor is 0.")
    if not task.exact:
        raise InputError("noise-floor: the tracks are noisy, and the true states are not given.")
    return TrueRule(law)
