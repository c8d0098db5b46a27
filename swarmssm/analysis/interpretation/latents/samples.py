"""Samples of a recording on which probes are compared, their folds and their null hypothesis."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from swarmssm.analysis.interpretation.latents.block_folds import (
    Cells,
    Folds,
    block_folds,
    decorrelation,
)
from swarmssm.analysis.interpretation.latents.probes import RidgeProbe
from swarmssm.analysis.interpretation.latents.time_shifts import Shifts, filled, p_values, shifts_of
from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["Samples", "Scores", "scaled"]

#: Shifts whose targets are held at once.
BATCH = 20


def scaled(features: Array) -> Array:
    """Return features ``(..., sample, feature)`` centred and of unit variance; constant ones 0."""
    centred = features - features.mean(-2, keepdims=True)
    spread = centred.std(-2, keepdims=True)
    # What is left of a constant by rounding is no feature.
    moving = spread > 1e-9 * np.abs(features).max(-2, keepdims=True)
    return np.asarray(np.where(moving, centred / np.where(moving, spread, 1.0), 0.0))


@dataclass(frozen=True)
class Scores:
    """R^2 of groups of features, and how they would be by chance."""

    each: Array  # (group, term, space)
    vector: Array  # (group, term)
    each_p: Array
    vector_p: Array
    family_p: Array


@dataclass(frozen=True)
class Samples:
    """The samples that all probes share: where they stand, what they are to tell."""

    chosen: npt.NDArray[np.bool_]
    stride: int
    frames: npt.NDArray[np.int64]
    folds: Folds
    cells: Cells
    targets: Array
    moving: Array
    shifts: Shifts

    @classmethod
    def of(
        cls,
        known: npt.NDArray[np.bool_],
        flat: Array,
        shape: tuple[int, ...],
        fps: float,
        folds: int,
        shifts: int,
        max_samples: int,
        seed: int,
    ) -> "Samples":
        """Thin out frames, divide them, and prepare the targets and their shifts."""
        if not known.any():
            raise InputError("tracks: in no frame are latents and forces known together.")
        stride = max(1, int(np.ceil(known.sum() / max_samples)))
        thin, moving = known[:, ::stride], flat[:, ::stride]
        memory = decorrelation(np.where(thin[..., None], moving, np.nan))
        frames = np.asarray(thin.any(-1))
        gap = max(1, min(memory, frames.sum(1).max() // (4 * max(folds, 1))))
        divided = block_folds(frames, folds, gap)
        rows = np.arange(frames.shape[1])
        lengths = np.where(frames.any(1), np.where(frames, rows, -1).max(1) + 1, 0)
        place = np.broadcast_to(np.arange(frames.size).reshape(*frames.shape, 1), thin.shape)
        whole = filled(np.where(thin[..., None], moving, np.nan))
        whole = whole.reshape(*whole.shape[:3], *shape)
        return cls(
            thin,
            stride,
            place[thin],
            divided,
            Cells.of(place[thin], divided),
            whole[thin],
            whole,
            shifts_of(lengths, shifts, gap, seed),
        )

    @property
    def flat_targets(self) -> Array:
        """``(sample, component)``."""
        return self.targets.reshape(len(self.targets), -1)

    def rows(self, values: Array) -> Array:
        """Return ``(sample, feature)`` of ``(trial, time, individual, feature)``."""
        return values[:, :: self.stride][self.chosen].astype(np.float64)

    def probe(self, features: Array, *, linear: bool) -> RidgeProbe:
        """Return the probe of features."""
        return RidgeProbe(scaled(features) if linear else features, self.cells)

    def score(self, features: Array, *, linear: bool) -> Scores:
        """Return R^2 and p-values of features ``(group, sample, feature)``."""
        probe = self.probe(features, linear=linear)
        each, vector = probe.r2(self.targets)
        null_each, null_vector = [], []
        for batch in self.shifts.batches(BATCH):
            moved = np.stack([self.shifts.moved(self.moving, s)[self.chosen] for s in batch], 1)
            count = (len(batch), self.targets.shape[1])
            one, other = probe.r2(moved.reshape(len(moved), -1, moved.shape[-1]))
            null_each.append(np.moveaxis(one.reshape(len(one), *count, -1), 1, 0))
            null_vector.append(np.moveaxis(other.reshape(len(other), *count), 1, 0))
        null, vectors = np.concatenate(null_each), np.concatenate(null_vector)
        best = np.nanmax(np.where(np.isnan(null), -np.inf, null).reshape(len(null), -1), -1)
        best = best.reshape(-1, *(1,) * each.ndim)
        return Scores(
            each, vector, p_values(each, null), p_values(vector, vectors), p_values(each, best)
        )

    def canonical(self, rows: Array) -> tuple[Array, Array]:
        """Return canonical correlations with all forces together, and their p-values."""
        probe = RidgeProbe(scaled(rows), self.cells, penalties=(1e-2,))
        found = probe.canonical(self.flat_targets)[0]
        null = []
        for shift in range(len(self.shifts)):
            moved = self.shifts.moved(self.moving, shift)[self.chosen]
            null.append(probe.canonical(moved.reshape(len(moved), -1))[0])
        return found, p_values(found, np.stack(null))
