"""Steps that are errors of tracking, not motion."""

import numpy as np
import numpy.typing as npt

from swarmssm.tracks.time_grid import Array

__all__ = ["find_jumps"]

#: A step above the top speed is an error if it is this many times the steps beside it.
BEYOND_NEIGHBORS = 10.0
#: One far above it, this many times the top speed, needs to stand out by less.
FAR_BEYOND_TOP = 4.0
FAR_BEYOND_NEIGHBORS = 3.0
#: Quantile of the sustained speeds that counts as the top speed.
TOP = 0.99


def find_jumps(position: Array) -> npt.NDArray[np.bool_]:
    """Return which steps look like errors of tracking.

    The top speed is the 99 % quantile of the speeds that are sustained: of the median over three
    steps, which a single step does not reach. A step above the top speed is an error of tracking
    if it stands out: if it is ten times as long as the step before it and the step after it, or
    three times where it is beyond four times the top speed. A step that leads back to where the
    one before it came from (the individual was elsewhere for one frame) is judged by the steps
    around both.

    The start of a burst does not stand out, as the animal goes on moving.

    Parameters
    ----------
    position
        Shape ``(..., time, individual, space)``, NaN where not tracked.

    Returns
    -------
    Shape ``(..., time - 1, individual)``, true for the step from one frame to the next.
    """
    moves = np.diff(position, axis=-3)
    steps = np.linalg.norm(moves, axis=-1)
    earlier2, earlier, later, later2 = (_shifted(steps, by) for by in (-2, -1, 1, 2))
    sustained = np.median(np.stack([earlier, steps, later]), axis=0)
    sustained = sustained[np.isfinite(sustained)]
    if not sustained.size:
        return np.zeros(steps.shape, dtype=bool)
    top = np.quantile(sustained, TOP)

    # The displacement over a step and the next one, which leads back where it is short.
    over_two = np.linalg.norm(moves[..., :-1, :, :] + moves[..., 1:, :, :], axis=-1)
    is_undone = FAR_BEYOND_NEIGHBORS * over_two < np.minimum(steps[..., :-1, :], steps[..., 1:, :])
    none = np.zeros_like(steps[..., :1, :], dtype=bool)
    goes = np.concatenate([is_undone, none], axis=-2)
    returns = np.concatenate([none, is_undone], axis=-2)
    beside = np.fmax(earlier, later)
    beside = np.where(goes, np.fmax(earlier, later2), beside)
    beside = np.where(returns, np.fmax(earlier2, later), beside)
    # Nothing beside it is known: nothing can be said.
    factor = np.where(steps > FAR_BEYOND_TOP * top, FAR_BEYOND_NEIGHBORS, BEYOND_NEIGHBORS)
    jumps: npt.NDArray[np.bool_] = (steps > factor * beside) & (steps > top)
    return jumps


def _shifted(steps: Array, by: int) -> Array:
    """Return the steps so many frames later, unknown where there are none."""
    out = np.full_like(steps, np.nan)
    count = steps.shape[-2]
    if abs(by) < count:
        out[..., max(-by, 0) : count - max(by, 0), :] = steps[
            ..., max(by, 0) : count + min(by, 0), :
        ]
    return out
