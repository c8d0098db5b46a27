"""How far off a baseline is: the spread of its forecasts, of which it has none of its own."""

import numpy as np

from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.tracks import Array

__all__ = ["baseline_covariances"]

#: Origins from which the errors of a baseline are measured, and individuals at all of them.
ERROR_ORIGINS = 2000
ERROR_FORECASTS = 20_000


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
    origins = min(ERROR_ORIGINS, ERROR_FORECASTS // states.shape[-2])
    count = max(2, origins // num_trials)
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
