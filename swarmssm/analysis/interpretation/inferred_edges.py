"""What a model with inferred edges says of who acts on whom, beside a graph and the distance."""

import numpy as np
import xarray as xr

from swarmssm.inference import Fit
from swarmssm.metrics.edges import edge_auc
from swarmssm.tracks import with_trials

__all__ = ["inferred_edges"]

PAIR = ("individual", "neighbor")


def inferred_edges(fit: Fit, tracks: xr.Dataset) -> xr.Dataset:
    """Return probable edges, how common and how sure they are, and what they go with.

    Parameters
    ----------
    fit
        With inferred edges.
    tracks
        Those it was fitted on, or others.

    Returns
    -------
    Dataset with

    ``edge_probability (trial, time, individual, neighbor, edge_type)``
        Of :meth:`swarmssm.inference.Fit.edge_probabilities`, single precision.
    ``share (edge_type)``
        Mean probability over pairs and frames.
    ``certainty``
        Mean probability of the most probable type; one over the number of types where nothing
        is known.
    ``nearness_auc``
        Area under the ROC by which the probability of an edge tells the nearer half of the pairs
        of a frame from the others: 0.5 where edges have nothing to do with distance.
    ``graph_auc``, ``distance_auc``
        Only if the tracks carry a graph: the area under the ROC by which the probability of an
        edge, and minus the distance alone, tell its edges; mean over frames.

    Raises
    ------
    InputError
        If the edges of the fit are not inferred, or the tracks do not fit the model.
    """
    tracks = with_trials(tracks)
    told = fit.edge_probabilities(tracks)
    found = told.astype(np.float32).to_dataset(name="edge_probability")
    found["share"] = told.mean([name for name in told.dims if name != "edge_type"])
    found["certainty"] = told.max("edge_type", skipna=False).mean()
    if "none" in told["edge_type"].values:
        edge = 1.0 - told.sel(edge_type="none")
    else:
        edge = told.isel(edge_type=-1)
    score = edge.transpose("trial", "time", *PAIR).to_numpy()
    place = tracks["position"].transpose("trial", "time", "individual", "space").to_numpy()
    apart = np.linalg.norm(place[:, :, :, None] - place[:, :, None], axis=-1)
    known = np.isfinite(score) & np.isfinite(apart) & ~np.eye(score.shape[-1], dtype=bool)
    apart, score = np.where(known, apart, np.nan), np.where(known, score, np.nan)
    frames = known.any((-1, -2))
    middle = np.full(frames.shape, np.nan)
    middle[frames] = np.nanmedian(apart[frames], axis=(-1, -2))
    near = np.where(known, apart <= middle[..., None, None], np.nan)
    found["nearness_auc"] = _mean_auc(near, score)
    if "adjacency" in tracks:
        graph = tracks["adjacency"].transpose("trial", "time", *PAIR).to_numpy() != 0
        graph = np.where(known, graph, np.nan)
        found["graph_auc"] = _mean_auc(graph, score)
        found["distance_auc"] = _mean_auc(graph, -apart)
    labels = {
        "share": "mean probability of the type",
        "certainty": "mean probability of the most probable type",
        "nearness_auc": "area under the ROC of edges against the nearer half of the pairs",
        "graph_auc": "area under the ROC of edges against the graph of the tracks",
        "distance_auc": "area under the ROC of minus the distance against the same graph",
    }
    for name, text in labels.items():
        if name in found:
            found[name].attrs = {"long_name": text, "units": "1"}
    found.attrs = {"edges": fit.settings.edges or "", "edge_types": told.sizes["edge_type"]}
    return found


def _mean_auc(truth: np.ndarray, score: np.ndarray) -> float:
    """Return the mean over frames in which it can be told."""
    each = edge_auc(truth, score)
    return float(np.nanmean(each)) if np.isfinite(each).any() else float("nan")
