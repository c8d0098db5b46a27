"""Everyone goes straight on."""

from typing import ClassVar

import numpy as np

from swarmssm.baselines.base import Baseline
from swarmssm.tracks import Array

__all__ = ["ConstantVelocity"]


class ConstantVelocity(Baseline):
    """Each individual goes straight on with the velocity it was last seen with."""

    name: ClassVar[str] = "constant-velocity"
    title: ClassVar[str] = "constant velocity"

    def step(self, window: Array, fps: float) -> Array:
        """Return the last state, moved on by its velocity."""
        position, velocity = np.split(window[..., -1, :, :], 2, axis=-1)
        return np.concatenate([position + velocity / fps, velocity], axis=-1)
