"""The rays of the visual field in a compiled loop.

The same geometry as the tensors of :mod:`swarmssm.graphs.visual`, one ray after the other and in
double precision. Numba compiles the loop when it is first used and keeps the machine code on disk:
beside this file, or in the user's cache folder where the package may not be written to.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["first_hits"]

Array = npt.NDArray[np.float64]
#: One signature only. Processes that compile at the same time then write the same cache.
SIGNATURE = (
    "void(f8[:, :, ::1], f8[:, :, ::1], f8[::1], f8[::1], f8[:, ::1], f8[::1], f8[::1], f8, f8, "
    "b1[:, :, ::1])"
)


def first_hits(
    places: Array,
    looks: Array,
    *,
    lengths: Array,
    eyes: Array,
    axes: Array,
    field: float,
    rays: int,
    reach: float,
) -> npt.NDArray[np.bool_]:
    """Cast the rays of all eyes; return who sees whom.

    Parameters
    ----------
    places, looks
        Positions and headings, shape ``(frame, individual, 2)``; NaN = absent or no heading.
    lengths
        Half the length of a body, half its width, and the radius of a body without heading.
    eyes
        Where each eye sits, along and to the left of the heading, shape ``(eye, 2)``.
    axes
        Angle between the heading and the middle of each eye's field, shape ``(eye,)``.
    field
        Whole angle of the field of one eye, in radians.
    rays
        Number of rays of one eye.
    reach
        Length of the rays.

    Returns
    -------
    Shape ``(frame, individual, individual)``, ``[i, j]`` true when i sees j.
    """
    num_frames, num_members, _ = places.shape
    seen = np.zeros((num_frames, num_members, num_members), dtype=np.bool_)
    angles = np.linspace(-0.5 * field, 0.5 * field, rays)
    cast = _compiled()
    cast(
        np.ascontiguousarray(places),
        np.ascontiguousarray(looks),
        lengths,
        axes,
        eyes,
        np.cos(angles),
        np.sin(angles),
        field,
        reach,
        seen,
    )
    return seen


@functools.cache
def _compiled() -> Callable[..., None]:
    """Return the loop as machine code, from the cache on disk if it is there."""
    import numba  # Half a second, that commands without a visual graph need not wait for.

    compiled: Callable[..., None]
    try:
        compiled = numba.njit(SIGNATURE, cache=True, nogil=True)(_cast)
    except Exception:
        # No folder can be written to, the disk is full, or a file of the cache is damaged.
        compiled = numba.njit(SIGNATURE, nogil=True)(_cast)
    return compiled


def _cast(  # pragma: no cover (numba runs it)
    places: Any,
    looks: Any,
    lengths: Any,
    axes: Any,
    eyes: Any,
    cos: Any,
    sin: Any,
    field: float,
    reach: float,
    seen: Any,
) -> None:
    """Fill ``seen``; the comments are in :mod:`swarmssm.graphs.visual`, name for name."""
    num_frames, num_members = places.shape[0], places.shape[1]
    rays = len(cos)
    spacing = field / (rays - 1)
    nearest = np.empty(rays, dtype=np.float32)
    nearest_body = np.empty(rays, dtype=np.int64)
    present = np.empty(num_members, dtype=np.bool_)
    looking = np.empty(num_members, dtype=np.bool_)
    axis = np.empty((num_members, 2))
    half_length = np.empty(num_members)
    half_width = np.empty(num_members)
    first = np.empty(2, dtype=np.int64)
    last = np.empty(2, dtype=np.int64)

    for frame in range(num_frames):
        for i in range(num_members):
            x, y = looks[frame, i, 0], looks[frame, i, 1]
            norm = math.sqrt(x * x + y * y)
            has_heading = norm > 0.0 and math.isfinite(norm)
            axis[i, 0] = x / norm if has_heading else 1.0
            axis[i, 1] = y / norm if has_heading else 0.0
            half_length[i] = lengths[0] if has_heading else lengths[2]
            half_width[i] = lengths[1] if has_heading else lengths[2]
            present[i] = math.isfinite(places[frame, i, 0]) and math.isfinite(places[frame, i, 1])
            looking[i] = present[i] and has_heading

        for i in range(num_members):
            if not looking[i]:
                continue
            for eye in range(len(axes)):
                turn_x, turn_y = math.cos(axes[eye]), math.sin(axes[eye])
                ahead_x, ahead_y = axis[i, 0], axis[i, 1]
                origin_x = places[frame, i, 0] + eyes[eye, 0] * ahead_x - eyes[eye, 1] * ahead_y
                origin_y = places[frame, i, 1] + eyes[eye, 0] * ahead_y + eyes[eye, 1] * ahead_x
                middle_x = turn_x * ahead_x - turn_y * ahead_y
                middle_y = turn_x * ahead_y + turn_y * ahead_x
                nearest[:] = np.inf
                nearest_body[:] = -1
                for j in range(num_members):
                    if j == i or not present[j]:
                        continue
                    # Eye and middle of its field in the frame of the body, in half axes.
                    a, b = half_length[j], half_width[j]
                    offset_x, offset_y = (
                        origin_x - places[frame, j, 0],
                        origin_y - places[frame, j, 1],
                    )
                    ex = offset_x * axis[j, 0] + offset_y * axis[j, 1]
                    ey = offset_y * axis[j, 0] - offset_x * axis[j, 1]
                    look_x = middle_x * axis[j, 0] + middle_y * axis[j, 1]
                    look_y = middle_y * axis[j, 0] - middle_x * axis[j, 1]
                    qx, qy = ex / a, ey / b
                    squared = qx * qx + qy * qy
                    c = squared - 1.0
                    if c <= 0.0:
                        seen[frame, i, j] = True
                    # The two tangents.
                    if squared > 1.0:
                        aside = math.sqrt(squared - 1.0)
                        right_x = a * ((qx - aside * qy) / squared) - ex
                        right_y = b * ((qy + aside * qx) / squared) - ey
                        left_x = a * ((qx + aside * qy) / squared) - ex
                        left_y = b * ((qy - aside * qx) / squared) - ey
                        start = math.atan2(
                            right_y * look_x - right_x * look_y, right_x * look_x + right_y * look_y
                        )
                        width = math.atan2(
                            left_y * right_x - left_x * right_y, left_x * right_x + left_y * right_y
                        )
                        stop = start + max(width, 0.0)
                    else:
                        start, stop = -math.pi, math.pi
                    # Runs of rays between them: a second one where the fan's ends meet behind.
                    runs = 2 if stop > math.pi else 1
                    for run in range(runs):
                        turn = run * 2.0 * math.pi
                        first[run] = max(math.ceil((start - turn + 0.5 * field) / spacing), 0.0)
                        last[run] = min(
                            math.floor((stop - turn + 0.5 * field) / spacing), rays - 1.0
                        )
                    lx, ly = look_x / a, look_y / b
                    mx, my = -look_y / a, look_x / b
                    ll, lm, mm = lx * lx + ly * ly, 2.0 * (lx * mx + ly * my), mx * mx + my * my
                    ql, qm = qx * lx + qy * ly, qx * mx + qy * my
                    for run in range(runs):
                        for ray in range(first[run], last[run] + 1):
                            depth = 0.0
                            if c > 0.0:
                                square = (
                                    ll * cos[ray] * cos[ray]
                                    + lm * cos[ray] * sin[ray]
                                    + mm * sin[ray] * sin[ray]
                                )
                                half = ql * cos[ray] + qm * sin[ray]
                                root = math.sqrt(max(half * half - square * c, 0.0))
                                depth = max((-half - root) / square, 0.0)
                            # Of two at the same distance the lower index stays.
                            if depth <= reach and np.float32(depth) < nearest[ray]:
                                nearest[ray] = depth
                                nearest_body[ray] = j
                for ray in range(rays):
                    if nearest_body[ray] >= 0:
                        seen[frame, i, nearest_body[ray]] = True
