"""Project the accelerations that a model expects on pairwise forces that depend on distance."""

from typing import NamedTuple

import numpy as np
import torch
from scipy.interpolate import BSpline

from swarmssm.analysis.interpretation.forces.frames import (
    OWN_COLUMNS,
    Frames,
    frames_of,
    own_columns,
    seen_graph,
)
from swarmssm.analysis.posterior.accelerations import AccelerationModel, PosteriorPaths
from swarmssm.inference import Fit
from swarmssm.inference.prediction import seeded
from swarmssm.tracks import Array

__all__ = ["Projection", "project"]

DEGREE = 3
#: Splines for each kernel.
SPLINES = 12
#: Blocks of time, which are resampled and left out.
BLOCKS = 20
#: Strengths of the smoothing prior that are tried, relative to the mean of the normal equations.
STRENGTHS = np.logspace(-8, 1, 10)
#: Columns of the individual's own terms, behind those of the two kernels.
OWN = slice(2 * SPLINES, None)
#: What keeps the equations solvable where there is no data.
LEAST = 1e-10


class Projection(NamedTuple):
    """What was found.

    Attributes
    ----------
    kernels
        ``"attraction"`` and ``"alignment"``, each ``(draw, distance)``.
    projection_r2
        ``(draw,)``: share of the mean square of the acceleration, in blocks that were left out.
    neighbor_r2
        ``(draw,)``: what of it the kernels add to the individual's own terms alone.
    """

    kernels: dict[str, Array]
    projection_r2: Array
    neighbor_r2: Array


class _Normal(NamedTuple):
    """Normal equations of each block: ``(block, column, column)``, ``(block, column)``, and sum of
    squares ``(block,)``.
    """

    products: Array
    targets: Array
    squares: Array


def project(
    fit: Fit,
    motion: AccelerationModel,
    paths: PosteriorPaths,
    support: tuple[float, float],
    distances: Array,
    draws: int,
    seed: int | torch.Generator,
) -> Projection:
    """Fit splines of the distance to the accelerations that a model expects.

    Ridge regression on second differences of neighbouring coefficients, its strength chosen by
    leaving out blocks of time. Each draw takes one of the paths, with its blocks weighted by
    independent exponential weights (Bayesian bootstrap, Rubin 1981).

    Parameters
    ----------
    fit, motion, paths
        What is projected.
    support
        Least and greatest distance that the splines stretch over; constant beyond.
    distances
        Where kernels are wanted.
    draws
        How many.
    seed
        Seed or generator.
    """
    knots = _knots(*support)
    with torch.no_grad():
        normals = [_normal(fit, motion, paths, draw, knots) for draw in range(paths.draws)]
    penalty = _penalty()
    basis = _basis(distances, knots)
    fitted = [_strength(normal, penalty) for normal in normals]
    alone = [
        _left_out(_own_terms(normal), 0.0, np.zeros_like(penalty)[OWN, OWN]) for normal in normals
    ]
    with seeded(seed):
        weights = torch.empty(draws, BLOCKS, dtype=torch.float64).exponential_().numpy()
    kernels = {name: np.empty((draws, len(distances))) for name in ("attraction", "alignment")}
    projection_r2, neighbor_r2 = np.full(draws, np.nan), np.full(draws, np.nan)
    for draw in range(draws):
        normal = normals[draw % paths.draws]
        strength, left = fitted[draw % paths.draws]
        weight = weights[draw][: len(normal.squares)]
        total = weight @ normal.squares
        if total > 0:
            projection_r2[draw] = 1.0 - weight @ left / total
            neighbor_r2[draw] = weight @ (alone[draw % paths.draws] - left) / total
        products = np.tensordot(weight, normal.products, 1)
        solution = _solve(products, weight @ normal.targets, strength, penalty)
        kernels["attraction"][draw] = basis @ solution[:SPLINES]
        kernels["alignment"][draw] = basis @ solution[SPLINES : 2 * SPLINES]
    return Projection(kernels, projection_r2, neighbor_r2)


def _knots(low: float, high: float) -> Array:
    """Return clamped knots at equal steps."""
    inner = np.linspace(low, max(high, low * (1 + 1e-9) + 1e-12), SPLINES - DEGREE + 1)
    return np.concatenate([[inner[0]] * DEGREE, inner, [inner[-1]] * DEGREE])


def _basis(distances: Array, knots: Array) -> Array:
    """Return the splines at given distances, ``(distance, spline)``."""
    within = np.clip(distances, knots[0], knots[-1])
    return np.asarray(BSpline.design_matrix(within, knots, DEGREE).toarray())


