"""Scaling of states to the range a network likes, fitted on the training part and invertible."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from swarmssm.errors import InputError
from swarmssm.tracks.dataset import Array

__all__ = ["SCALERS", "Scaler", "fit_scaler"]

SCALERS = ("minmax", "isotropic", "none")


@dataclass(frozen=True)
class Scaler:
    """Affine map of each state feature: ``scaled = (state - offset) / scale``.

    Attributes
    ----------
    kind
        How it was fitted, one of :data:`SCALERS`.
    offset, scale
        One number a state feature, in the feature's own unit.
    """

    kind: str
    offset: tuple[float, ...]
    scale: tuple[float, ...]

    def transform(self, states: Array) -> Array:
        """Scale states of shape ``(..., state)``; NaN stays NaN."""
        return np.asarray((states - np.asarray(self.offset)) / np.asarray(self.scale))

    def inverse(self, scaled: Array) -> Array:
        """Undo :meth:`transform`."""
        return np.asarray(scaled * np.asarray(self.scale) + np.asarray(self.offset))

    def transform_tensor(self, states: torch.Tensor) -> torch.Tensor:
        """Scale a tensor of states of shape ``(..., state)``."""
        return (states - states.new_tensor(self.offset)) / states.new_tensor(self.scale)

    def inverse_tensor(self, scaled: torch.Tensor) -> torch.Tensor:
        """Undo :meth:`transform_tensor`."""
        return scaled * scaled.new_tensor(self.scale) + scaled.new_tensor(self.offset)


def fit_scaler(states: Array, kind: str = "minmax") -> Scaler:
    """Fit a scaler to the states of the training part.

    Parameters
    ----------
    states
        Shape ``(..., state)``, ordered ``[x, y, vx, vy]`` (``[x, y, z, ...]`` in 3-D), NaN where
        unknown. With ``"minmax"`` and ``"none"`` any features.
    kind
        ``"minmax"``: each feature by its own range to [0, 1], eq. (3.49) of the thesis; it
        distorts angles. ``"isotropic"``: all coordinates by the same length - positions about
        their mean, divided by their standard deviation over all axes, velocities by their own
        root mean square without an offset - so that rotations stay rotations. ``"none"``: as they
        are.

    Raises
    ------
    InputError
        If ``kind`` is unknown, a feature is known nowhere, or nothing moves so that there is no
        range to divide by.
    """
    num_features = states.shape[-1]
    if kind not in SCALERS:
        raise InputError(f"scaler: {kind!r} is unknown; choose one of {', '.join(SCALERS)}.")
    if kind == "isotropic" and num_features not in (4, 6):
        raise InputError(
            "states: an isotropic scaler needs positions and velocities, 4 features or 6, and "
            f"there are {num_features}."
        )
    rows = states.reshape(-1, num_features)
    if not np.isfinite(rows).any(0).all():
        raise InputError(
            "tracks: no individual is seen in two consecutive frames of the training part."
        )
    if kind == "none":
        return Scaler(kind, (0.0,) * num_features, (1.0,) * num_features)
    # Each feature from all that is known of it: positions are known before velocities are.
    if kind == "minmax":
        low, high = np.fmin.reduce(rows, axis=0), np.fmax.reduce(rows, axis=0)
        offset, scale = low, high - low
    else:
        half = num_features // 2
        centre = np.nanmean(rows[:, :half], axis=0)
        offset = np.concatenate([centre, np.zeros(half)])
        length = np.sqrt(np.nanmean((rows[:, :half] - centre) ** 2))
        speed = np.sqrt(np.nanmean(rows[:, half:] ** 2))
        scale = np.repeat([length, speed], half)
    # What differs by rounding alone is constant too, and would be blown up to noise.
    still = ~(scale > 1e-12 * np.fmax.reduce(np.abs(rows), axis=0))
    if still.any():
        raise InputError(
            f"tracks: nothing moves in the training part along {_feature(still)}; there is no "
            "range to scale by. Choose the scaler "
            + ("none." if kind == "isotropic" else "isotropic or none.")
        )
    return Scaler(kind, tuple(offset.tolist()), tuple(scale.tolist()))


def _feature(still: npt.NDArray[np.bool_]) -> str:
    """Name the first feature of a state that is true."""
    index, half = int(np.argmax(still)), len(still) // 2
    if len(still) not in (4, 6):
        return f"feature {index}"
    return f"{'velocity' if index >= half else 'position'} {'xyz'[index % half]}"
