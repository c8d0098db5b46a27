"""Nothing changes."""

from typing import ClassVar

from swarmssm.baselines.base import Baseline
from swarmssm.tracks import Array

__all__ = ["StayPut"]


class StayPut(Baseline):
    """Each state, position and velocity, stays as it was last seen.

    On one step its MAE (4.3) is 1 by construction: L is the mean error of just this forecast.
    """

    name: ClassVar[str] = "stay-put"
    title: ClassVar[str] = "stay put"

    def step(self, window: Array, fps: float) -> Array:
        """Return the last state."""
        return window[..., -1, :, :]
