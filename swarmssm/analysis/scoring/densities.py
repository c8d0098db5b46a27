"""What each forecaster says of positions to come, and how good that proves to be."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from swarmssm import metrics
from swarmssm.analysis.scoring.forecasters import CHUNK, Forecaster, ModelForecaster
from swarmssm.analysis.scoring.scored import Scored
from swarmssm.metrics.log_score import (
    gaussian_log_score,
    mixture_log_score,
    moments_of_draws,
)
from swarmssm.metrics.masked import masked_mean
from swarmssm.tracks import Array

__all__ = ["SCORES", "batches", "mean_scores", "position_scores"]

Rows = npt.NDArray[np.int64]
#: What can be asked for.
SCORES = ("log_score", "crps", "energy_score", "mse", "coverage", "width")
#: Origins that are forecast at once, where their tensors are no larger than a few of CHUNK.
ORIGINS = 25


class Density(Protocol):
    """Forecast densities of positions, tracking noise included."""

    @property
    def mean(self) -> Array:
        """``(origin, step, individual, space)``."""

    def log_score(self, truth: Array) -> Array:
        """Return ``(origin, step, individual)``, nats per coordinate."""

    def crps(self, truth: Array) -> Array:
        """Return ``(origin, step, individual, space)``."""

    def energy_score(self, truth: Array) -> Array:
        """Return ``(origin, step, individual)``."""

    def intervals(self, levels: Sequence[float]) -> tuple[Array, Array]:
        """Return lower and upper ends ``(level, origin, step, individual, space)``."""


@dataclass(frozen=True)
class DrawnDensity:
    """Draws of positions as they may be seen.

    Attributes
    ----------
    seen
        ``(draw, origin, step, individual, space)``.
    mean
        ``(origin, step, individual, space)``.
    kernels
        What each draw expects of its last step: ``location``, ``variance`` of the shape of
        ``seen``, and degrees of freedom, see :func:`swarmssm.metrics.mixture_log_score`; ``None``
        where the forecaster does not tell.
    """

    seen: Array
    mean: Array
    kernels: tuple[Array, Array, float] | None = None

    def log_score(self, truth: Array) -> Array:
        """Return the score of the mixture of kernels, or of a normal with the draws' moments."""
        if self.kernels is not None:
            return mixture_log_score(truth, *self.kernels)
        # A forecast that broke down in one draw gives what came no probability at all.
        broken = np.isinf(self.seen).any(axis=(0, -1))
        mean, covariance = moments_of_draws(np.where(np.isinf(self.seen), 0.0, self.seen))
        covariance[broken] = 0.0
        return gaussian_log_score(truth, mean, covariance)

    def crps(self, truth: Array) -> Array:
        """Return the fair score of the draws."""
        return metrics.ensemble_crps(truth, self.seen)

    def energy_score(self, truth: Array) -> Array:
        """Return the fair score of the draws."""
        return metrics.ensemble_energy_score(truth, self.seen)

    def intervals(self, levels: Sequence[float]) -> tuple[Array, Array]:
        """Return intervals between ranks of the draws."""
        return metrics.ensemble_intervals(self.seen, levels)


@dataclass(frozen=True)
class NormalDensity:
    """Normal densities.

    Attributes
    ----------
    mean
        ``(origin, step, individual, space)``.
    covariance
        ``(step, 1, space, space)``.
    """

    mean: Array
    covariance: Array

    @property
    def sd(self) -> Array:
        """Standard deviation of each coordinate, ``(step, 1, space)``."""
        deviations: Array = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        return deviations

    def log_score(self, truth: Array) -> Array:
        """Return the log-density."""
        return gaussian_log_score(truth, self.mean, self.covariance)

    def crps(self, truth: Array) -> Array:
        """Return the closed form."""
        return metrics.gaussian_crps(truth, self.mean, self.sd)

    def energy_score(self, truth: Array) -> Array:
        """Return the closed form, by quadrature."""
        return metrics.gaussian_energy_score(truth, self.mean, self.covariance)

    def intervals(self, levels: Sequence[float]) -> tuple[Array, Array]:
        """Return the intervals of each coordinate."""
        return metrics.gaussian_intervals(self.mean, self.sd, levels)


