"""The graph that a fitted law of motion sees: as it was observed, or of inferred edges."""

import torch
from torch import Tensor

from swarmssm.graphs import Graph
from swarmssm.inference import Fit
from swarmssm.inference.data import Prepared
from swarmssm.inference.prediction import StateSpacePredictor
from swarmssm.models import InferredEdges, StateSpaceModel, StepInputs
from swarmssm.models.base import SwarmModel

__all__ = ["graph_of_steps", "has_inferred_edges", "step_inputs"]


def has_inferred_edges(model: SwarmModel) -> bool:
    """Return whether a model infers who acts on whom."""
    return isinstance(model, StateSpaceModel) and isinstance(model.edges, InferredEdges)


def graph_of_steps(fit: Fit, prepared: Prepared) -> Tensor:
    """Return the graph of tracks as the law of motion of a fit takes it.

    Parameters
    ----------
    fit
        A fit.
    prepared
        Tracks as its model sees them.

    Returns
    -------
    ``(trial, time, individual, neighbor)``; of a model with inferred edges
    ``(trial, time, individual, neighbor, type)``, the probabilities of the types given all frames,
    0 for pairs of which one is not there.
    """
    predictor = fit.predictor()
    if not has_inferred_edges(fit.model) or not isinstance(predictor, StateSpacePredictor):
        return prepared.adjacency
    return predictor.edge_probabilities(prepared).nan_to_num(0.0)


def step_inputs(model: SwarmModel, graph: Graph, present: Tensor | None) -> StepInputs:
    """Return the inputs of steps with a graph as :func:`graph_of_steps` returns it.

    Probabilities of types act as weights: a law sees each neighbour as strongly as it is likely to
    act.

    Parameters
    ----------
    model
        A model.
    graph
        ``(..., individual, neighbor)``, with a last dimension of types if edges are inferred.
    present
        ``(..., individual)`` of bool; ``None`` if all are there.
    """
    if isinstance(model, StateSpaceModel) and isinstance(model.edges, InferredEdges):
        assert isinstance(graph, torch.Tensor), "types are no list of edges"
        return StepInputs(model.edges.weights(graph), None, present, graph)
    return StepInputs(graph, None, present)
