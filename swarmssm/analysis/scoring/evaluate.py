"""Score a fit beside what anybody would try first, on the same frames."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.scoring.densities import mean_scores, position_scores
from swarmssm.analysis.scoring.evaluation import Evaluation
from swarmssm.analysis.scoring.examples import graph_snapshots, imitation, random_starts
from swarmssm.analysis.scoring.forecasters import (
    BaselineForecaster,
    Forecaster,
    ModelForecaster,
    law_forecaster,
)
from swarmssm.analysis.scoring.frames import rolling_origins
from swarmssm.analysis.scoring.free_runs import collective_scores
from swarmssm.analysis.scoring.references import REFERENCES
from swarmssm.analysis.scoring.subject import Subject, subject_of
from swarmssm.analysis.scoring.thesis import thesis_table_for
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["evaluate"]

HORIZONS = (1, 5, 10, 20, 50)
#: With fewer sampled futures their covariance and the ends of their intervals say little.
LEAST_FUTURES = 10
#: Levels of the intervals of a forecast.
LEVELS = (0.5, 0.8, 0.9)
#: What a baseline's next graph is.
EDGE_TITLES = {
    "stay-put": "same graph as before",
    "constant-velocity": "graph rule on constant velocity",
    "noise-floor": "graph rule on the true next state",
}


def evaluate(
    fit: Fit,
    tracks: xr.Dataset,
    *,
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

    - *One step*: each frame from the frames before it, at the posterior mean.
    - *K steps*: the expected future of up to ``origins`` frames of each trial, without noise. At
      each step those count whose truth is known, so that later steps rest on fewer origins.
    - *Log score, CRPS and coverage*: how good the density is that each has of the positions to
      come, K steps ahead: that of sampled futures with tracking noise, or, for the baselines, a
      normal about what they expect with the spread of their errors in the training part. See
      :func:`swarmssm.analysis.scoring.backtest`, which compares several fits so.
    - *Free runs*: with everything drawn, ``draws`` times from each start. The cohesion AMD (4.4)
      and the alignment AVD (4.5) of the same individuals are compared with the truth's as long as
      that lasts. The baselines run without noise.
    - *Edges*: of the next frame's graph, beside "the same as before" and "always the commoner".

    Parameters
    ----------
    fit
        A fit.
    tracks
        The tracks it was fitted on, or others.
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
    _check(horizons, free_run_steps, origins, starts, draws, futures, seed)
    subject = subject_of(fit, tracks, part)
    forecasters: list[Forecaster] = [ModelForecaster(subject, edges)]
    forecasters += [BaselineForecaster(subject, kind()) for kind in REFERENCES.values()]
    law, reason = law_forecaster(subject)
    notes = [*subject.notes]
    horizons = [int(k) for k in horizons]
    if law is not None:
        forecasters.append(law)
    elif reason:
        notes.append(reason)

    one_step = {f.name: f.one_step() for f in forecasters}
    scores, used, more = _forecast_scores(
        subject, forecasters, one_step, horizons, origins, futures, seed
    )
    notes += more
    collective, more = collective_scores(
        subject, forecasters, steps=free_run_steps, starts=starts, draws=draws, seed=seed
    )
    notes += more
    settings = {
        "model": forecasters[0].name,
        "part": subject.part,
        "horizons": used,
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
    model_edges = one_step[forecasters[0].name][1]
    return Evaluation(
        scores,
        collective,
        _edge_scores(subject, forecasters, one_step),
        imitation(subject, forecasters[0], one_step[forecasters[0].name][0], seed),
        graph_snapshots(subject, model_edges),
        random_starts(subject, edges, steps=free_run_steps, seed=seed),
        fit.history.set_index("epoch").to_xarray() if len(fit.history) else xr.Dataset(),
        settings,
        tuple(notes),
    )


def _forecast_scores(
    subject: Subject,
    forecasters: Sequence[Forecaster],
    one_step: dict[str, tuple[Array, Array | None]],
    horizons: Sequence[int],
    origins: int,
    futures: int,
    seed: int,
) -> tuple[xr.Dataset, list[int], list[str]]:
    """Return the errors of one step and of K steps, the horizons used, and notes."""
    scaler, length = subject.scaler, subject.length
    truth = scaler.transform(subject.states)
    single = _common([truth, *(scaler.transform(one_step[f.name][0]) for f in forecasters)])
    truth, predicted = single[0], single[1:]

    trials, rows = rolling_origins(subject.mask, origins)
    room = _rooms(subject.mask)[trials] - rows
    used = [k for k in horizons if k <= room.max()]
    notes = []
    if left_out := [k for k in horizons if k not in used]:
        notes.append(
            f"The scored part has room for at most {int(room.max())} steps ahead: "
            f"{', '.join(map(str, left_out))} steps are not scored."
        )
    steps = max(used, default=min(max(horizons), int(room.max())))
    expected = [f.forecasts(trials, rows, steps) for f in forecasters]
    notes += [
        f"Steps ahead by the {f.title} are left out: it does not know all states they start from."
        for f, future in zip(forecasters, expected, strict=True)
        if future is None
    ]
    ahead = _common(
        [
            scaler.transform(states)
            for states in (subject.ahead(trials, rows, steps), *expected)
            if states is not None
        ]
    )
    scored = iter(ahead[1:])
    errors = [
        metrics.horizon_errors(
            ahead[0],
            np.full_like(ahead[0], np.nan) if future is None else next(scored),
            range(1, steps + 1),
            length=length,
        )
        for future in expected
    ]
    probable, more = _density_scores(subject, forecasters, trials, rows, steps, futures, seed)
    notes += more
    over_steps = ("method", "step")
    data = {
        "mse": ("method", [metrics.mse(truth, p, length) for p in predicted]),
        "mae": ("method", [metrics.mae(truth, p, length) for p in predicted]),
        "squared_error": (over_steps, [e.squared_error for e in errors]),
        "forecast_mse": (over_steps, [e.mse for e in errors]),
        "forecast_mae": (over_steps, [e.mae for e in errors]),
        "log_score": (over_steps, probable["log_score"]),
        "crps": (over_steps, probable["crps"]),
        "coverage": ((*over_steps, "level"), probable["coverage"]),
        "num_scored": ("step", errors[0].num_scored),
    }
    coords = {
        "method": [f.name for f in forecasters],
        "title": ("method", [f.title for f in forecasters]),
        "step": np.arange(1, steps + 1),
        "level": list(LEVELS),
    }
    return xr.Dataset(data, coords), used, notes


def _density_scores(
    subject: Subject,
    forecasters: Sequence[Forecaster],
    trials: npt.NDArray[np.int64],
    rows: npt.NDArray[np.int64],
    steps: int,
    futures: int,
    seed: int,
) -> tuple[dict[str, Array], list[str]]:
    """Return proper scores of forecast positions at each step, a row a forecaster, and notes."""
    found = {}
    for forecaster in forecasters:
        scores = position_scores(
            subject,
            forecaster,
            trials,
            rows,
            range(1, steps + 1),
            draws=futures,
            seed=seed,
            levels=LEVELS,
            scores=("log_score", "crps", "coverage"),
            training=subject.training,
        )
        if scores is not None:
            found[forecaster.name] = scores
    means = mean_scores(found, axes=(0, 2))
    places = [list(found).index(f.name) if f.name in found else -1 for f in forecasters]
    rows_of = {}
    for name in ("log_score", "crps", "coverage"):
        unknown = np.full((1, *means[name].shape[1:]), np.nan)
        rows_of[name] = np.concatenate([means[name], unknown])[places]
    notes = []
    if subject.training is None:
        notes.append(
            "The spread of the baselines' forecasts is that of their errors on the scored frames "
            "themselves: their log scores flatter them."
        )
    return rows_of, notes


def _common(states: Sequence[Array]) -> list[Array]:
    """Return states with NaN wherever one of them is unknown."""
    known = np.logical_and.reduce([~np.isnan(s).any(axis=-1) for s in states])
    return [np.where(known[..., None], s, np.nan) for s in states]


def _rooms(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Return each trial's last row with anybody in it, -1 if there is none."""
    rows = np.arange(mask.shape[1])
    last: npt.NDArray[np.int64] = np.where(np.logical_or.reduce(mask, axis=-1), rows, -1).max(
        axis=-1
    )
    return last


