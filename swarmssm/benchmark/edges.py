"""How well a method tells who moves whom, where that is known."""

from typing import Any

import numpy as np
import numpy.typing as npt
import sklearn.metrics

from swarmssm.benchmark.task import Task
from swarmssm.inference import Fit
from swarmssm.metrics.masked import known
from swarmssm.models import StateSpaceModel
from swarmssm.models.edges import InferredEdges
from swarmssm.tracks import Array, states_of
from swarmssm.tracks.splits import Segment, take

__all__ = ["edge_scores"]

#: Frames of each trial on which edges are scored: neighbouring ones say the same.
FRAMES = 40
PERMUTATIONS = 20
PAIR = ("individual", "neighbor")


def edge_scores(task: Task, method: Any) -> dict[str, float]:
    """Return the AUC of a method's edges against the true graph, and what chance would give.

    What a type of edge means is unknown to a method; which type stands for an interaction, and
    whether it does so by being there or by being absent, is therefore chosen on the validation
    part. Beside it stand the AUC of closeness alone, and the mean AUC of the method's own
    edges with individuals exchanged for others.

    Parameters
    ----------
    task
        Task.
    method
        A fit, or a baseline. Only one with a method ``edge_probabilities`` says something of edges.

    Returns
    -------
    ``edge_auc``, ``edge_auc_distance``, ``edge_auc_permuted``; empty where the true graph or the
    method's is not known.
    """
    if "simulation" not in task.tracks.attrs or "adjacency" not in task.tracks:
        return {}
    if not task.split.validation or not _infers_edges(method):
        return {}
    chosen = _pairs(task, method, task.split.validation)
    scored = _pairs(task, method, task.split.test)
    if chosen is None or scored is None:
        return {}
    aucs = np.array([_auc(chosen.truth, chosen.edges[..., k]) for k in range(chosen.types)])
    best = int(np.nanargmax(np.abs(aucs - 0.5)))
    sign = 1.0 if aucs[best] >= 0.5 else -1.0
    edges = sign * scored.edges[..., best]
    generator = np.random.default_rng(task.seed)
    permuted = []
    for _ in range(PERMUTATIONS):
        order = generator.permutation(edges.shape[-1])
        permuted.append(_auc(scored.truth, edges[..., order, :][..., order]))
    return {
        "edge_auc": _auc(scored.truth, edges),
        "edge_auc_distance": _auc(scored.truth, -scored.distance),
        "edge_auc_permuted": float(np.mean(permuted)),
    }


def _infers_edges(method: Any) -> bool:
    """Return whether a method infers edges."""
    if isinstance(method, Fit):
        model = method.model
        return isinstance(model, StateSpaceModel) and isinstance(model.edges, InferredEdges)
    return hasattr(method, "edge_probabilities")


class _Pairs:
    """Pairs of individuals in some frames."""

    def __init__(self, truth: Array, edges: Array, distance: Array) -> None:
        self.truth, self.edges, self.distance = truth, edges, distance
        self.types = edges.shape[-1]


def _pairs(task: Task, method: Any, segments: tuple[Segment, ...]) -> _Pairs | None:
    """Return the true and the inferred edges of some frames of each segment."""
    tracks = take(task.tracks, segments)
    states = states_of(tracks)
    if isinstance(method, Fit):
        inferred = method.edge_probabilities(tracks)
        edges = inferred.transpose("trial", "time", *PAIR, "edge_type").to_numpy()
    else:
        edges = method.edge_probabilities(states, task.fps)
    edges = np.broadcast_to(edges, (*states.shape[:2], *edges.shape[2:]))
    rows = np.unique(np.linspace(0, states.shape[1] - 1, FRAMES).astype(int))
    truth = tracks["adjacency"].transpose("trial", "time", *PAIR).to_numpy()[:, rows]
    there = known(states)[:, rows]
    pairs = there[..., :, None] & there[..., None, :] & ~np.eye(truth.shape[-1], dtype=bool)
    position = states[:, rows, :, : task.num_space]
    distance = np.linalg.norm(position[..., :, None, :] - position[..., None, :, :], axis=-1)
    truth = np.where(pairs, truth.astype(np.float64), np.nan)
    if not (np.nanmin(truth) == 0.0 and np.nanmax(truth) == 1.0):
        return None
    return _Pairs(truth, edges[:, rows], distance)


def _auc(truth: Array, scores: Array) -> float:
    """Return the area under the ROC curve over all pairs of all frames."""
    use: npt.NDArray[np.bool_] = ~np.isnan(truth) & ~np.isnan(scores)
    return float(sklearn.metrics.roc_auc_score(truth[use], scores[use]))
