"""Each individual's own covariance: what it leaves out, and on graphs of either kind."""

from dataclasses import replace

import pyro.distributions as dist
import pytest
import torch

from swarmssm.graphs import EdgeList
from swarmssm.inference.filtering import (
    collapsed_evidence,
    evidence,
    layouts,
    linearization_points,
)
from swarmssm.inference.filtering.blocks import color_graph, linearize_own
from swarmssm.models import InitialStates, PositionEmission, StateSpaceModel, SwarmBatch
from swarmssm.models.transitions.boids import BoidsTransition
from swarmssm.simulate import simulate_boids

DOUBLE = torch.float64


def swarm(individuals, times=6, trials=1, seed=0):
    """Return boids in a box, seen with noise, on the graph of their true positions."""
    tracks = simulate_boids(
        individuals,
        times,
        trials,
        radius=2.0,
        cohesion_gain=0.6,
        separation_gain=0.15,
        alignment_gain=0.8,
        wall_gain=0.0,
        min_speed=0.0,
        max_speed=float("inf"),
        noise="additive",
        process_noise=0.15,
        observation_noise=0.03,
        seed=seed,
    )
    position = torch.tensor(
        tracks["position"].transpose("trial", "time", "individual", "space").to_numpy()
    )
    graph = torch.tensor(tracks["adjacency"].to_numpy()).to(DOUBLE)
    mask = torch.ones(position.shape[:3], dtype=torch.bool)
    return SwarmBatch.of(position, mask, graph)


def boids(**gains):
    given = {"cohesion_gain": 0.6, "separation_gain": 0.15, "alignment_gain": 0.8} | gains
    transition = BoidsTransition(2, 0.1, process_noise=0.15, **given)
    initial = InitialStates(torch.zeros(4), torch.tensor([5.0, 5.0, 1.0, 1.0]))
    return StateSpaceModel(initial, transition, PositionEmission(2, 0.03)).double()


def as_list(batch):
    return replace(batch, adjacency=EdgeList.from_dense(batch.adjacency))


def test_neighbours_have_different_colours():
    graph = swarm(40, 3).adjacency
    values = torch.zeros(1, 3, 40, 1)
    colors = color_graph(graph, values)
    assert torch.equal(colors, color_graph(EdgeList.from_dense(graph), values))
    either = (graph > 0) | (graph.mT > 0)
    same = colors.unsqueeze(-1) == colors.unsqueeze(-2)
    assert not (either & same).any()
    # A greedy colouring needs at most one more than the greatest number of neighbours.
    assert colors.max() <= either.sum(-1).max()
    assert color_graph(None, values)[0, 0].tolist() == list(range(40))


def test_coloured_derivatives_are_the_diagonal_of_the_jacobian():
    batch, model = swarm(40, 3), boids()
    states = torch.cat([batch.observations, torch.cos(batch.observations)], -1)[:, :-1]
    full = model.transition.linearize(states, batch.steps())
    expected = full.jacobian.diagonal(dim1=-4, dim2=-2).movedim(-1, -3)
    for given in (batch, as_list(batch)):
        found = linearize_own(model.transition, states, given.steps())
        torch.testing.assert_close(found.jacobian, expected, rtol=1e-10, atol=1e-12)
        torch.testing.assert_close(found.mean, full.mean, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("method", ["extended", "iterated"])
def test_it_is_exact_where_nobody_minds_anybody(method):
    batch = swarm(5, 10)
    model = boids(cohesion_gain=0.0, separation_gain=0.0, alignment_gain=0.0)
    joint = collapsed_evidence(model, batch, method=method, layout="joint")
    blocks = collapsed_evidence(model, batch, method=method, layout="blocks")
    torch.testing.assert_close(blocks, joint, rtol=1e-9, atol=0)


@pytest.mark.parametrize(("method", "each"), [("extended", 1e-2), ("iterated", 1e-3)])
def test_its_error_at_ten_individuals_is_small(method, each):
    """Against the joint covariance, in nats for each observed number: it was .006 and .0004."""
    batch, model = swarm(10, 40, 2), boids()
    joint = collapsed_evidence(model, batch, method=method, layout="joint")
    blocks = collapsed_evidence(model, batch, method=method, layout="blocks")
    assert not torch.equal(blocks, joint)
    assert ((blocks - joint).abs() < each * 10 * 40 * 2).all()


def test_large_swarms_take_it_by_themselves_on_graphs_of_either_kind(monkeypatch):
    for module in (layouts, evidence):
        monkeypatch.setattr(module, "JOINT_LIMIT", 5)
    batch, model = swarm(6, 3), boids()
    for method in ("extended", "iterated"):
        found = collapsed_evidence(model, batch, method=method)
        given = collapsed_evidence(model, batch, method=method, layout="blocks")
        assert torch.equal(found, given)
        sparse = collapsed_evidence(model, as_list(batch), method=method)
        torch.testing.assert_close(sparse, found, rtol=1e-10, atol=0)


@pytest.mark.parametrize("method", ["extended", "iterated"])
def test_its_derivative_is_that_of_differences(method):
    batch, model = as_list(swarm(8, 4)), boids(alignment_gain=dist.LogNormal(0.0, 1.0))
    name = "transition.alignment_gain"

    def value(gain):
        return {name: torch.tensor(gain, dtype=DOUBLE, requires_grad=True)}

    points = linearization_points(model, batch, value(0.8))
    how = {"method": method, "layout": "blocks"}
    if method == "iterated":
        how["points"] = points
    middle = value(0.8)
    found = collapsed_evidence(model, batch, middle, **how).sum()
    (slope,) = torch.autograd.grad(found, middle[name])
    ends = [
        collapsed_evidence(model, batch, value(0.8 + step), **how).sum().item()
        for step in (1e-5, -1e-5)
    ]
    assert slope.item() == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-5)
