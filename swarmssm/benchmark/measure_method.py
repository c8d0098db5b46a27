"""Fit one method to a task, and score it."""

import resource
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm import metrics
from swarmssm.analysis.posterior.subject import subject_of
from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.analysis.scoring.forecasters import BaselineForecaster, FitForecaster, Forecaster
from swarmssm.analysis.scoring.free_runs import collective_scores
from swarmssm.analysis.scoring.rolling_origin import score_positions
from swarmssm.baselines.registry import BASELINES, baseline_named
from swarmssm.benchmark.edges import edge_scores
from swarmssm.benchmark.models import MODELS
from swarmssm.benchmark.task import Task
from swarmssm.benchmark.true_rule import TrueRule, true_rule
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["FLOOR", "METHODS", "Measured", "measure"]

Rows = npt.NDArray[np.int64]
FLOOR = TrueRule.name
#: All that can be compared, in the order of tables before they are sorted.
METHODS = (*BASELINES, *MODELS)
MEGABYTE = 1024.0 * (1024.0 if sys.platform == "darwin" else 1.0)


@dataclass(frozen=True)
class Measured:
    """What came of one method with one seed.

    Attributes
    ----------
    facts
        Name -> number or text, a row of the table.
    crps, log_score
        Of positions, ``(origin, horizon, individual)``, NaN where nothing is scored.
    squared_error
        Mean squared error of scaled states at steps 1 to the last horizon.
    """

    facts: dict[str, Any]
    crps: Array
    log_score: Array
    squared_error: Array


def measure(task: Task, name: str, seconds: float | None, seed: int) -> Measured:
    """Fit a method and score it.

    Parameters
    ----------
    task
        Task.
    name
        One of :data:`METHODS`, or ``"noise-floor"``.
    seconds
        Processor seconds that training may take; ``None``: as many as the method wants.
    seed
        Of weights and batches.

    Raises
    ------
    InputError
        If there is no such method, it cannot be used on these tracks, or their rule is not known.
    """
    began = time.process_time()
    forecaster, about, fitted = _fitted(task, name, seconds, seed)
    facts: dict[str, Any] = {"train_s": time.process_time() - began, **about}
    trials, rows = task.forecast_origins
    facts |= _one_step(task, forecaster)
    began = time.process_time()
    expected = forecaster.expected(trials, rows, max(task.steps))
    facts["predict_s"] = time.process_time() - began
    assert expected is not None, "only the law of a simulation declines, and it is asked otherwise"
    ahead = task.scored.ahead(trials, rows, max(task.steps))
    facts["unscored"] = _unscored(task, rows, ahead, expected)
    errors = metrics.horizon_errors(
        task.scaler.transform(ahead),
        task.scaler.transform(expected),
        range(1, max(task.steps) + 1),
        length=1.0,
    ).squared_error
    facts |= {f"roll_{k}": float(errors[k - 1]) for k in task.steps}
    facts |= _free_runs(task, forecaster)
    scores = score_positions(
        task.scored,
        forecaster,
        trials,
        rows,
        task.steps,
        draws=task.samples,
        seed=task.seed,
        levels=(0.9,),
        names=("log_score", "crps", "coverage"),
    )
    assert scores is not None
    for place, k in enumerate(task.steps):
        for score in ("crps", "log_score"):
            facts[f"{score}_{k}"] = _mean(scores[score][:, place])
        facts[f"coverage_{k}"] = _mean(scores["coverage"][:, place, ..., 0])
    facts |= edge_scores(task, fitted)
    facts["memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE
    return Measured(facts, scores["crps"], scores["log_score"], errors)


def _fitted(
    task: Task, name: str, seconds: float | None, seed: int
) -> tuple[Forecaster, dict[str, Any], Any]:
    """Return a fitted method as a forecaster, what to say of it, and itself."""
    if name in MODELS:
        method = MODELS[name]
        fit = method.fit(task, seconds, seed)
        subject = subject_of(fit, task.context, "all")
        forecaster = FitForecaster(subject)
        about = {
            "title": method.title,
            "knows_true_form": method.knows_true_form(task),
            "parameters": fit.num_parameters,
        }
        return forecaster, about, fit
    baseline: Baseline = (
        true_rule(task) if name == FLOOR else baseline_named(name).for_tracks(task.tracks)
    )
    terms = Training(
        task.validation, None if task.graph == "complete" else task.rule(), seconds, seed
    )
    baseline.fit_states(task.training, task.fps, terms)
    about = {
        "title": baseline.title,
        "knows_true_form": baseline.knows_true_form,
        "parameters": baseline.num_parameters,
    }
    return BaselineForecaster(baseline, task.scored), about, baseline


def _one_step(task: Task, forecaster: Forecaster) -> dict[str, float]:
    """Return MSE (4.2) and MAE (4.3) of one step at every scored frame."""
    predicted, _ = forecaster.one_step()
    scored = task.mask.copy()
    # Where the frame before is unknown there is nothing to go on from, for anybody.
    scored[:, 1:] &= known(task.states)[:, :-1]
    truth = np.where(scored[..., None], task.states, np.nan)
    truth = task.scaler.transform(truth)
    length = metrics.step_length(task.scaler.transform(task.states))
    guess = task.scaler.transform(np.where(scored[..., None], predicted, np.nan))
    return {
        "mse": metrics.mse(truth, guess, length),
        "mae": metrics.mae(truth, guess, length),
    }


def _free_runs(task: Task, forecaster: Forecaster) -> dict[str, float]:
    """Return how far AMD (4.4) and AVD (4.5) of free runs are from the truth's."""
    found: dict[str, float] = {}
    for suffix, runner, draws in (
        ("", _Expected(forecaster), 1),
        ("_drawn", forecaster, task.draws),
    ):
        series, _ = collective_scores(
            task.scored,
            [runner],
            steps=task.free_steps,
            starts=task.starts,
            draws=draws,
            seed=task.seed,
        )
        truth, own = series.isel(series=0), series.isel(series=1)
        for measure in ("amd", "avd"):
            found[f"{measure}_true"] = float(truth[f"{measure}_mean"])
            found[f"{measure}{suffix}"] = float(own[f"{measure}_mean"])
            found[f"{measure}_error{suffix}"] = float(own[f"{measure}_error"])
    return found


class _Expected:
    """A forecaster whose free runs are without noise."""

    def __init__(self, forecaster: Forecaster) -> None:
        self.name, self.title = forecaster.name, forecaster.title
        self.one_step, self.expected = forecaster.one_step, forecaster.expected
        self.density = forecaster.density

    def simulate(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array | None:
        """Return the expected future as the only draw."""
        path = self.expected(trials, rows, steps)
        return None if path is None else path[None]


def _unscored(task: Task, rows: Rows, ahead: Array, expected: Array) -> float:
    """Return the share of individuals known at an origin and seen later that are not forecast."""
    trials, _ = task.forecast_origins
    there = known(task.states)[trials, rows]
    wanted = known(ahead) & there[:, None]
    lost = wanted & np.isnan(expected).any(-1)
    return float(lost.sum() / max(1, wanted.sum()))


def _mean(values: Array) -> float:
    """Return the mean of what is known."""
    scored = ~np.isnan(values)
    return float(values[scored].mean()) if scored.any() else float("nan")
