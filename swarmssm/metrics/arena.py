"""The space that individuals are kept in, and how they stand to its walls."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from swarmssm.errors import InputError
from swarmssm.metrics.masked import Array, as_array, check_same_shape, ratio

__all__ = ["Arena", "wall_angles", "wall_distances"]

AXES = "time, individual, space"


@dataclass(frozen=True)
class Arena:
    """A convex arena: what lies on the inner side of all its walls.

    Attributes
    ----------
    normals
        ``(wall, space)``: unit vectors that point outwards.
    offsets
        ``(wall,)``: a place p is inside a wall if ``normal . p <= offset``.
    source
        Where it is known from, as it stands in a sentence.
    """

    normals: Array
    offsets: Array
    source: str = "given"

    @classmethod
    def box(cls, low: npt.ArrayLike, high: npt.ArrayLike, source: str = "given") -> "Arena":
        """Return a box along the axes.

        Parameters
        ----------
        low, high
            Opposite corners, ``(space,)``.
        source
            See the class.

        Raises
        ------
        InputError
            If they are not two corners of a box.
        """
        ends = [np.asarray(end, dtype=np.float64) for end in (low, high)]
        good = ends[0].ndim == 1 and ends[0].shape == ends[1].shape
        if not good or not (ends[0] < ends[1]).all():
            raise InputError("arena: a box needs a low and a high corner of the same dimensions.")
        eye = np.eye(len(ends[0]))
        return cls(np.concatenate([-eye, eye]), np.concatenate([-ends[0], ends[1]]), source)

    @classmethod
    def around(cls, points: npt.ArrayLike, source: str = "given") -> "Arena":
        """Return the convex hull of points, such as the corners of a tank.

        Parameters
        ----------
        points
            ``(point, space)``; NaN are left out. Two are opposite corners of a box.
        source
            See the class.

        Raises
        ------
        InputError
            If there are too few points, or they lie in one line.
        """
        array = np.asarray(points, dtype=np.float64)
        array = array[np.isfinite(array).all(-1)] if array.ndim == 2 else array
        if array.ndim == 2 and len(array) == 2:
            return cls.box(array.min(0), array.max(0), source)
        try:
            hull = scipy.spatial.ConvexHull(array)
        except (ValueError, IndexError, scipy.spatial.QhullError) as error:
            raise InputError(
                "arena: its corners must be points (corner, space) that enclose something, more "
                "than there are dimensions; or two opposite corners of a box."
            ) from error
        # Pieces of one flat wall share their equation.
        walls = np.unique(np.round(hull.equations, 12), axis=0)
        return cls(walls[:, :-1], -walls[:, -1], source)

    @property
    def num_space(self) -> int:
        """Number of spatial dimensions."""
        return int(self.normals.shape[1])


def wall_distances(positions: npt.ArrayLike, arena: Arena) -> Array:
    """Return the distance of each individual to the nearest wall, below 0 for one outside.

    Parameters
    ----------
    positions
        Shape ``(..., time, individual, space)``, NaN where unknown.
    arena
        The arena.

    Returns
    -------
    Shape ``(..., time, individual)``, in the unit of the positions.

    Raises
    ------
    InputError
        If ``positions`` has other dimensions than the arena.
    """
    return np.asarray(_clearances(as_array(positions, "positions", AXES), arena).min(axis=-1))


def wall_angles(positions: npt.ArrayLike, velocities: npt.ArrayLike, arena: Arena) -> Array:
    """Return the angle at which each individual heads for its nearest wall.

    Parameters
    ----------
    positions, velocities
        Shape ``(..., time, individual, space)``, NaN where unknown.
    arena
        The arena.

    Returns
    -------
    Shape ``(..., time, individual)``, radians: 0 straight to the wall, pi / 2 along it, pi away
    from it. NaN for who stands still.

    Raises
    ------
    InputError
        If the shapes differ, or from the arena's dimensions.
    """
    place = as_array(positions, "positions", AXES)
    velocity = as_array(velocities, "velocities", AXES)
    check_same_shape(place, velocity, "positions", "velocities")
    clearance = _clearances(place, arena)
    nearest = np.where(np.isnan(clearance), np.inf, clearance).argmin(axis=-1)
    heading = ratio(velocity, np.linalg.norm(velocity, axis=-1, keepdims=True))
    cosine = (arena.normals[nearest] * heading).sum(-1)
    angles = np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.where(np.isnan(clearance).any(-1), np.nan, angles)


def _clearances(positions: Array, arena: Arena) -> Array:
    """Return ``(..., wall)``: how far inside each wall."""
    if positions.shape[-1] != arena.num_space:
        raise InputError(
            f"arena: it has {arena.num_space} dimensions, and the positions have "
            f"{positions.shape[-1]}."
        )
    clearances: Array = arena.offsets - positions @ arena.normals.T
    return clearances
