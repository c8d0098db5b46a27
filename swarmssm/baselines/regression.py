"""Linear regression on very many rows: a triangle in their place, and ridge on that."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.linear_model import Ridge

from swarmssm.tracks import Array

__all__ = ["PENALTIES", "AffineMap", "compress", "ridge_maps"]

#: Ridge penalties to choose from, for features of unit variance, a row.
PENALTIES = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 1.0)


@dataclass(frozen=True)
class AffineMap:
    """What a regression found: ``features @ weights.T + intercept``.

    Attributes
    ----------
    weights
        Shape ``(target, feature)``.
    intercept
        Shape ``(target,)``.
    """

    weights: Array
    intercept: Array

    def __call__(self, features: Array) -> Array:
        """Map features ``(..., feature)`` to targets ``(..., target)``."""
        return np.asarray(features @ self.weights.T + self.intercept)

    @property
    def size(self) -> int:
        """Number of coefficients, intercepts included."""
        return int(self.weights.size + self.intercept.size)


def compress(parts: Iterable[Array]) -> Array:
    """Return a triangle R with ``R.T @ R`` the sum of ``part.T @ part``.

    Any squared error of a linear regression of some of the columns on others is the same on R as on
    all rows, so that it can be solved many times at the price of one pass over the rows.

    Parameters
    ----------
    parts
        Matrices ``(row, column)`` that together hold the rows.
    """
    triangle: Array | None = None
    for part in parts:
        stacked = part if triangle is None else np.concatenate([triangle, part])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    if triangle is None:
        raise ValueError("there are no rows")
    return triangle


def ridge_maps(
    features: Array, targets: Array, penalties: Sequence[float] = PENALTIES
) -> list[AffineMap]:
    """Fit ridge regressions with intercept, one a penalty.

    Features and targets are centred and the features brought to unit variance first; the penalty
    is on those coefficients, and grows with the number of rows.

    Parameters
    ----------
    features
        Shape ``(row, feature)``.
    targets
        Shape ``(row, target)``.
    penalties
        A row.
    """
    centre, middle = features.mean(axis=0), targets.mean(axis=0)
    spread = features.std(axis=0)
    # What differs by rounding alone would be blown up to noise.
    spread = np.where(spread > 1e-12 * np.abs(features).max(axis=0), spread, np.inf)
    scaled = np.concatenate([(features - centre) / spread, targets - middle], axis=1)
    triangle = compress([scaled])
    inputs, outputs = triangle[:, : features.shape[1]], triangle[:, features.shape[1] :]
    maps = []
    for penalty in penalties:
        ridge = Ridge(alpha=penalty * len(features), fit_intercept=False, solver="svd")
        weights = ridge.fit(inputs, outputs).coef_.reshape(targets.shape[1], -1) / spread
        maps.append(AffineMap(weights, middle - weights @ centre))
    return maps
