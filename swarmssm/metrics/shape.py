"""The outline of a group: how large it is, and how drawn out.

Arrays are ``(..., time, individual, space)``, NaN where unknown, and results ``(..., time)``.
"""

import math

import numpy as np
import numpy.typing as npt
import scipy

from swarmssm.metrics.masked import Array, as_array, known, masked_mean, ratio

__all__ = ["elongation", "group_area"]

AXES = "time, individual, space"


def group_area(positions: npt.ArrayLike) -> Array:
    """Return the area of the convex hull of a group, in three dimensions its volume.

    Parameters
    ----------
    positions
        Shape ``(..., time, individual, space)``, space 2 or 3, NaN where unknown.

    Returns
    -------
    Shape ``(..., time)``, in the unit of the positions squared (or cubed); 0 where all are in one
    line (or plane), NaN where no more individuals are known than there are dimensions.

    Raises
    ------
    InputError
        If ``positions`` has too few axes or holds infinite values.
    """
    array = as_array(positions, "positions", AXES)
    frames = array.reshape(math.prod(array.shape[:-2]), *array.shape[-2:])
    areas = np.full(len(frames), np.nan)
    for index, (frame, there) in enumerate(zip(frames, known(frames), strict=True)):
        if there.sum() > array.shape[-1]:
            areas[index] = _hull_volume(frame[there])
    return areas.reshape(array.shape[:-2])


def _hull_volume(points: Array) -> float:
    """Return the volume of the hull of points, 0 where it is flat."""
    try:
        return float(scipy.spatial.ConvexHull(points).volume)
    except scipy.spatial.QhullError:
        return 0.0


def elongation(positions: npt.ArrayLike) -> Array:
    r"""Return how drawn out a group is: 0 for a round one, 1 for a line.

    .. math:: E(t) = 1 - \sqrt{\lambda_{min} / \lambda_{max}}

    with the smallest and the largest eigenvalue of the covariance of the positions. It says nothing
    of the direction of motion.

    Parameters
    ----------
    positions
        Shape ``(..., time, individual, space)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time)``, from 0 to 1; NaN where fewer than three individuals are known, or all
    are in one place.

    Raises
    ------
    InputError
        If ``positions`` has too few axes or holds infinite values.
    """
    array = as_array(positions, "positions", AXES)
    there = known(array)
    spread = np.broadcast_to(there[..., None], array.shape)
    apart = array - masked_mean(array, spread, axis=-2)[..., None, :]
    apart = np.where(spread, apart, 0.0)
    values = np.linalg.eigvalsh(np.swapaxes(apart, -1, -2) @ apart)
    # Rounding may leave the least eigenvalue of a line below zero.
    share = ratio(np.maximum(values[..., 0], 0.0), values[..., -1])
    return np.where(there.sum(-1) > 2, 1.0 - np.sqrt(share), np.nan)
