"""How long motion remembers: turns, autocorrelations, mean squared displacement.

Arrays are ``(..., time, individual, space)``, NaN where unknown; any number of leading axes, over
which means go too. A lag counts a pair of frames only if the individual is known in both.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.metrics.masked import Array, as_array, ratio

__all__ = [
    "heading_autocorrelation",
    "mean_squared_displacement",
    "turning_angles",
    "velocity_autocorrelation",
]

AXES = "time, individual, space"


def turning_angles(velocities: npt.ArrayLike) -> Array:
    """Return by how much each individual turns from one frame to the next.

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, space 2 or 3, NaN where unknown.

    Returns
    -------
    Shape ``(..., time - 1, individual)``, radians. In 2-D from -pi to pi, positive from x towards
    y; in 3-D, where a turn has an axis and no sign, from 0 to pi. NaN where a velocity is unknown
    or 0.

    Raises
    ------
    InputError
        If ``velocities`` has too few axes or holds infinite values.
    """
    array = as_array(velocities, "velocities", AXES)
    before, after = array[..., :-1, :, :], array[..., 1:, :, :]
    dot = (before * after).sum(-1)
    if array.shape[-1] == 2:
        cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    else:
        cross = np.linalg.norm(np.cross(before, after), axis=-1)
    moving = (np.linalg.norm(before, axis=-1) > 0) & (np.linalg.norm(after, axis=-1) > 0)
    return np.where(moving, np.arctan2(cross, dot), np.nan)


def mean_squared_displacement(positions: npt.ArrayLike, lags: Sequence[int]) -> Array:
    r"""Return how far individuals get in a while.

    .. math:: C_X(\tau) = \langle |p_i(t + \tau) - p_i(t)|^2 \rangle_{i, t}

    Parameters
    ----------
    positions
        Shape ``(..., time, individual, space)``, NaN where unknown.
    lags
        Whole numbers of frames, not negative.

    Returns
    -------
    Shape ``(lag,)``, in the unit of the positions squared; NaN for a lag that no individual is
    followed through.

    Raises
    ------
    InputError
        If ``positions`` has too few axes or holds infinite values, or a lag is negative.
    """
    array = as_array(positions, "positions", AXES)
    return _over_lags(array, lags, lambda first, later: ((later - first) ** 2).sum(-1))


def velocity_autocorrelation(velocities: npt.ArrayLike, lags: Sequence[int]) -> Array:
    r"""Return how alike velocities are a while apart: 1 at once.

    .. math::
        C_V(\tau) = \frac{\langle v_i(t + \tau) \cdot v_i(t) \rangle}{\langle |v_i(t)|^2 \rangle}

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, NaN where unknown.
    lags
        Whole numbers of frames, not negative.

    Returns
    -------
    Shape ``(lag,)``; NaN for a lag that no individual is followed through, and where nobody moves.

    Raises
    ------
    InputError
        If ``velocities`` has too few axes or holds infinite values, or a lag is negative.
    """
    array = as_array(velocities, "velocities", AXES)
    products = _over_lags(array, lags, lambda first, later: (later * first).sum(-1))
    return ratio(products, _over_lags(array, [0], lambda v, _: (v * v).sum(-1)))


def heading_autocorrelation(velocities: npt.ArrayLike, lags: Sequence[int]) -> Array:
    r"""Return how alike headings are a while apart: 1 at once, 0 when forgotten.

    .. math:: C_\theta(\tau) = \langle \hat v_i(t + \tau) \cdot \hat v_i(t) \rangle_{i, t}

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, NaN where unknown. Who stands still has no
        heading.
    lags
        Whole numbers of frames, not negative.

    Returns
    -------
    Shape ``(lag,)``; NaN for a lag that no individual is followed through.

    Raises
    ------
    InputError
        If ``velocities`` has too few axes or holds infinite values, or a lag is negative.
    """
    array = as_array(velocities, "velocities", AXES)
    heading = ratio(array, np.linalg.norm(array, axis=-1, keepdims=True))
    return _over_lags(heading, lags, lambda first, later: (later * first).sum(-1))


def _over_lags(array: Array, lags: Sequence[int], of: Callable[[Array, Array], Array]) -> Array:
    """Return the mean of a function of two frames over all that are a lag apart."""
    means = np.full(len(lags), np.nan)
    for place, lag in enumerate(lags):
        if lag < 0:
            raise InputError(f"lags: they must not be negative, and one is {lag}.")
        first, later = array[..., : array.shape[-3] - lag, :, :], array[..., lag:, :, :]
        values = of(first, later) if lag < array.shape[-3] else np.empty(0)
        seen = values[np.isfinite(values)]
        if seen.size:
            means[place] = seen.mean()
    return means
