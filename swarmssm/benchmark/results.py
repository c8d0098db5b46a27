"""The table of a benchmark: a row a method, and what can be said of it in words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.scoring import paired_difference
from swarmssm.analysis.scoring.scores import mean_scores
from swarmssm.analysis.scoring.table import NOTHING, format_number
from swarmssm.benchmark.measure_method import FLOOR, Measured
from swarmssm.benchmark.measurements import CachedResult
from swarmssm.benchmark.models import MODELS
from swarmssm.benchmark.running import Job
from swarmssm.benchmark.task import Task
from swarmssm.tracks import Array

__all__ = ["Results", "collect"]

#: Facts that are no numbers, or the same for each seed.
PLAIN = ("title", "knows_true_form", "parameters")


@dataclass(frozen=True)
class Results:
    """Scores of all methods on one task.

    Attributes
    ----------
    task
        What was scored.
    rows
        Of each method, the best at one step first and the noise floor on top: means over seeds,
        spreads (standard deviations over seeds) under names that end in ``_sd``, ``seeds``, and in
        ``failed`` the reason why there are no numbers.
    scores
        ``crps`` and ``log_score (model, origin, horizon)``, ``number (origin, horizon)``, as of
        :func:`swarmssm.analysis.scoring.score`; means over seeds.
    errors
        ``squared_error (model, step)`` of scaled states.
    """

    task: Task
    rows: dict[str, dict[str, Any]]
    scores: xr.Dataset
    errors: xr.DataArray

    def summary(self) -> pd.DataFrame:
        """Return the rows as a table, indexed by ``method``."""
        return pd.DataFrame.from_dict(self.rows, orient="index").rename_axis("method")

    def best(self, methods: Sequence[str], fact: str) -> str:
        """Return the method with the lowest value of a fact."""
        return min(methods, key=lambda name: _or_infinite(self.rows[name].get(fact)))

    def fair(self) -> list[str]:
        """Return the methods that were measured and are no oracles."""
        return [
            name
            for name, row in self.rows.items()
            if row["seeds"] and name != FLOOR and not row["knows_true_form"]
        ]

    def shown_rows(self) -> list[dict[str, str]]:
        """Return the table as people read it, column title to text."""
        task = self.task
        last = task.steps[-1]
        crps = [k for k in task.steps if k > 1] or list(task.steps)
        columns = {
            "MSE (4.2)": "mse",
            "MAE (4.3)": "mae",
            **{f"{k} steps": f"roll_{k}" for k in task.steps if k > 1},
            "AMD error": "amd_error",
            "AVD error": "avd_error",
            "AMD error, drawn": "amd_error_drawn",
            "AVD error, drawn": "avd_error_drawn",
            **{f"CRPS {k}": f"crps_{k}" for k in crps},
            f"log score {last}": f"log_score_{last}",
            f"inside 90 %, {last}": f"coverage_{last}",
            "edge AUC": "edge_auc",
            "training, CPU s": "train_s",
            "forecast, CPU s": "predict_s",
            "parameters": "parameters",
            "memory, MB": "memory_mb",
        }
        said = {name for row in self.rows.values() for name in row}
        shown = []
        for method, row in self.rows.items():
            oracle = " (oracle)" if row.get("knows_true_form") and method != FLOOR else ""
            cells = {"method": f"{method}{oracle}"}
            cells |= {title: _cell(row, name) for title, name in columns.items() if name in said}
            cells["note"] = row["failed"]
            if row.get("unscored", 0.0) > 0.0:
                share = format_number(100.0 * row["unscored"], 2)
                cells["note"] = f"{share} % not forecast. {cells['note']}".strip()
            shown.append(cells)
        if not any(cells["note"] for cells in shown):
            for cells in shown:
                del cells["note"]
        return shown

    def short_rows(self) -> list[dict[str, str]]:
        """Return those columns that fit on a terminal."""
        last = self.task.steps[-1]
        errors = ["MSE (4.2)", "MAE (4.3)", f"{last} steps", "AMD error", "AVD error"]
        others = [f"CRPS {last}", f"log score {last}", "edge AUC", "training, CPU s", "parameters"]
        kept = ["method", *errors, *others]
        return [{t: row[t] for t in kept if t in row} for row in self.shown_rows()]

    def verdict(self) -> str:
        """Compare the best of this package's models with the best baseline, with intervals.

        Oracles are left aside. The best of each side is the one with the lowest CRPS at that
        horizon; the interval is that of the moving-block bootstrap over origins.
        """
        rows, scores, fair = self.rows, self.scores, self.fair()
        ours = [name for name in fair if name in MODELS]
        others = [name for name in fair if name not in MODELS]
        if not ours or not others:
            return ""
        parts = []
        for k in self.task.steps:
            if k == 1 and len(self.task.steps) > 1:
                continue
            best, other = self.best(ours, f"crps_{k}"), self.best(others, f"crps_{k}")
            found = paired_difference(scores, "crps", best, other).sel(horizon=k)
            apart = 100.0 * found["difference"].to_numpy() / rows[other][f"crps_{k}"]
            low, middle, high = apart.tolist()
            if np.isnan(low):
                said = f"{best} {_apart(middle)} {other} (too few origins for an interval)"
            else:
                word = "leads" if low > 0.0 else "trails" if high < 0.0 else "ties with"
                said = f"{best} {word} {other} ({middle:+.0f} %, from {low:+.0f} to {high:+.0f} %)"
            parts.append(f"at {k} steps {said}")
        return (
            f"CRPS of the best of this package's models and of the best baseline: "
            f"{joined(parts)}; positive is better for this package, with 90 % intervals."
        )


def collect(task: Task, parts: Mapping[Job, CachedResult]) -> Results:
    """Put measurements together.

    Parameters
    ----------
    task
        Task.
    parts
        From :func:`swarmssm.benchmark.running.run_jobs`.
    """
    by_method: dict[str, list[CachedResult]] = {}
    for job, part in parts.items():
        by_method.setdefault(job.method, []).append(part)
    rows, arrays = {}, {}
    for method, several in by_method.items():
        done = [part.measured for part in several if part.measured is not None]
        reasons = sorted({part.reason for part in several if part.measured is None})
        rows[method] = {**_row(done), "failed": " ".join(reasons)}
        if done:
            arrays[method] = done
    ranked = {name: rows[name] for name in _ranked(rows)}
    names = [name for name in ranked if name in arrays]
    return Results(task, ranked, _scores(task, arrays, names), _errors(arrays, names))


def _row(done: Sequence[Measured]) -> dict[str, Any]:
    """Return means and spreads over seeds."""
    row: dict[str, Any] = {"seeds": len(done)}
    if not done:
        return row
    for name in done[0].facts:
        values = [one.facts.get(name) for one in done]
        if name in PLAIN:
            row[name] = values[0]
            continue
        numbers = np.array([np.nan if v is None else v for v in values], dtype=np.float64)
        row[name] = float(numbers.mean())
        with np.errstate(invalid="ignore"):
            row[f"{name}_sd"] = float(numbers.std(ddof=1)) if len(numbers) > 1 else np.nan
    return row


def _ranked(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the floor, then the methods from the best at one step to those that failed."""
    return sorted(rows, key=lambda name: (name != FLOOR, _or_infinite(rows[name].get("mse"))))