def position_scores(
    subject: Scored,
    forecaster: Forecaster,
    trials: Rows,
    rows: Rows,
    steps: Sequence[int],
    *,
    draws: int,
    seed: int,
    levels: Sequence[float] = (),
    scores: Sequence[str] = SCORES,
    training: Array | None = None,
    progress: Callable[[], None] | None = None,
) -> dict[str, Array] | None:
    """Score what a forecaster says of the positions that are seen some steps ahead.

    Each forecast is a density of an individual's position, tracking noise included. That of a
    state-space model is the mixture of what sampled futures expect of their last step; that of any
    other model, and of the true rule, are sampled futures; that of a baseline a normal about what
    it predicts, with the covariance of its own errors at that step in the training part.

    Parameters
    ----------
    subject
        What is scored.
    forecaster
        Who is.
    trials, rows
        ``(origin,)``: the frames to go on from.
    steps
        Rising numbers of frames ahead.
    draws
        Sampled futures.
    seed
        Of all draws.
    levels
        Of the intervals.
    scores
        Which of :data:`SCORES`.
    training
        States ``(trial, time, individual, state)`` on which the errors of a baseline are measured.
    progress
        Called after each of :func:`batches`.

    Returns
    -------
    Name -> ``(origin, step, individual)``, for ``coverage`` and ``width`` with levels behind; mean
    over coordinates. NaN where the truth is unknown or the individual is not forecast; infinitely
    bad where the forecast broke down. ``None`` if the forecaster cannot go on from all of the
    frames.
    """
    longest = max(steps)
    chosen = np.asarray(steps) - 1
    spread = forecaster.spread(subject.states if training is None else training, longest)
    spread = None if spread is None else spread[chosen, None]
    found: dict[str, list[Array]] = {name: [] for name in scores}
    for number, batch in enumerate(batches(subject, len(rows), longest, draws)):
        truth = subject.ahead(trials[batch], rows[batch], longest)
        truth = truth[:, chosen, :, : subject.num_space]
        if spread is not None:
            expected = forecaster.forecasts(trials[batch], rows[batch], longest)
            if expected is None:
                return None
            mean = expected[:, chosen, :, : subject.num_space]
            density: Density = NormalDensity(mean, spread)
        else:
            drawn = _drawn(forecaster, trials[batch], rows[batch], longest, draws, seed, number)
            if drawn is None:
                return None
            density = _at_steps(drawn, chosen)
        for name, values in _scored(density, truth, levels, scores).items():
            found[name].append(values)
        if progress is not None:
            progress()
    return {name: np.concatenate(values) for name, values in found.items()}


