"""Score a fit and simple baselines on the same frames, in every way that says something."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.posterior.subject import Subject
from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.analysis.scoring.examples import graph_snapshots, imitation, random_starts
from swarmssm.analysis.scoring.forecasters import Forecaster, law_forecaster
from swarmssm.analysis.scoring.free_runs import collective_scores
from swarmssm.analysis.scoring.next_graph import next_graph_scores
from swarmssm.analysis.scoring.rolling_origin import HORIZONS, LEVELS, rolling_forecasts
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.analysis.scoring.thesis import thesis_table_for
from swarmssm.analysis.scoring.verdicts import summary, verdict
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["Evaluation", "evaluate"]


@dataclass(frozen=True)
class Evaluation:
    """Scores of a fit and of simple baselines on the same frames, and what figures are drawn from.

    ``method`` runs over the model, ``"stay-put"``, ``"constant-velocity"`` and, for simulated
    tracks, ``"noise-floor"``; its coordinate ``title`` has the words for it.

    Attributes
    ----------
    forecasts
        Scores of forecast positions, from :func:`swarmssm.analysis.scoring.score`, of the fit, what
        was scored beside it, and the references.
    scores
        Dataset over ``method`` and ``step`` (1 to the longest forecast): ``mse``, ``mae`` of one
        step, (4.2) and (4.3); ``forecast_mse``, ``forecast_mae`` and ``squared_error`` (plain mean
        over components) *at* each step, with ``num_scored (step)``.
    collective
        Dataset over ``series`` (``"truth"`` and the methods) and ``time`` from the start of a free
        run, in seconds: ``amd``, ``avd`` averaged over starts and draws, with ``low`` and ``high``
        tenth and ninetieth percentile of them; their means over the scored time ``amd_mean``,
        ``avd_mean`` and mean distances from the truth's ``amd_error``, ``avd_error``.
    edges
        Dataset over ``predictor``, ``trial`` and ``time``: ``accuracy``, ``precision``,
        ``recall``, ``auc`` of the next graph; and ``density (trial, time)``, the share of pairs
        with an edge.
    imitation
        Dataset over ``time``, ``individual``, ``space`` of one trial: ``true``, ``one_step`` (each
        frame predicted from the frame before) and ``free_run`` positions, and velocities as
        ``true_velocity`` and so on; the free run starts from the truth in its first frame.
    graphs
        Dataset over ``snapshot``: ``position``, ``true`` graph and ``probability`` of its edges,
        predicted from the frame before.
    random_starts
        Dataset over ``run`` and ``time``: ``position``, ``velocity`` of free runs from random
        places and headings.
    history
        Dataset over ``epoch``: the course of training.
    settings
        How it was scored: part, horizons, numbers of origins, starts and draws, seed, units.
    notes
        What a reader of the scores has to know.
    """

    forecasts: xr.Dataset
    scores: xr.Dataset
    collective: xr.Dataset
    edges: xr.Dataset
    imitation: xr.Dataset
    graphs: xr.Dataset
    random_starts: xr.Dataset
    history: xr.Dataset
    settings: dict[str, Any]
    notes: tuple[str, ...]

    @property
    def model(self) -> str:
        """Name of the fitted model among the methods."""
        return str(self.settings["model"])

    def verdict(self) -> str:
        """Return one line: skill over the best simple baseline with interval, and coverage."""
        return verdict(self.forecasts, self.model)

    def summary(self) -> pd.DataFrame:
        """Return a row a method: forecasts at the first and last horizon, free runs, edges.

        Columns name score and unit; NaN where a method has none.
        """
        unit = f" ({self.settings['unit']})" if self.settings["unit"] else ""
        horizons = self.settings["horizons"]
        first, last = horizons[0], horizons[-1]
        table = summary(self.forecasts)
        methods = [str(name) for name in self.scores["method"].values]
        names = [*table.index, *(name for name in methods if name not in table.index)]
        table = table.reindex(names)
        columns = {f"skill {last}": table["skill", last]}
        columns |= {f"CRPS {k}{unit}": table["crps", k] for k in dict.fromkeys((first, last))}
        columns |= {
            f"log score {last}": table["log_score", last],
            f"inside 90 %, {last}": table["coverage", last],
        }
        for title, score in (("MSE (4.2)", "mse"), ("AMD error", "amd_error")):
            columns[title] = pd.Series({name: self.score(score, name) for name in names})
        columns["AVD error"] = pd.Series({name: self.score("avd_error", name) for name in names})
        columns["edge accuracy"] = pd.Series(
            {name: self.edge_score("accuracy", name) for name in names}
        )
        return pd.DataFrame(columns, index=pd.Index(names, name="model"))

    def score(self, name: str, method: str, step: int | None = None, level: float = 0.9) -> float:
        """Return one number: a variable of ``scores``, ``collective`` or ``forecasts``.

        NaN if there is none. ``level`` is that of the interval, for ``"coverage"``.
        """
        for dataset, dim in ((self.scores, "method"), (self.collective, "series")):
            if name in dataset and method in dataset[dim]:
                chosen = dataset[name].sel({dim: method})
                if step is not None:
                    if step not in dataset["step"]:
                        return math.nan
                    chosen = chosen.sel(step=step)
                return float(chosen)
        if name in self.forecasts and method in self.forecasts["model"]:
            table = score_table(self.forecasts, name, level).sel(model=method)
            return float(table.sel(horizon=step)) if step in table["horizon"] else math.nan
        return math.nan

    def edge_score(self, name: str, predictor: str) -> float:
        """Return the mean over time of an edge score; NaN if there is none."""
        if predictor not in self.edges["predictor"]:
            return math.nan
        return float(self.edges[name].sel(predictor=predictor).mean())

    def to_dict(self) -> dict[str, Any]:
        """Return scores, settings and notes for JSON; what is not known is ``None``."""
        names = ("mse", "mae", "amd_mean", "amd_error", "avd_mean", "avd_error")
        at_steps = ("squared_error", "forecast_mse", "forecast_mae", "log_score", "crps")
        levels = [float(level) for level in self.forecasts["level"].values]
        methods = [str(name) for name in self.scores["method"].values]
        horizons = self.settings["horizons"]
        by_method = {
            method: {
                "title": str(self.scores["title"].sel({"method": method}).item()),
                **{name: _plain(self.score(name, method)) for name in names},
                "horizons": {
                    str(k): {
                        "num_scored": int(self.scores["num_scored"].sel(step=k)),
                        **{name: _plain(self.score(name, method, k)) for name in at_steps},
                        "coverage": {
                            f"{level:g}": _plain(self.score("coverage", method, k, level))
                            for level in levels
                        },
                    }
                    for k in horizons
                },
            }
            for method in methods
        }
        return {
            "verdict": self.verdict(),
            "settings": self.settings,
            "notes": list(self.notes),
            "truth": {n: _plain(self.score(n, "truth")) for n in ("amd_mean", "avd_mean")},
            "methods": by_method,
            "edges": {
                str(predictor): {
                    name: _plain(self.edge_score(name, str(predictor)))
                    for name in ("accuracy", "precision", "recall", "auc")
                }
                for predictor in self.edges["predictor"].values
            },
        }


def evaluate(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    beside: Mapping[str, Fit | Baseline] | None = None,
    horizons: Sequence[int] = HORIZONS,
    part: str | None = None,
    free_run_steps: int = 200,
    origins: int = 40,
    starts: int = 5,
    draws: int = 10,
    futures: int = 100,
    seed: int = 0,
    edges: str = "decoder",
) -> Evaluation:
    r"""Score a fit, stay-put, constant velocity and, if it is known, the true rule.

    All are given the same states, each frame knowing of none later, and are scored on what all of
    them forecast: the same origins, the same individuals. States are scaled with the fit's scaler
    if that is (3.49), else with (3.49) on the training part, so that fits of the same tracks
    compare; L of (4.1) is that of the scored part.

    - *Forecasts*: the density of positions K steps ahead, see
      :func:`swarmssm.analysis.scoring.score`.
    - *One step*: each frame from the frames before it, at the posterior mean.
    - *K steps*: the expected future of the same frames, without noise. At each step those count
      whose truth is known, so that later steps rest on fewer origins.
    - *Free runs*: with everything drawn, ``draws`` times from each start. The cohesion AMD (4.4)
      and the alignment AVD (4.5) of the same individuals are compared with the truth's as long as
      that lasts. The baselines run without noise.
    - *Edges*: of the next frame's graph, and of "the same as before" and "always the commoner".

    Parameters
    ----------
    fit
        A fit.
    tracks
        The tracks it was fitted on, or others.
    beside
        Other fits or fitted baselines by name, whose forecasts are scored too.
    horizons
        Steps ahead to report; those that the scored part is too short for are left out, and
        a note says so.
    part
        ``"test"``, ``"validation"``, ``"train"`` or ``"all"``. Absent: the test part of the fit's
        own tracks, and all of any others.
    free_run_steps
        Length of the free runs.
    origins, starts
        Number of forecasts and of free runs in each trial, spread evenly over it.
    draws
        Number of free runs from each start.
    futures
        Number of sampled futures of each origin that the density of a forecast is taken from, at
        least 10.
    seed
        Of all draws.
    edges
        Where the model's later graphs come from, see
        :meth:`swarmssm.inference.Fit.predictor`.

    Raises
    ------
    InputError
        If an argument is out of range, the tracks do not fit the model, or there is nothing to
        score.

    References
    ----------
    The noise floor is the score of the law that simulated the tracks, run without noise: what is
    left is noise, and no model can do better than by chance.
    """
    _check(free_run_steps, starts, draws)
    model = fit.settings.model
    rolling = rolling_forecasts(
        {model: fit, **(beside or {})}, tracks, horizons, origins, part, LEVELS, edges=edges
    )
    forecasts = rolling.scored(futures, seed, LEVELS)
    subject = rolling.subject
    # The thesis's scores are of the fit and the references alone.
    forecasters = [one for name, one in rolling.forecasters.items() if name not in (beside or {})]
    law, reason = law_forecaster(subject)
    notes = [*rolling.notes, *subject.notes, *([reason] if reason else [])]
    if law is not None and law.name not in rolling.forecasters:
        forecasters.append(law)
    one_step = {f.name: f.one_step() for f in forecasters}
    scores = _errors(subject, forecasters, one_step, rolling.trials, rolling.rows, rolling.horizons)
    collective, more = collective_scores(
        subject, forecasters, steps=free_run_steps, starts=starts, draws=draws, seed=seed
    )
    settings = {
        "model": model,
        "part": subject.part,
        "horizons": list(rolling.horizons),
        "origins": origins,
        "free_run_steps": free_run_steps,
        "starts": starts,
        "draws": draws,
        "futures": futures,
        "seed": seed,
        "edges": edges,
        "fps": subject.fps,
        "unit": str(subject.tracks.attrs.get("unit", "")),
        "thesis": thesis_table_for(subject.tracks),
        "L": subject.length,
        "scaler": {
            "kind": subject.scaler.kind,
            "offset": list(subject.scaler.offset),
            "scale": list(subject.scaler.scale),
        },
    }
    states, graphs = one_step[model]
    return Evaluation(
        forecasts,
        scores,
        collective,
        next_graph_scores(subject, forecasters, one_step),
        imitation(subject, forecasters[0], states, seed),
        graph_snapshots(subject, graphs),
        random_starts(subject, edges, steps=free_run_steps, seed=seed),
        fit.history.set_index("epoch").to_xarray() if len(fit.history) else xr.Dataset(),
        settings,
        tuple(dict.fromkeys((*notes, *more))),
    )


def _errors(
    subject: Subject,
    forecasters: Sequence[Forecaster],
    one_step: Mapping[str, tuple[Array, Array | None]],
    trials: npt.NDArray[np.int64],
    rows: npt.NDArray[np.int64],
    horizons: Sequence[int],
) -> xr.Dataset:
    """Return errors of scaled states, of one step and of each number of steps ahead."""
    scaler, length, steps = subject.scaler, subject.length, max(horizons)
    single = _common([subject.states, *(one_step[f.name][0] for f in forecasters)])
    truth, *predicted = [scaler.transform(states) for states in single]
    nothing = np.full((len(rows), steps, *subject.states.shape[2:]), np.nan)
    expected = [f.expected(trials, rows, steps) for f in forecasters]
    known = _common(
        [subject.ahead(trials, rows, steps), *(one for one in expected if one is not None)]
    )
    ahead, *scored = [scaler.transform(states) for states in known]
    rest = iter(scored)
    errors = [
        metrics.horizon_errors(
            ahead, nothing if one is None else next(rest), range(1, steps + 1), length=length
        )
        for one in expected
    ]
    over_steps = ("method", "step")
    data = {
        "mse": ("method", [metrics.mse(truth, p, length) for p in predicted]),
        "mae": ("method", [metrics.mae(truth, p, length) for p in predicted]),
        "squared_error": (over_steps, [e.squared_error for e in errors]),
        "forecast_mse": (over_steps, [e.mse for e in errors]),
        "forecast_mae": (over_steps, [e.mae for e in errors]),
        "num_scored": ("step", errors[0].num_scored),
    }
    coords = {
        "method": [f.name for f in forecasters],
        "title": ("method", [f.title for f in forecasters]),
        "step": np.arange(1, steps + 1),
    }
    return xr.Dataset(data, coords)


def _common(states: Sequence[Array]) -> list[Array]:
    """Return states with NaN wherever one of them is unknown."""
    known = np.logical_and.reduce([~np.isnan(s).any(axis=-1) for s in states])
    return [np.where(known[..., None], s, np.nan) for s in states]


def _check(free_run_steps: int, starts: int, draws: int) -> None:
    """Refuse arguments that are out of range."""
    counts = {"free_run_steps": free_run_steps, "starts": starts, "draws": draws}
    for name, value in counts.items():
        if value < 1:
            raise InputError(f"{name}: it must be at least 1, and it is {value}.")


def _plain(value: float) -> float | str | None:
    """Return a number that JSON has: not NaN, and not infinity, which is said in words."""
    if math.isnan(value):
        return None
    return value if math.isfinite(value) else "infinite"
