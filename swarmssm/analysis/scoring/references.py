"""The two forecasts that anybody would try first, to which every model is compared."""

from typing import ClassVar

import numpy as np

from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.tracks import Array

__all__ = ["REFERENCES", "ConstantVelocity", "StayPut"]


class StayPut(Baseline):
    """Each state, position and velocity, stays as it was last seen.

    On one step its MAE (4.3) is 1 by construction: L is the mean error of just this forecast.
    """

    name: ClassVar[str] = "stay-put"
    title: ClassVar[str] = "stay put"

    def step(self, window: Array, fps: float) -> Array:
        """Return the last state."""
        return window[..., -1, :, :]


class ConstantVelocity(Baseline):
    """Each individual goes straight on with the velocity it was last seen with."""

    name: ClassVar[str] = "constant-velocity"
    title: ClassVar[str] = "constant velocity"

    def step(self, window: Array, fps: float) -> Array:
        """Return the last state, moved on by its velocity."""
        position, velocity = np.split(window[..., -1, :, :], 2, axis=-1)
        return np.concatenate([position + velocity / fps, velocity], axis=-1)


#: Name -> baseline, in the order of tables.
REFERENCES: dict[str, type[Baseline]] = {
    baseline.name: baseline for baseline in (StayPut, ConstantVelocity)
}