def _penalty() -> Array:
    """Return the matrix of squared second differences of the coefficients of both kernels."""
    second = np.diff(np.eye(SPLINES), 2, axis=0)
    own = second.T @ second
    out = np.zeros((2 * SPLINES + len(OWN_COLUMNS), 2 * SPLINES + len(OWN_COLUMNS)))
    out[:SPLINES, :SPLINES] = own
    out[SPLINES : 2 * SPLINES, SPLINES : 2 * SPLINES] = own
    return out


def _normal(
    fit: Fit, motion: AccelerationModel, paths: PosteriorPaths, draw: int, knots: Array
) -> _Normal:
    """Add up the normal equations of a draw by blocks of time."""
    trials, times, _ = paths.present.shape
    total = trials * times
    blocks = min(BLOCKS, total)
    size = 2 * SPLINES + len(OWN_COLUMNS)
    products, targets = np.zeros((blocks, size, size)), np.zeros((blocks, size))
    squares = np.zeros(blocks)
    belongs = np.arange(total) * blocks // total
    for frames in frames_of(paths, draw):
        columns = _columns(fit, frames, knots)
        whole = motion.acceleration(
            frames.states, frames.adjacency, frames.present, frames.values
        ).double()
        own = belongs[frames.rows]
        for block in np.unique(own):
            chosen = torch.from_numpy(own == block)
            part = columns[chosen].flatten(0, 2).numpy()
            target = whole[chosen].flatten().numpy()
            products[block] += part.T @ part
            targets[block] += part.T @ target
            squares[block] += target @ target
    return _Normal(products, targets, squares)


def _columns(fit: Fit, frames: Frames, knots: Array) -> torch.Tensor:
    """Return ``(frame, individual, space, column)``: splines for f, for g, and the self part."""
    graph = seen_graph(fit, frames)
    positions, velocities = frames.positions, frames.velocities
    total = graph.sum(-1)
    frame, mine, theirs = torch.nonzero(graph, as_tuple=True)
    share = graph[frame, mine, theirs] / total[frame, mine]
    offset = positions[frame, theirs] - positions[frame, mine]
    distance = offset.norm(dim=-1, keepdim=True)
    toward = offset / torch.where(distance > 0, distance, 1.0)
    relative = velocities[frame, theirs] - velocities[frame, mine]
    basis = torch.from_numpy(_basis(distance.squeeze(-1).numpy(), knots)) * share.unsqueeze(-1)
    row = frame * graph.shape[-1] + mine
    pairs = []
    for vector in (toward, relative):
        summed = positions.new_zeros(
            positions.shape[0] * positions.shape[1], positions.shape[-1], SPLINES
        )
        summed.index_add_(0, row, vector.unsqueeze(-1) * basis.unsqueeze(-2))
        pairs.append(summed.reshape(*positions.shape, SPLINES))
    own = own_columns(fit, frames)
    columns = torch.cat([*pairs, torch.stack(own, -1)], -1)
    return columns * frames.present[..., None, None]


def _solve(products: Array, targets: Array, strength: float, penalty: Array) -> Array:
    """Solve penalised normal equations, each kernel and column on its own scale."""
    diagonal = products.diagonal().copy()
    scale = np.ones(len(diagonal))
    own = -len(OWN_COLUMNS)
    for part in np.split(
        np.arange(len(diagonal) + own), range(SPLINES, len(diagonal) + own, SPLINES)
    ):
        if part.size:
            scale[part] = np.sqrt(max(diagonal[part].mean(), 1e-300))
    scale[own:] = np.sqrt(np.where(diagonal[own:] > 0, diagonal[own:], 1.0))
    matrix = products / scale / scale[:, None] + strength * penalty
    matrix += LEAST * np.eye(len(matrix))
    return np.asarray(np.linalg.solve(matrix, targets / scale) / scale)


def _strength(normal: _Normal, penalty: Array) -> tuple[float, Array]:
    """Return the strength that predicts left-out blocks best, and its squared errors there."""
    tried = [_left_out(normal, strength, penalty) for strength in STRENGTHS]
    best = int(np.argmin([errors.sum() for errors in tried]))
    return float(STRENGTHS[best]), tried[best]


def _left_out(normal: _Normal, strength: float, penalty: Array) -> Array:
    """Return the sum of squared errors in each block, fitted to all others, ``(block,)``."""
    products, targets = normal.products.sum(0), normal.targets.sum(0)
    errors = []
    for product, target, square in zip(*normal, strict=True):
        solution = _solve(products - product, targets - target, strength, penalty)
        errors.append(square - 2 * solution @ target + solution @ product @ solution)
    return np.array(errors)


def _own_terms(normal: _Normal) -> _Normal:
    """Return the normal equations of the individual's own terms alone."""
    return _Normal(normal.products[:, OWN, OWN], normal.targets[:, OWN], normal.squares)
