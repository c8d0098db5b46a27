"""How probable a forecast made what came: the log score of positions, step by step."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from swarmssm.analysis.forecasters import BaselineForecaster, Forecaster, ModelForecaster
from swarmssm.analysis.subject import Subject
from swarmssm.metrics.log_score import (
    gaussian_log_score,
    mixture_log_score,
    moments_of_draws,
)
from swarmssm.models.baselines import Baseline
from swarmssm.tracks import Array

__all__ = ["LOG_SCORE_DRAWS", "baseline_covariances", "log_scores"]

Rows = npt.NDArray[np.int64]
#: Futures from which the mean and covariance of a forecast are taken.
LOG_SCORE_DRAWS = 100
#: Origins in the training part from which the errors of a baseline are measured.
ERROR_ORIGINS = 2000


def log_scores(
    subject: Subject,
    forecasters: Sequence[Forecaster],
    trials: Rows,
    rows: Rows,
    steps: int,
    seed: int,
) -> tuple[dict[str, Array], list[str]]:
    """Return the mean log score of the observed positions at each step ahead.

    Each forecast is a density of an individual's position, tracking noise included. That of a
    state-space model is the mixture of what :data:`LOG_SCORE_DRAWS` sampled futures expect
    (:func:`swarmssm.metrics.mixture_log_score`); that of any other model, and of the true rule, a
    normal with the mean and covariance of as many futures; that of a baseline a normal about what
    it predicts, with the covariance of its own errors at that step in the training part.

    Parameters
    ----------
    subject
        What is scored.
    forecasters
        Who is.
    trials, rows
        ``(origin,)``.
    steps
        Longest horizon.
    seed
        Of all draws.

    Returns
    -------
    Name -> ``(step,)``, in nats per coordinate, over the same origins and individuals for all; and
    notes.
    """
    truth = subject.ahead(trials, rows, steps)[..., : subject.num_space]
    scores, notes = {}, []
    for forecaster in forecasters:
        if isinstance(forecaster, BaselineForecaster):
            moments = _of_baseline(subject, forecaster, trials, rows, steps)
            scores[forecaster.name] = gaussian_log_score(truth, *moments)
            continue
        # A few origins at once, so that memory stays bounded.
        parts = [
            _of_draws(forecaster, truth[chosen], trials[chosen], rows[chosen], steps, seed)
            for chosen in np.array_split(np.arange(len(rows)), max(1, len(rows) // 25))
        ]
        told = [part for part in parts if part is not None]
        if len(told) == len(parts):
            scores[forecaster.name] = np.concatenate(told)
    if subject.training is None and any(isinstance(f, BaselineForecaster) for f in forecasters):
        notes.append(
            "The spread of the baselines' forecasts is that of their errors on the scored frames "
            "themselves: their log scores flatter them."
        )
    everywhere = np.logical_and.reduce([~np.isnan(score) for score in scores.values()])
    means = {}
    for name, score in scores.items():
        counted = np.where(everywhere, score, 0.0).sum((0, 2))
        number = everywhere.sum((0, 2))
        means[name] = np.divide(counted, number, out=np.full(steps, np.nan), where=number > 0)
    return means, notes


def _of_draws(
    forecaster: Forecaster, truth: Array, trials: Rows, rows: Rows, steps: int, seed: int
) -> Array | None:
    """Return scores ``(origin, step, individual)`` of sampled futures."""
    if isinstance(forecaster, ModelForecaster):
        kernels = forecaster.kernels(trials, rows, steps, LOG_SCORE_DRAWS, seed)
        if kernels is not None:
            return mixture_log_score(truth, *kernels)
    drawn = forecaster.positions(trials, rows, steps, LOG_SCORE_DRAWS, seed)
    if drawn is None:
        return None
    # A forecast that broke down in one draw gives what came no probability at all.
    broken = np.isinf(drawn).any(axis=(0, -1))
    mean, covariance = moments_of_draws(np.where(np.isinf(drawn), 0.0, drawn))
    covariance[broken] = 0.0
    return gaussian_log_score(truth, mean, covariance)


def _of_baseline(
    subject: Subject, forecaster: BaselineForecaster, trials: Rows, rows: Rows, steps: int
) -> tuple[Array, Array]:
    """Return the baseline's forecast with the covariance of its errors at each step."""
    own = subject.states if subject.training is None else subject.training
    covariance = baseline_covariances(forecaster.baseline, own, steps, subject.fps)
    mean = forecaster.forecasts(trials, rows, steps)[..., : subject.num_space]
    return mean, covariance[:, None]


def baseline_covariances(baseline: Baseline, states: Array, steps: int, fps: float) -> Array:
    """Return the covariance of a baseline's position errors at each step.

    Parameters
    ----------
    baseline
        Baseline.
    states
        ``(trial, time, individual, state)``, NaN where unknown.
    steps
        Longest horizon.
    fps
        Frames per second.

    Returns
    -------
    ``(step, space, space)``, NaN where fewer than ten errors are known: mean squares about zero,
    since the baseline takes its forecasts to be unbiased.
    """
    num_trials, num_times = states.shape[:2]
    space = states.shape[-1] // 2
    last = max(1, num_times - 1)
    count = max(2, ERROR_ORIGINS // num_trials)
    rows = np.unique(np.linspace(0, last - 1, min(last, count)).astype(int))
    trials, rows = np.repeat(np.arange(num_trials), len(rows)), np.tile(rows, num_trials)
    first = rows[:, None] + np.arange(1 - baseline.order, 1)
    history = states[trials[:, None], np.maximum(first, 0)]
    history[first < 0] = np.nan
    predicted = baseline.predict(history, steps, fps)[..., :space]
    padded = np.pad(states, ((0, 0), (0, steps), (0, 0), (0, 0)), constant_values=np.nan)
    ahead = padded[trials[:, None], rows[:, None] + np.arange(1, steps + 1)][..., :space]
    errors = np.moveaxis(ahead - predicted, 1, 0).reshape(steps, -1, space)
    covariance = np.full((steps, space, space), np.nan)
    for step, error in enumerate(errors):
        seen = error[np.isfinite(error).all(-1)]
        if len(seen) >= 10:
            covariance[step] = seen.T @ seen / len(seen)
    return covariance
