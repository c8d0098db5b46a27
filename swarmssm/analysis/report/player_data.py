"""Scenes as text for the player: positions to a stated resolution, packed and compressed."""

import base64
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm.analysis.plots.scenes.scene import Scene
from swarmssm.tracks import Array

__all__ = ["pack_scene", "resolution_of"]

#: Numbers for a coordinate; one more says that it is not known.
LEVELS, UNKNOWN = 65535, 65535
#: Directions, so many to a full turn; one more says that there is none.
DIRECTIONS, NO_DIRECTION = 255, 255


def resolution_of(scene: Scene) -> float:
    """Return the step between two numbers of a coordinate, in the unit of length."""
    known = scene.position[np.isfinite(scene.position).all(axis=-1)]
    if not len(known):
        return 1.0
    span = float((known.max(axis=0) - known.min(axis=0)).max())
    return span / (LEVELS - 1) if span > 0 else 1.0


def pack_scene(scene: Scene) -> dict[str, Any]:
    """Return a scene as a table for JSON.

    Returns
    -------
    ``frames`` and ``individuals`` (labels); ``offset (2)`` and ``resolution``: a position is
    ``offset + resolution * number``, so that it is right to half the resolution; ``graph``,
    whether there is one; and ``bytes``, in base64 what zlib has compressed, one after the other:

    - the numbers, unsigned of 16 bits, ``(individual, 2, frame)``, 65535 for unknown, each but the
      first as its difference from the frame before (modulo 65536); first all low bytes, then all
      high ones, which hardly change and so take little space;
    - the headings, unsigned of 8 bits, ``(individual, frame)``, 255 to a full turn, 255 for none;
    - the graph, if there is one, a bit a pair, ``(frame, individual, individual)``, the first in
      the highest bit of its byte.
    """
    known = np.isfinite(scene.position).all(axis=-1)
    resolution = resolution_of(scene)
    low = scene.position[known].min(axis=0) if known.any() else np.zeros(2)
    place = np.full(scene.position.shape, UNKNOWN, dtype=np.uint16)
    place[known] = np.round((scene.position[known] - low) / resolution).astype(np.uint16)
    parts = [_differences(place.transpose(1, 2, 0)), _directions(scene.heading).tobytes()]
    if scene.adjacency is not None:
        parts.append(np.packbits(scene.adjacency).tobytes())
    squeezed = zlib.compress(b"".join(parts))
    return {
        "frames": len(scene.time),
        "individuals": list(scene.individuals),
        "offset": [float(one) for one in low],
        "resolution": resolution,
        "graph": scene.adjacency is not None,
        "bytes": base64.b64encode(squeezed).decode("ascii"),
    }


def _differences(numbers: npt.NDArray[np.uint16]) -> bytes:
    """Return differences along the last axis: all low bytes, then all high bytes."""
    before = np.zeros_like(numbers)
    before[..., 1:] = numbers[..., :-1]
    change = numbers - before
    return (change & 255).astype(np.uint8).tobytes() + (change >> 8).astype(np.uint8).tobytes()


def _directions(heading: Array) -> npt.NDArray[np.uint8]:
    """Return headings ``(individual, frame)`` as whole numbers."""
    known = np.isfinite(heading)
    turns = np.where(known, heading, 0.0) / (2.0 * np.pi)
    steps = np.round(turns * DIRECTIONS).astype(np.int64) % DIRECTIONS
    return np.where(known, steps, NO_DIRECTION).astype(np.uint8).T
