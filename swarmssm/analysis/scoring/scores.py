"""The scores of forecast densities: each is one function, and one entry of :data:`SCORES`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swarmssm.analysis.scoring.densities import Density
from swarmssm.metrics.masked import masked_mean
from swarmssm.tracks import Array

__all__ = ["LOWER_IS_BETTER", "SCORES", "Score", "mean_scores", "score_density"]


def log_score(forecast: Density, truth: Array, levels: Sequence[float]) -> Array:
    """Return log-densities of positions, per coordinate."""
    score = forecast.log_score(truth)
    known = ~np.isnan(forecast.mean + truth).any(-1)
    # A variance that is beyond all bounds has no density, and must not go uncounted.
    return np.where(known & np.isnan(score), -np.inf, score)


def crps(forecast: Density, truth: Array, levels: Sequence[float]) -> Array:
    """Return the mean over coordinates of the continuous ranked probability score."""
    return np.asarray(forecast.crps(truth).mean(-1))


def energy_score(forecast: Density, truth: Array, levels: Sequence[float]) -> Array:
    """Return the energy score of positions."""
    return forecast.energy_score(truth)


def squared_error(forecast: Density, truth: Array, levels: Sequence[float]) -> Array:
    """Return squared errors of the forecast's mean, per coordinate."""
    with np.errstate(over="ignore"):
        return np.asarray(((truth - forecast.mean) ** 2).mean(-1))


def coverage(forecast: Density, truth: Array, levels: Sequence[float]) -> Array:
    """Return the share of coordinates inside each central interval, levels behind."""
    lower, upper = forecast.intervals(levels)
    # Of a forecast that diverged nothing is covered, however wide it is.
    inside = (lower <= truth) & (truth <= upper) & np.isfinite(lower) & np.isfinite(upper)
    known = ~(np.isnan(lower) | np.isnan(upper) | np.isnan(truth))
    return _levels_last(np.where(known, inside.astype(np.float64), np.nan))


def width(forecast: Density, truth: Array, levels: Sequence[float]) -> Array:
    """Return the width of each central interval of a coordinate, levels behind."""
    lower, upper = forecast.intervals(levels)
    known = ~(np.isnan(lower) | np.isnan(upper) | np.isnan(truth))
    return _levels_last(np.where(known, upper - lower, np.nan))


@dataclass(frozen=True)
class Score:
    """One score of forecasts.

    Attributes
    ----------
    function
        From density, truth ``(origin, step, individual, space)`` and levels to ``(origin, step,
        individual)``, with levels behind if ``by_level``; NaN where nothing can be scored,
        infinitely bad where the forecast diverged.
    long_name
        For tables.
    units
        ``{unit}`` stands for that of the tracks.
    sign
        1 where higher is better, -1 where lower is better, 0 where neither is.
    by_level
        Whether it is of central intervals.
    """

    function: Callable[[Density, Array, Sequence[float]], Array]
    long_name: str
    units: str = "{unit}"
    sign: int = -1
    by_level: bool = False


SCORES: dict[str, Score] = {
    "log_score": Score(
        log_score, "log score of an individual's position, per coordinate", "nat", 1
    ),
    "crps": Score(crps, "continuous ranked probability score of a coordinate"),
    "energy_score": Score(energy_score, "energy score of an individual's position"),
    "mse": Score(squared_error, "squared error of the forecast's mean, per coordinate", "{unit}^2"),
    "coverage": Score(
        coverage, "share of coordinates inside the central interval", "1", 0, by_level=True
    ),
    "width": Score(width, "width of the central interval of a coordinate", sign=0, by_level=True),
}
LOWER_IS_BETTER = tuple(name for name, score in SCORES.items() if score.sign < 0)


def score_density(
    forecast: Density, truth: Array, levels: Sequence[float], names: Sequence[str]
) -> dict[str, Array]:
    """Return each named score of a forecast, see :class:`Score`."""
    return {name: SCORES[name].function(forecast, truth, levels) for name in names}


def mean_scores(found: Mapping[str, Mapping[str, Array]]) -> dict[str, Array]:
    """Return means over those individuals that all methods forecast, and how many these are.

    Parameters
    ----------
    found
        Method -> score -> ``(origin, step, individual[, level])`` of the same frames, with
        ``log_score`` among them.

    Returns
    -------
    ``number (origin, step)`` of individuals counted, and each score with methods in front; a method
    without any forecast at a horizon (a baseline whose errors are unknown there) is NaN, and does
    not take it from the others.
    """
    known = [~np.isnan(scores["log_score"]) for scores in found.values()]
    speaks = [np.logical_or.reduce(here, axis=(0, 2))[:, None] for here in known]
    heard = [here | ~some for here, some in zip(known, speaks, strict=True)]
    counted = np.logical_and.reduce(heard) & np.logical_or.reduce(known)
    means: dict[str, Array] = {"number": counted.sum(2)}
    for score in next(iter(found.values()), {}):
        rows = []
        for scores, some in zip(found.values(), speaks, strict=True):
            each = scores[score]
            use = (counted & some).reshape(*counted.shape, *(1,) * (each.ndim - counted.ndim))
            rows.append(masked_mean(each, np.broadcast_to(use, each.shape), axis=(2,)))
        means[score] = np.stack(rows)
    return means


def _levels_last(values: Array) -> Array:
    """Return means over coordinates of ``(level, origin, step, individual, space)``."""
    return np.moveaxis(values.mean(-1), 0, -1)
