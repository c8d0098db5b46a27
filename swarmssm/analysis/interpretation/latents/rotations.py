"""Rotations of a latent space after which, as far as it can be, each axis is one force."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarmssm.analysis.interpretation.latents.block_folds import Cells
from swarmssm.analysis.interpretation.latents.probes import RidgeProbe
from swarmssm.tracks import Array

__all__ = ["RotatedAxes", "nearest_rotation", "rotated_axes"]

#: Penalty of the regressions that give the directions.
PENALTY = 1e-2


class RotatedAxes(NamedTuple):
    """Axes of a latent space, one for each component of a force.

    Attributes
    ----------
    direction
        ``(axis, latent)``, of length 1, in latents divided by ``scale``; from all frames.
    scale
        ``(latent,)``: standard deviation of each latent.
    r2
        ``(axis, component)``: how well each axis alone tells each component, in frames left out,
        the axes being those of the other frames.
    purity
        ``(axis,)``: that of its own component, as a share between 0 and 1 of what all latents tell
        of it; NaN where they tell nothing. An axis that tells no less than all of them, as it may
        in frames left out since it has less to learn, has 1; one that does no better than the mean,
        0.
    orthogonal
        Whether the axes are at right angles: not with fewer latents than components.
    """

    direction: Array
    scale: Array
    r2: Array
    purity: Array
    orthogonal: bool


def rotated_axes(
    latents: Array,
    targets: Array,
    cells: Cells,
    together: Array,
) -> RotatedAxes:
    """Rotate a latent space so that its first axes are the components of forces.

    Each component has the direction in which its regression on the latents goes. Brought to right
    angles, no component before another (:func:`nearest_rotation`), these are axes of a rotation of
    the standardised latents; what forces have in common then no longer lies in both.

    Parameters
    ----------
    latents
        ``(sample, latent)``.
    targets
        ``(sample, component)``.
    cells
        Which samples train and test.
    together
        ``(component,)``: R^2 of each from all latents.
    """
    spread = latents.std(0)
    scale = np.where(spread > 0, spread, 1.0)
    scaled = (latents - latents.mean(0)) / scale
    probe = RidgeProbe(scaled, cells, penalties=(PENALTY,))
    sizes = targets.std(0)
    unit = (targets - targets.mean(0)) / np.where(sizes > 0, sizes, 1.0)
    moving = int((sizes > 0).sum())
    orthogonal = moving <= np.linalg.matrix_rank(scaled)

    def axes(train: npt.NDArray[np.bool_] | None) -> Array:
        slopes = probe.coefficients(unit, train)[0] * np.where(sizes > 0, sizes, 0.0)[:, None]
        length = np.linalg.norm(slopes, axis=1, keepdims=True)
        unitary = np.divide(slopes, length, out=np.zeros_like(slopes), where=length > 0)
        there = length[:, 0] > 0
        if orthogonal and there.any():
            unitary[there] = nearest_rotation(unitary[there])
        return np.asarray(unitary)

    r2 = probe.axis_r2(unit, np.stack([axes(train) for train in probe.training_cells]))
    own = np.diagonal(r2)
    with np.errstate(invalid="ignore"):
        told = together > 0
    purity = np.where(told, np.clip(own / np.where(told, together, 1.0), 0.0, 1.0), np.nan)
    return RotatedAxes(axes(None), scale, r2, purity, bool(orthogonal))


def nearest_rotation(directions: Array) -> Array:
    """Return the orthonormal rows that are nearest to given rows, none before another.

    Parameters
    ----------
    directions
        ``(axis, feature)``, at least as many features as axes.
    """
    left, _, right = np.linalg.svd(directions, full_matrices=False)
    rotated: Array = left @ right
    return rotated
