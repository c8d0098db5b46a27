"""Choosing among candidates of one method by how well they forecast what they did not see."""

from collections.abc import Iterable
from typing import TypeVar

import numpy as np

from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["best_of", "learning_and_judging_parts", "rollout_error"]

STEPS = (1, 5, 10, 20, 50)
MOST_ORIGINS = 20
#: Squared errors below this, in standard deviations, are rounding alone, and all the same.
ROUNDING = 1e-16
#: Share of the frames that judges where there is no validation part.
JUDGING_SHARE = 0.2

Candidate = TypeVar("Candidate")


def learning_and_judging_parts(states: Array, training: Training) -> tuple[Array, Array]:
    """Return the states to learn candidates from, and those to choose among them by.

    These are the training and the validation part; without the latter, the first four fifths of
    the frames and the last.
    """
    if training.validation is not None:
        return states, training.validation
    cut = round((1.0 - JUDGING_SHARE) * states.shape[1])
    early, late = states[:, :cut], states[:, cut:]
    enough = all(_steps(part) >= 2 for part in (early, late))
    return (early, late) if enough else (states, states)


def rollout_error(baseline: Baseline, states: Array, fps: float, history: int) -> float:
    """Return the mean logarithm of the squared error of rollouts, over 1, 5, 10, 20 and 50 steps.

    The logarithm gives the horizons equal weight, though errors grow by orders of magnitude from
    the first to the last. Each state component counts in its own standard deviation.

    Parameters
    ----------
    baseline
        What is judged.
    states
        Shape ``(trial, time, individual, state)``.
    fps
        Frames per second.
    history
        Number of frames that a forecast is given.

    Returns
    -------
    A number, the smaller the better; infinite if the rollouts leave all bounds.
    """
    num_times = states.shape[1]
    history = min(history, num_times - 1)
    horizon = min(STEPS[-1], num_times - history)
    origins = np.arange(history, num_times - horizon + 1)
    picked = np.unique(np.linspace(0, len(origins) - 1, MOST_ORIGINS).round().astype(int))
    origins = origins[picked]
    given = np.stack([states[:, origin - history : origin] for origin in origins])
    truth = np.stack([states[:, origin : origin + horizon] for origin in origins])
    with np.errstate(all="ignore"):
        path = baseline.predict(given, horizon, fps)
        rows = states[known(states)]
        spread = rows.std(axis=0)
        squared = ((path - truth) / np.where(spread > 0, spread, 1.0)) ** 2
    reached = np.array([k - 1 for k in STEPS if k <= horizon])
    # Whoever was forecast at the first step and has become NaN since has left all bounds.
    forecast = known(path[:, :, :1])
    scored = (known(truth) & forecast)[:, :, reached]
    errors = np.where(np.isnan(squared), np.inf, squared).mean(axis=-1)[:, :, reached]
    logarithms = []
    for k in range(len(reached)):
        chosen = errors[:, :, k][scored[:, :, k]]
        if len(chosen):
            logarithms.append(np.log(chosen.mean() + ROUNDING))
    return float(np.mean(logarithms)) if logarithms else 0.0


def best_of(
    candidates: Iterable[tuple[Candidate, Baseline]],
    states: Array,
    fps: float,
    history: int = 1,
    *,
    tolerance: float = 0.0,
) -> Candidate:
    """Return the first of the candidates whose baseline has the smallest rollout error.

    Parameters
    ----------
    candidates
        Pairs of what is chosen and a baseline that uses it; the baseline may be the same object
        each time, set anew when the next pair is drawn.
    states, fps, history
        As for :func:`rollout_error`.
    tolerance
        The first candidate whose error is above the smallest by no more than this will do.
    """
    scored = [
        (rollout_error(baseline, states, fps, history), kept) for kept, baseline in candidates
    ]
    good_enough = min(error for error, _ in scored) + tolerance
    return next(kept for error, kept in scored if error <= good_enough)


def _steps(states: Array) -> int:
    """Return how many steps are known from both ends."""
    seen = known(states)
    return int((seen[:, 1:] & seen[:, :-1]).sum())