def batches(subject: Scored, origins: int, longest: int, draws: int) -> Iterator[Rows]:
    """Yield the origins that are forecast together, so that memory stays bounded."""
    each = draws * longest * subject.mask.shape[-1] ** 2
    size = max(1, min(ORIGINS, 5 * CHUNK // each))
    yield from np.array_split(np.arange(origins), max(1, origins // size))


def mean_scores(
    found: Mapping[str, Mapping[str, Array]], axes: tuple[int, ...]
) -> dict[str, Array]:
    """Return means over those individuals that all models forecast, and how many these are.

    Parameters
    ----------
    found
        Model -> what :func:`position_scores` returned, of the same frames, with ``log_score``.
    axes
        What to average over: 0 the origins, 2 the individuals.

    Returns
    -------
    ``number`` of individuals counted, and each score with models in front; a model that says
    nothing at all at a horizon (a baseline whose errors are unknown there) is NaN, and does not
    take it from the others.
    """
    known = [~np.isnan(scores["log_score"]) for scores in found.values()]
    speaks = [np.logical_or.reduce(here, axis=(0, 2))[:, None] for here in known]
    heard = [here | ~some for here, some in zip(known, speaks, strict=True)]
    counted = np.logical_and.reduce(heard) & np.logical_or.reduce(known)
    means: dict[str, Array] = {"number": counted.sum(axes)}
    for score in next(iter(found.values()), {}):
        rows = []
        for scores, some in zip(found.values(), speaks, strict=True):
            each = scores[score]
            use = (counted & some).reshape(*counted.shape, *(1,) * (each.ndim - counted.ndim))
            rows.append(masked_mean(each, np.broadcast_to(use, each.shape), axis=axes))
        means[score] = np.stack(rows)
    return means


def _drawn(
    forecaster: Forecaster,
    trials: Rows,
    rows: Rows,
    steps: int,
    draws: int,
    seed: int,
    number: int,
) -> DrawnDensity | None:
    """Return sampled futures at all steps."""
    if isinstance(forecaster, ModelForecaster):
        kernels = forecaster.kernels(trials, rows, steps, draws, seed)
        if kernels is not None:
            return DrawnDensity(
                _sightings(*kernels, np.random.default_rng((seed, number))),
                _mean(kernels[0]),
                kernels,
            )
    seen = forecaster.positions(trials, rows, steps, draws, seed)
    return None if seen is None else DrawnDensity(seen, _mean(seen))


def _at_steps(density: DrawnDensity, chosen: Rows) -> DrawnDensity:
    """Return the density at some of the steps."""
    kernels = density.kernels
    if kernels is not None:
        kernels = kernels[0][:, :, chosen], kernels[1][:, :, chosen], kernels[2]
    return DrawnDensity(density.seen[:, :, chosen], density.mean[:, chosen], kernels)


def _sightings(
    location: Array, variance: Array, degrees: float, generator: np.random.Generator
) -> Array:
    """Draw one sighting from each kernel."""
    noise = generator.standard_normal(location.shape)
    if not math.isinf(degrees):
        # A multivariate Student's t: all coordinates of a step share their scale.
        scale = (degrees - 2.0) / generator.chisquare(degrees, location.shape[:-1])
        noise *= np.sqrt(scale)[..., None]
    with np.errstate(invalid="ignore"):
        seen = location + np.sqrt(variance) * noise
    # Who is there and has no place any more broke down.
    lost = np.isinf(seen) | (np.isnan(seen) & ~np.isnan(location))
    return np.where(lost, np.inf, seen)


def _mean(draws: Array) -> Array:
    """Return the mean of draws, infinite where one is."""
    broken = np.isinf(draws).any(0)
    mean: Array = np.where(np.isinf(draws), 0.0, draws).mean(0)
    return np.where(broken, np.inf, mean)


def _scored(
    density: Density, truth: Array, levels: Sequence[float], scores: Sequence[str]
) -> dict[str, Array]:
    """Return the scores of one batch."""
    found: dict[str, Array] = {}
    if "log_score" in scores:
        score = density.log_score(truth)
        told = ~np.isnan(density.mean + truth).any(-1)
        # A variance that is beyond all bounds has no density, and must not go uncounted.
        found["log_score"] = np.where(told & np.isnan(score), -np.inf, score)
    if "crps" in scores:
        found["crps"] = density.crps(truth).mean(-1)
    if "energy_score" in scores:
        found["energy_score"] = density.energy_score(truth)
    if "mse" in scores:
        with np.errstate(over="ignore"):
            found["mse"] = ((truth - density.mean) ** 2).mean(-1)
    if "coverage" in scores or "width" in scores:
        lower, upper = density.intervals(levels)
        # Of a forecast that broke down nothing is covered, however wide it is.
        inside = (lower <= truth) & (truth <= upper) & np.isfinite(lower) & np.isfinite(upper)
        told = ~(np.isnan(lower) | np.isnan(upper) | np.isnan(truth))
        values = {
            "coverage": np.where(told, inside.astype(np.float64), np.nan),
            "width": np.where(told, upper - lower, np.nan),
        }
        for name, each in values.items():
            if name in scores:
                found[name] = np.moveaxis(each.mean(-1), 0, -1)
    return found
