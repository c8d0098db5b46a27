"""How two individuals stand to each other: distance, headings, who is where in whose view.

Arrays are ``(..., time, individual, space)``, NaN where unknown. All pairs are taken at once: of
N individuals there are N (N - 1) / 2.
"""

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.metrics.masked import Array, as_array, check_same_shape, ratio

__all__ = ["heading_differences", "neighbor_positions", "pair_distances", "viewing_angles"]

AXES = "time, individual, space"


def pair_distances(positions: npt.ArrayLike) -> Array:
    """Return the distance of each two individuals.

    Parameters
    ----------
    positions
        Shape ``(..., time, individual, space)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time, pair)``, pairs ``i < j`` in the order of rows of the upper triangle.

    Raises
    ------
    InputError
        If ``positions`` has too few axes or holds infinite values.
    """
    array = as_array(positions, "positions", AXES)
    first, second = np.triu_indices(array.shape[-2], k=1)
    distances: Array = np.linalg.norm(array[..., first, :] - array[..., second, :], axis=-1)
    return distances


def heading_differences(velocities: npt.ArrayLike) -> Array:
    """Return the angle between the headings of each two individuals.

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, NaN where unknown. Who stands still has no
        heading.

    Returns
    -------
    Shape ``(..., time, pair)``, radians from 0 to pi, in the order of :func:`pair_distances`.

    Raises
    ------
    InputError
        If ``velocities`` has too few axes or holds infinite values.
    """
    array = as_array(velocities, "velocities", AXES)
    heading = ratio(array, np.linalg.norm(array, axis=-1, keepdims=True))
    first, second = np.triu_indices(array.shape[-2], k=1)
    cosine = (heading[..., first, :] * heading[..., second, :]).sum(-1)
    angles: Array = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angles


def neighbor_positions(positions: npt.ArrayLike, velocities: npt.ArrayLike) -> Array:
    """Return where each individual has each other one: how far ahead, and how far to the left.

    Parameters
    ----------
    positions, velocities
        Shape ``(..., time, individual, space)``, space 2 or 3, NaN where unknown.

    Returns
    -------
    Shape ``(..., time, individual, neighbor, 2)``: of individual *i* and its neighbour *j*, in the
    unit of the positions. In 2-D "left" is 90 degrees from the heading, from x towards y; in 3-D
    it is the distance from the line of the heading, never negative. NaN for oneself, for who is
    unknown, and for an individual that stands still.

    Raises
    ------
    InputError
        If the shapes differ or space is not 2 or 3.
    """
    place = as_array(positions, "positions", AXES)
    velocity = as_array(velocities, "velocities", AXES)
    check_same_shape(place, velocity, "positions", "velocities")
    if place.shape[-1] not in (2, 3):
        raise InputError(f"positions: space must be 2 or 3, not {place.shape[-1]}.")
    heading = ratio(velocity, np.linalg.norm(velocity, axis=-1, keepdims=True))[..., :, None, :]
    offset = place[..., None, :, :] - place[..., :, None, :]
    ahead = (heading * offset).sum(-1)
    if place.shape[-1] == 2:
        left = heading[..., 0] * offset[..., 1] - heading[..., 1] * offset[..., 0]
    else:
        left = np.linalg.norm(np.cross(heading, offset), axis=-1)
    found: Array = np.stack([ahead, left], axis=-1)
    own = np.eye(place.shape[-2], dtype=bool)
    found[..., own, :] = np.nan
    return found


def viewing_angles(positions: npt.ArrayLike, velocities: npt.ArrayLike) -> Array:
    """Return the angle from each individual's heading to each other one: 0 ahead, pi behind.

    Parameters
    ----------
    positions, velocities
        As :func:`neighbor_positions`.

    Returns
    -------
    Shape ``(..., time, individual, neighbor)``, radians from 0 to pi, whichever the side; NaN for
    oneself, for who is unknown, and where two are in one place.

    Raises
    ------
    InputError
        If the shapes differ or space is not 2 or 3.
    """
    found = neighbor_positions(positions, velocities)
    apart = np.linalg.norm(found, axis=-1) > 0
    return np.where(apart, np.arctan2(np.abs(found[..., 1]), found[..., 0]), np.nan)