def _or_infinite(value: float | None) -> float:
    """Return a number, infinite if there is none."""
    return math.inf if value is None or math.isnan(value) else value


def _scores(task: Task, arrays: Mapping[str, Sequence[Measured]], names: list[str]) -> xr.Dataset:
    """Return proper scores with labels, over the individuals that all methods forecast."""
    trials, rows = task.forecast_origins
    context = task.context
    found = {
        name: {
            score: _over_seeds([getattr(one, score) for one in arrays[name]])
            for score in ("crps", "log_score")
        }
        for name in names
    }
    nothing = np.zeros((0, len(trials), len(task.steps)))
    empty = {"crps": nothing, "log_score": nothing, "number": np.zeros(nothing.shape[1:])}
    data = mean_scores(found) if found else empty
    over = ("model", "origin", "horizon")
    unit = str(task.tracks.attrs.get("unit", "")) or "1"
    return xr.Dataset(
        {
            "crps": (over, data["crps"], {"units": unit, "long_name": "CRPS of a coordinate"}),
            "log_score": (
                over,
                data["log_score"],
                {"units": "nat", "long_name": "log score of a position, per coordinate"},
            ),
            "number": (over[1:], data["number"], {"units": "1", "long_name": "individuals"}),
        },
        {
            "model": names,
            "horizon": list(task.steps),
            "ahead": ("horizon", np.array(task.steps) / task.fps),
            "trial": ("origin", context["trial"].to_numpy()[trials].astype(str)),
            "frame": ("origin", rows),
        },
    )


def _over_seeds(values: Sequence[Array]) -> Array:
    """Return the mean; infinite where one is."""
    with np.errstate(invalid="ignore"):
        mean: Array = np.mean(np.stack(values), axis=0)
    return mean


def _errors(arrays: Mapping[str, Sequence[Measured]], names: list[str]) -> xr.DataArray:
    """Return squared errors over steps."""
    values = [_over_seeds([one.squared_error for one in arrays[name]]) for name in names]
    steps = len(values[0]) if values else 0
    return xr.DataArray(
        np.array(values).reshape(len(names), steps),
        {"model": names, "step": np.arange(1, steps + 1)},
        ("model", "step"),
        name="squared_error",
        attrs={"units": "1", "long_name": "squared error of scaled states"},
    )


def _cell(row: Mapping[str, Any], name: str) -> str:
    """Return a number, with its spread over seeds where there is one."""
    value = row.get(name)
    if value is None:
        return NOTHING
    if name == "parameters":
        return str(value)
    text = format_number(float(value))
    spread = row.get(f"{name}_sd", math.nan)
    return f"{text} ± {format_number(spread, 2)}" if math.isfinite(spread) else text


def _apart(percent: float) -> str:
    """Say in a word which side is ahead."""
    return f"is {abs(percent):.0f} % {'better' if percent > 0 else 'worse'} than"
