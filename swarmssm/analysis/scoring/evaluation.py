"""What an evaluation found, as labelled arrays and as plain numbers."""

import math
from dataclasses import dataclass
from typing import Any

import xarray as xr

__all__ = ["Evaluation"]


@dataclass(frozen=True)
class Evaluation:
    """Scores of a fit and of its rivals on the same frames, and what the figures are drawn from.

    ``method`` runs over the model, ``"stay-put"``, ``"constant-velocity"`` and, for simulated
    tracks, ``"noise-floor"``; its coordinate ``title`` has the words for it.

    Attributes
    ----------
    scores
        Dataset over ``method`` and ``step`` (1 to the longest forecast): ``mse``, ``mae`` of one
        step, (4.2) and (4.3); ``forecast_mse``, ``forecast_mae`` and ``squared_error`` (plain mean
        over components) *at* each step, with ``num_scored (step)``; ``log_score``, nats per
        coordinate of position, ``crps`` in the tracks' unit, and ``coverage``, over ``level``
        too, the share of coordinates inside the central interval of that level, see
        :func:`swarmssm.analysis.scoring.backtest`.
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

    def score(self, name: str, method: str, step: int | None = None, level: float = 0.9) -> float:
        """Return one number: a variable of ``scores`` or ``collective``; NaN if there is none.

        ``level`` is that of the interval, for ``"coverage"``.
        """
        for dataset, dim in ((self.scores, "method"), (self.collective, "series")):
            if name in dataset and method in dataset[dim]:
                chosen = dataset[name].sel({dim: method})
                if step is not None:
                    if step not in dataset["step"]:
                        return math.nan
                    chosen = chosen.sel(step=step)
                if "level" in chosen.dims:
                    chosen = chosen.sel(level=level)
                return float(chosen)
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
        levels = [float(level) for level in self.scores.coords.get("level", ())]
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


def _plain(value: float) -> float | str | None:
    """Return a number that JSON has: not NaN, and not infinity, which is said in words."""
    if math.isnan(value):
        return None
    return value if math.isfinite(value) else "infinite"