def _edge_scores(
    subject: Subject,
    forecasters: Sequence[Forecaster],
    one_step: dict[str, tuple[Array, Array | None]],
) -> xr.Dataset:
    """Return scores of the next graph by each that says something of it, and by a constant."""
    pairs = subject.mask[..., :, None] & subject.mask[..., None, :]
    pairs &= ~np.eye(pairs.shape[-1], dtype=bool)
    truth = np.where(pairs, subject.adjacency.astype(np.float64), np.nan)
    predicted: dict[str, tuple[str, Array]] = {}
    for forecaster in forecasters:
        edges = one_step[forecaster.name][1]
        if edges is not None:
            title = EDGE_TITLES.get(forecaster.name, forecaster.title)
            predicted[forecaster.name] = (title, edges)
    commoner = bool(np.nanmean(truth) > 0.5) if pairs.any() else False
    predicted["commoner"] = (
        "all edges" if commoner else "no edge at all",
        np.full_like(truth, float(commoner)),
    )
    for _, edges in predicted.values():
        truth = np.where(np.isnan(edges), np.nan, truth)
    rows: dict[str, list[Array]] = {n: [] for n in ("accuracy", "precision", "recall", "auc")}
    for _, edges in predicted.values():
        rows["accuracy"].append(metrics.edge_accuracy(truth, edges))
        rows["precision"].append(metrics.edge_precision(truth, edges))
        rows["recall"].append(metrics.edge_recall(truth, edges))
        rows["auc"].append(metrics.edge_auc(truth, edges))
    dims = ("predictor", "trial", "time")
    scored = ~np.isnan(truth)
    count = scored.sum(axis=(-2, -1))
    density = np.full(count.shape, np.nan)
    np.divide((truth == 1).sum(axis=(-2, -1)), count, out=density, where=count > 0)
    coords: dict[str, Any] = {
        "predictor": list(predicted),
        "title": ("predictor", [title for title, _ in predicted.values()]),
        "trial": subject.tracks["trial"].to_numpy(),
        "time": subject.tracks["time"].to_numpy(),
    }
    data = {name: (dims, np.stack(values)) for name, values in rows.items()}
    return xr.Dataset({**data, "density": (("trial", "time"), density)}, coords)


def _check(
    horizons: Sequence[int],
    free_run_steps: int,
    origins: int,
    starts: int,
    draws: int,
    futures: int,
    seed: int,
) -> None:
    """Refuse arguments that are out of range."""
    whole = all(isinstance(k, int | np.integer) for k in horizons)
    rising = all(b > a for a, b in itertools.pairwise(horizons))
    if not whole or not rising or not horizons or horizons[0] < 1:
        raise InputError(
            f"horizons: give rising whole numbers of steps from 1 upwards, not {list(horizons)}."
        )
    counts = {
        "free_run_steps": free_run_steps,
        "origins": origins,
        "starts": starts,
        "draws": draws,
    }
    for name, value in counts.items():
        if value < 1:
            raise InputError(f"{name}: it must be at least 1, and it is {value}.")
    if futures < LEAST_FUTURES:
        raise InputError(f"futures: it must be at least {LEAST_FUTURES}, and it is {futures}.")
    if seed < 0:
        raise InputError(f"seed: it must not be negative, and it is {seed}.")
