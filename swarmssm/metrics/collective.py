"""How a group holds together: cohesion, alignment, order.

Arrays are ``(..., time, individual, space)``, NaN where unknown, and results ``(..., time)``: any
number of leading axes. An individual unknown at t counts neither in a mean nor as a neighbour at t,
and a time at which nothing is known gives NaN.
"""

import math

import numpy as np
import numpy.typing as npt
import scipy

from swarmssm.errors import InputError
from swarmssm.metrics.masked import (
    Array,
    Mask,
    as_array,
    check_same_shape,
    known,
    masked_mean,
    ratio,
)

__all__ = [
    "amd",
    "avd",
    "nearest_neighbor_distance",
    "polarization",
    "rotation",
    "speeds",
]

AXES = "time, individual, space"
#: Up to this many individuals, all pairs of many times are taken at once.
MAX_DENSE = 24
#: Numbers held at once by the dense paths: 32 MB.
CHUNK = 1 << 22


def speeds(velocities: npt.ArrayLike) -> Array:
    """Return the speed of each individual.

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time, individual)``, in the unit of the velocities.

    Raises
    ------
    InputError
        If ``velocities`` has too few axes or holds infinite values.
    """
    norms: Array = np.linalg.norm(as_array(velocities, "velocities", AXES), axis=-1)
    return norms


def nearest_neighbor_distance(positions: npt.ArrayLike) -> Array:
    """Return the distance of each individual to the nearest other one.

    Parameters
    ----------
    positions
        Shape ``(..., time, individual, space)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time, individual)``, in the unit of the positions; NaN for an individual that is
    unknown or the only known one.

    Raises
    ------
    InputError
        If ``positions`` has too few axes or holds infinite values.
    """
    array = as_array(positions, "positions", AXES)
    num_individuals = array.shape[-2]
    frames = _frames(array)
    nearest = np.full(frames.shape[:-1], np.nan)
    if num_individuals <= MAX_DENSE:
        for part in _chunks(frames):
            distance = _pair_distances(frames[part])
            distance[np.isnan(distance) | np.eye(num_individuals, dtype=bool)] = np.inf
            least = distance.min(axis=-1, initial=np.inf)
            nearest[part] = np.where(np.isinf(least), np.nan, least)
    else:
        for frame, target, there in zip(frames, nearest, known(frames), strict=True):
            if there.sum() > 1:
                tree = scipy.spatial.cKDTree(frame[there])
                # The nearest point is the individual itself, or one at the same place: distance 0.
                target[there] = np.asarray(tree.query(frame[there], k=2)[0])[:, 1]
    return nearest.reshape(array.shape[:-1])


def amd(positions: npt.ArrayLike) -> Array:
    r"""Return the average minimum distance, a measure of cohesion.

    .. math:: AMD(t) = \frac{1}{N} \sum_{i=1}^{N} \min_{j \neq i} \|p_i(t) - p_j(t)\| \quad (4.4)

    The equation as printed does not say :math:`j \neq i`; without it AMD would be 0.

    Parameters
    ----------
    positions
        Shape ``(..., time, individual, space)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time)``, in the unit of the positions. NaN where fewer than two individuals are
    known.

    Raises
    ------
    InputError
        As :func:`nearest_neighbor_distance`.
    """
    nearest = nearest_neighbor_distance(positions)
    return masked_mean(nearest, ~np.isnan(nearest), axis=-1)


def avd(velocities: npt.ArrayLike) -> Array:
    r"""Return the average velocity difference, 0 when all move alike.

    .. math:: AVD(t) = \frac{2}{N(N-1)} \sum_{i < j} \|v_i(t) - v_j(t)\| \quad (4.5)

    The sum as printed runs over :math:`i \neq j`. Read as unordered pairs, of which there are
    :math:`N(N-1)/2`, it is the mean that its name promises; ordered pairs would double it.

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time)``, in the unit of the velocities. NaN where fewer than two individuals are
    known.

    Raises
    ------
    InputError
        If ``velocities`` has too few axes or holds infinite values.
    """
    array = as_array(velocities, "velocities", AXES)
    num_individuals = array.shape[-2]
    frames = _frames(array)
    there = known(frames)
    total = np.zeros(len(frames))
    if num_individuals <= MAX_DENSE:
        for part in _chunks(frames):
            distance = _pair_distances(frames[part])
            total[part] = np.where(np.isnan(distance), 0.0, distance).sum(axis=(-2, -1)) / 2
    else:
        for index, (frame, mask) in enumerate(zip(frames, there, strict=True)):
            total[index] = scipy.spatial.distance.pdist(frame[mask]).sum()
    count = there.sum(axis=-1)
    return ratio(total, count * (count - 1) / 2).reshape(array.shape[:-2])


