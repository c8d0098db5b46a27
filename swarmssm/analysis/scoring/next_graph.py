"""Scores of the next graph, of everybody who predicts it and of a constant."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.posterior.subject import Subject
from swarmssm.analysis.scoring.forecasters import Forecaster
from swarmssm.tracks import Array

__all__ = ["next_graph_scores"]

#: What a baseline's next graph is.
TITLES = {
    "stay-put": "same graph as before",
    "constant-velocity": "graph rule on constant velocity",
    "noise-floor": "graph rule on the true next state",
}


def next_graph_scores(
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
            title = TITLES.get(forecaster.name, forecaster.title)
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
