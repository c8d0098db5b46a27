"""Unknown frames of a history, filled by going on, or back, at constant velocity."""

from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["fill_gaps"]


def fill_gaps(states: Array, fps: float) -> Array:
    """Fill each individual's unknown frames up to the last one in which it is known.

    Before an individual is first known it is taken to have come at the velocity it is then seen
    with: ``p(t) = p(t + 1) - v(t + 1) / fps``. In a gap, going on from the frame before it and back
    from the one after it are averaged, each with a weight that falls linearly from 1 at its own
    end to 0 at the other, so that the filled path has no jump. Frames after an individual was last
    known stay unknown, as do those of one who is never known.

    Parameters
    ----------
    states
        Shape ``(..., time, individual, state)``, ordered ``[x, y, vx, vy]``, NaN where unknown.
    fps
        Frames per second.

    Returns
    -------
    Same shape. A number that was known stays as it was, also where the rest of its frame was not.
    """
    seen = known(states)
    frames = np.arange(states.shape[-3])[:, None]
    last = np.maximum.accumulate(np.where(seen, frames, -1), axis=-2)
    following = np.where(seen, frames, states.shape[-3])
    following = np.flip(np.minimum.accumulate(np.flip(following, -2), axis=-2), -2)
    before, after = last >= 0, following < states.shape[-3]
    forward = _moved(states, np.where(before, last, 0), frames, fps)
    backward = _moved(states, np.where(after, following, 0), frames, fps)
    span = np.where(before & after & (following > last), following - last, 1)
    share = np.where(before, (frames - last) / span, 1.0)[..., None]
    # 0 * NaN is NaN: who was not known before has no forward path to average with.
    filled = share * backward + (1.0 - share) * np.where(before[..., None], forward, 0.0)
    filled = np.where(after[..., None], filled, np.nan)
    return np.where(np.isnan(states), filled, states)


def _moved(states: Array, source: npt.NDArray[Any], frames: npt.NDArray[Any], fps: float) -> Array:
    """Return the states of the source frames, moved to each frame at constant velocity."""
    start = np.take_along_axis(states, source[..., None], axis=-3)
    position, velocity = np.split(start, 2, axis=-1)
    seconds = ((frames - source) / fps)[..., None]
    return np.asarray(np.concatenate([position + velocity * seconds, velocity], axis=-1))