def polarization(velocities: npt.ArrayLike) -> Array:
    r"""Return the length of the mean heading: 1 when all head one way, near 0 for none.

    .. math:: \Phi(t) = \left| \frac{1}{N} \sum_i \frac{v_i(t)}{|v_i(t)|} \right|

    An individual that stands still has no heading and doesn't count.

    Parameters
    ----------
    velocities
        Shape ``(..., time, individual, space)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time)``, from 0 to 1; NaN where nobody is known to move.

    Raises
    ------
    InputError
        If ``velocities`` has too few axes or holds infinite values.

    References
    ----------
    Vicsek, T. et al. (1995). Novel type of phase transition in a system of self-driven
    particles. Physical Review Letters 75, 1226. doi:10.1103/PhysRevLett.75.1226
    """
    heading, moving = _directions(as_array(velocities, "velocities", AXES))
    mean = masked_mean(heading, np.broadcast_to(moving[..., None], heading.shape), axis=-2)
    order: Array = np.linalg.norm(mean, axis=-1)
    return order


def rotation(positions: npt.ArrayLike, velocities: npt.ArrayLike, *, signed: bool = False) -> Array:
    r"""Return the rotation (milling) order about the group's centroid: 1 for a perfect mill.

    .. math::
        M(t) = \left| \frac{1}{N} \sum_i \hat r_i(t) \times \hat v_i(t) \right|, \qquad
        \hat r_i = \frac{p_i - \bar p}{|p_i - \bar p|}, \quad \hat v_i = \frac{v_i}{|v_i|}

    The centroid is that of the individuals of which both position and velocity are known. One that
    stands still, or exactly on the centroid, counts for the centroid alone: it has no direction.

    Parameters
    ----------
    positions, velocities
        Shape ``(..., time, individual, space)``, space 2 or 3, NaN where unknown.
    signed
        In 2-D, keep the sign: positive from x towards y, which is counter-clockwise where y points
        up and clockwise in images, where it points down.

    Returns
    -------
    Shape ``(..., time)``, from 0 (from -1 if ``signed``) to 1; NaN where nothing is known.

    Raises
    ------
    InputError
        If the shapes differ, space is not 2 or 3, or ``signed`` is asked in 3-D.

    References
    ----------
    Couzin, I. D. et al. (2002). Collective memory and spatial sorting in animal groups. Journal
    of Theoretical Biology 218, 1-11. doi:10.1006/jtbi.2002.3065
    """
    place = as_array(positions, "positions", AXES)
    velocity = as_array(velocities, "velocities", AXES)
    check_same_shape(place, velocity, "positions", "velocities")
    num_space = place.shape[-1]
    if num_space not in (2, 3):
        raise InputError(f"positions: rotation needs 2 or 3 coordinates, not {num_space}.")
    if signed and num_space == 3:
        raise InputError("signed: a rotation in three dimensions has an axis, not a sign.")
    there = known(place) & known(velocity)
    centroid = masked_mean(place, np.broadcast_to(there[..., None], place.shape), axis=-2)
    outward, off_centre = _directions(place - centroid[..., None, :])
    heading, moving = _directions(velocity)
    counts = off_centre & moving
    if num_space == 2:
        turn = outward[..., 0] * heading[..., 1] - outward[..., 1] * heading[..., 0]
        order = masked_mean(turn, counts, axis=-1)
        return order if signed else np.abs(order)
    axis = np.cross(outward, heading)
    mean = masked_mean(axis, np.broadcast_to(counts[..., None], axis.shape), axis=-2)
    magnitude: Array = np.linalg.norm(mean, axis=-1)
    return magnitude


def _directions(vectors: Array) -> tuple[Array, Mask]:
    """Return unit vectors, and where there is one: known and not of length 0."""
    length = np.linalg.norm(vectors, axis=-1)
    return ratio(vectors, length[..., None]), length > 0


def _frames(array: Array) -> Array:
    """Merge all leading axes into one; the length is given, as -1 fails on empty arrays."""
    return array.reshape(math.prod(array.shape[:-2]), *array.shape[-2:])


def _chunks(frames: Array) -> list[slice]:
    """Cut frames into parts of which all pairs fit into ``CHUNK`` numbers."""
    size = max(1, CHUNK // max(1, frames.shape[-2] ** 2 * frames.shape[-1]))
    return [slice(start, start + size) for start in range(0, len(frames), size)]


def _pair_distances(frames: Array) -> Array:
    """Return ``(frame, individual, individual)`` distances, NaN where one of the two is unknown."""
    pairs: Array = np.linalg.norm(frames[:, :, None, :] - frames[:, None, :, :], axis=-1)
    return pairs
