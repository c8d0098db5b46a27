"""Who is near whom: metric, topological and complete graphs.

Every function takes positions ``(..., individual, space)`` with 2 or 3 coordinates, NaN = absent,
and returns a boolean adjacency ``(..., individual, individual)`` whose ``[i, j]`` is true when i
sees j. The diagonal is false, and an absent individual has no edge in or out. Frames are worked
through in portions, so that beyond the result itself memory stays bounded.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
import torch
from torch import Tensor

from swarmssm.errors import InputError

__all__ = ["complete_graph", "k_nearest_graph", "nearest_distances", "pairs", "radius_graph"]

Points = npt.NDArray[np.floating]
Pairs = tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]

#: Distances held at once: 4 million of 8 bytes are 32 MB, well above what one frame of a few
#: hundred needs, and small enough to stay near the processor.
PORTION = 4_000_000
#: Above this number of individuals the nearest are found by a k-d tree.
TREE_FROM = 256


def radius_graph(positions: Tensor, radius: float | Tensor, *, box: float | None = None) -> Tensor:
    """Return who is within a radius of whom, ``|p_j - p_i| <= radius`` (3.20).

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.
    radius
        Largest distance at which j is seen, in the unit of ``positions``: a number or a tensor
        of no dimension.
    box
        Side of a periodic box: distances are then those to the nearest image. Positions need
        not lie inside the box.

    Returns
    -------
    Shape ``(..., individual, individual)``, bool, symmetric.

    Raises
    ------
    InputError
        If ``radius`` is negative or not finite, if ``box`` is not positive, or if a periodic
        radius is above half the box.
    """
    check_positions(positions)
    if box is not None and not 0.0 < box < math.inf:
        raise InputError(f"box: its side must be a positive number, not {box}.")
    if not isinstance(radius, Tensor):
        if not 0.0 <= radius < math.inf:
            raise InputError(f"radius: it must be a number from 0 upwards, not {radius}.")
        if box is not None and radius > box / 2:
            raise InputError(
                f"radius: in a periodic box of side {box:g} it must be at most {box / 2:g}, not "
                f"{radius:g}, or an individual would see several images of another."
            )
    return _by_portions(positions, lambda part: _distances(part, box) <= radius)


def k_nearest_graph(positions: Tensor, k: int) -> Tensor:
    """Return each individual's k nearest others: the topological graph of starling flocks.

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.
    k
        Number of neighbours. Where fewer others are present, all of them are seen.

    Returns
    -------
    Shape ``(..., individual, individual)``, bool, in general not symmetric: row i holds ``k`` true
    entries. Of several at the same distance those of lower index are taken.

    Raises
    ------
    InputError
        If ``k`` is below 1.

    References
    ----------
    Ballerini et al. (2008), PNAS 105:1232.
    """
    check_positions(positions)
    if isinstance(k, bool) or not isinstance(k, int | np.integer) or k < 1:
        raise InputError(f"k: the number of neighbours must be a whole number from 1, not {k}.")
    num_members = positions.shape[-2]
    if k >= num_members - 1:
        return complete_graph(positions)
    if num_members > TREE_FROM and positions.device.type == "cpu":
        return _k_nearest_by_tree(positions, k)
    return _by_portions(positions, lambda part: _nearest(_distances(part, None), k))


def complete_graph(positions: Tensor) -> Tensor:
    """Return the graph in which everyone present sees everyone else present.

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.

    Returns
    -------
    Shape ``(..., individual, individual)``, bool, symmetric.
    """
    return pairs(check_positions(positions).isfinite().all(-1))


def nearest_distances(positions: Tensor) -> Tensor:
    """Return the distance of each individual to the nearest other.

    Parameters
    ----------
    positions
        Shape ``(..., individual, space)``.

    Returns
    -------
    Shape ``(..., individual)``; NaN for who is absent or alone.
    """
    check_positions(positions)
    frames = positions.detach().reshape(-1, *positions.shape[-2:]).cpu().numpy()
    out = np.full(frames.shape[:-1], math.nan, dtype=frames.dtype)
    for row, points in zip(out, frames, strict=True):
        present = np.isfinite(points).all(-1)
        if present.sum() > 1:
            # The nearest of all is the individual itself, or another at the very same place.
            row[present] = _query(points[present], 2)[0][:, 1]
    return torch.from_numpy(out).to(positions.device).reshape(positions.shape[:-1])


def pairs(present: Tensor) -> Tensor:
    """Return ``[i, j]`` true when i and j are two different individuals, both present.

    Parameters
    ----------
    present
        Shape ``(..., individual)``, bool.

    Returns
    -------
    Shape ``(..., individual, individual)``, bool.
    """
    both = present[..., :, None] & present[..., None, :]
    return both & ~torch.eye(present.shape[-1], dtype=torch.bool, device=present.device)


def check_positions(positions: Tensor, what: str = "positions") -> Tensor:
    """Return the positions if their shape is ``(..., individual, 2 or 3)``.

    Raises
    ------
    InputError
        If it is not, or they are not floating-point numbers.
    """
    if positions.ndim < 2 or positions.shape[-1] not in (2, 3):
        raise InputError(
            f"{what}: the shape must be (..., individual, space) with 2 or 3 coordinates, and it "
            f"is {tuple(positions.shape)}."
        )
    if not positions.is_floating_point():
        raise InputError(f"{what}: they must be floating-point numbers, not {positions.dtype}.")
    return positions


def portions(num_frames: int, entries_per_frame: int) -> list[slice]:
    """Return slices of frames that each hold at most :data:`PORTION` entries, or one frame."""
    size = max(1, PORTION // max(entries_per_frame, 1))
    return [slice(start, start + size) for start in range(0, num_frames, size)]


def _by_portions(positions: Tensor, near: Callable[[Tensor], Tensor]) -> Tensor:
    """Apply ``near`` to portions of frames, and take away the diagonal.

    NaN distances compare false, so an absent individual needs no further care.
    """
    num_members = positions.shape[-2]
    frames = positions.detach().reshape(-1, num_members, positions.shape[-1])
    out = torch.empty(
        (len(frames), num_members, num_members), dtype=torch.bool, device=positions.device
    )
    for rows in portions(len(frames), num_members**2):
        out[rows] = near(frames[rows])
    out.diagonal(dim1=-2, dim2=-1).fill_(False)
    return out.reshape(*positions.shape[:-1], num_members)


def _distances(positions: Tensor, box: float | None) -> Tensor:
    """Return ``(..., individual, individual)`` distances, NaN where one of the two is absent."""
    if box is None:
        # Not by the matrix product, whose rounding would put equal distances apart.
        return torch.cdist(positions, positions, compute_mode="donot_use_mm_for_euclid_dist")
    offset = positions[..., :, None, :] - positions[..., None, :, :]
    distances: Tensor = torch.linalg.vector_norm(offset - box * torch.round(offset / box), dim=-1)
    return distances


def _nearest(distances: Tensor, k: int) -> Tensor:
    """Return the k nearest others of everyone, given all distances."""
    distances = distances.nan_to_num(nan=math.inf)
    distances.diagonal(dim1=-2, dim2=-1).fill_(math.inf)
    return _smallest(distances, k)


def _smallest(distances: Tensor, k: int) -> Tensor:
    """Return the k smallest finite entries of each row, the lower index first on a tie."""
    kth = distances.topk(k, dim=-1, largest=False).values[..., -1:]
    closer = distances < kth
    tied = (distances == kth) & (distances < math.inf)
    room = k - closer.sum(-1, keepdim=True)
    return closer | (tied & (tied.cumsum(-1) <= room))


def _k_nearest_by_tree(positions: Tensor, k: int) -> Tensor:
    """Return :func:`k_nearest_graph` by one k-d tree a frame, for large groups."""
    frames = positions.detach().reshape(-1, *positions.shape[-2:]).numpy()
    out = torch.zeros((*frames.shape[:-1], frames.shape[-2]), dtype=torch.bool)
    for edges, points in zip(out.numpy(), frames, strict=True):
        edges[k_nearest_pairs(points, k)] = True
    return out.reshape(*positions.shape[:-1], positions.shape[-2])


def k_nearest_pairs(points: Points, k: int) -> Pairs:
    """Return the edges of :func:`k_nearest_graph` in one frame, found by a k-d tree.

    Parameters
    ----------
    points
        Shape ``(individual, space)``, NaN = absent.
    k
        Number of neighbours, from 1.

    Returns
    -------
    Who sees, and who is seen, ``(edge,)`` each, in no certain order.
    """
    present = np.flatnonzero(np.isfinite(points).all(-1))
    if len(present) <= k + 1:
        i, j = np.nonzero(~np.eye(len(present), dtype=bool))
        return present[i], present[j]
    there = points[present]
    others, tied = _tree_neighbors(there, k)
    receivers, senders = [np.repeat(np.flatnonzero(~tied), k)], [others[~tied].ravel()]
    # All distances of those whose neighbours a tie leaves open, but not of all of them at once.
    open_ties = np.flatnonzero(tied)
    for rows in portions(len(open_ties), len(there)):
        own = open_ties[rows]
        distances = torch.from_numpy(scipy.spatial.distance.cdist(there[own], there))
        distances[torch.arange(len(own)), torch.from_numpy(own)] = math.inf
        i, j = np.nonzero(_smallest(distances, k).numpy())
        receivers.append(own[i])
        senders.append(j)
    return present[np.concatenate(receivers)], present[np.concatenate(senders)]


def radius_pairs(points: Points, radius: float, box: float | None = None) -> Pairs:
    """Return the edges of :func:`radius_graph` in one frame, found by a k-d tree.

    Parameters
    ----------
    points
        Shape ``(individual, space)``, NaN = absent.
    radius, box
        As there.

    Returns
    -------
    Who sees, and who is seen, ``(edge,)`` each, in no certain order.
    """
    present = np.flatnonzero(np.isfinite(points).all(-1))
    there = points[present]
    tree: Any
    if box is None:
        tree = scipy.spatial.cKDTree(there)
    else:
        inside = np.mod(there.astype(np.float64), box)
        # What is just below 0 is rounded to the side itself.
        sides = np.full(points.shape[-1], box)
        tree = scipy.spatial.cKDTree(np.where(inside < box, inside, 0.0), boxsize=sides)
    # Somewhat more than there are, and then those of them whose distance, rounded as in the dense
    # graph, is within the radius.
    slack = 64.0 * float(np.finfo(points.dtype).eps) * (radius + np.abs(there).max(initial=0.0))
    pair = tree.query_pairs(radius + slack, output_type="ndarray")
    apart = torch.from_numpy(there[pair[:, 0]] - there[pair[:, 1]])
    if box is not None:
        apart = apart - box * torch.round(apart / box)
    pair = pair[(torch.linalg.vector_norm(apart, dim=-1) <= radius).numpy()]
    i, j = present[pair[:, 0]], present[pair[:, 1]]
    return np.concatenate([i, j]), np.concatenate([j, i])


def _tree_neighbors(points: Points, k: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Return the k nearest others of each point ``(point, k)``, and where a tie leaves them open.

    A tie is open where the next one is as near as the last one taken.
    """
    distances, indices = _query(points, k + 2)
    own = indices == np.arange(len(points))[:, None]
    # Among many at the very same place a point may not be found itself; that is an open tie too.
    own[~own.any(-1), -1] = True
    indices = indices[~own].reshape(len(points), k + 1)
    distances = distances[~own].reshape(len(points), k + 1)
    return indices[:, :k], distances[:, k - 1] == distances[:, k]


def _query(points: Points, k: int) -> tuple[Points, npt.NDArray[np.intp]]:
    """Return distances and indices of the k nearest of each point, itself among them."""
    distances, indices = scipy.spatial.cKDTree(points).query(points, k=k)
    return np.asarray(distances), np.asarray(indices)
