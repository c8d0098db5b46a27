"""What scores need to know of the frames that are scored."""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from swarmssm.tracks import Array

__all__ = ["Scored"]


class Scored(Protocol):
    """Frames that are scored, such as a :class:`swarmssm.analysis.scoring.subject.Subject`."""

    @property
    def states(self) -> Array:
        """The truth ``(trial, time, individual, state)`` in the tracks' units, NaN: unknown."""

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """Where the truth is known, ``(trial, time, individual)``."""

    @property
    def num_space(self) -> int:
        """Number of spatial dimensions."""

    @property
    def fps(self) -> float:
        """Frames per second."""

    def ahead(
        self, trials: npt.NDArray[np.int64], rows: npt.NDArray[np.int64], steps: int
    ) -> Array:
        """Return what came after each start, ``(start, step, individual, state)``."""
