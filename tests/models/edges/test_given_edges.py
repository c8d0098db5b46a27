"""Where the graph of a step comes from."""

import math

import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, GraphRule, dense
from swarmssm.models import LatentEdges, ObservedEdges, StepInputs

DOUBLE = torch.float64


def drawn(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, dtype=DOUBLE, generator=generator)


def test_observed_edges_are_those_given():
    graph = torch.ones(2, 3, 3)
    inputs = StepInputs(graph)
    assert ObservedEdges()(drawn(2, 3, 4), inputs) is graph
    assert ObservedEdges()(drawn(2, 3, 4), StepInputs()) is None


@pytest.mark.parametrize("given", ["radius:1.5", GraphRule("radius", radius=1.5)])
def test_latent_edges_by_hand(given):
    # 0 and 1 are 1 apart, 2 is 2 away from 1.
    positions = torch.tensor([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]], dtype=DOUBLE)
    states = torch.cat([positions, torch.full_like(positions, 9.0)], -1)
    expected = torch.tensor([[0.0, 1, 0], [1, 0, 0], [0, 0, 0]], dtype=DOUBLE)
    edges = LatentEdges(given)
    inputs = StepInputs(torch.ones(3, 3), torch.tensor([7.0]))
    assert torch.equal(edges(states, inputs), expected)
    completed = edges.complete(states, inputs)
    assert torch.equal(completed.adjacency, expected)
    assert completed.controls is inputs.controls


@pytest.mark.parametrize(
    ("individuals", "rule", "is_list"),
    [
        (20, "radius:0.3", False),
        (20, "visual:0.1", False),
        (60, "radius:0.3", True),
        (60, "visual:0.1", False),
        (60, "complete", False),
        (60, "k-nearest:3", True),
        (300, "radius:0.1", True),
        (300, "k-nearest:3", True),
    ],
)
def test_the_graph_is_that_of_the_present_latent_states(individuals, rule, is_list):
    states = drawn(2, 3, individuals, 4).requires_grad_()
    present = torch.rand(2, 3, individuals, generator=torch.Generator().manual_seed(1)) < 0.8
    there = states.detach()[..., :2].masked_fill(~present.unsqueeze(-1), math.nan)
    expected = GraphRule.parse(rule)(there, states.detach()[..., 2:])
    graph = LatentEdges(rule)(states, StepInputs(present=present))
    assert torch.equal(dense(graph, DOUBLE), expected.to(DOUBLE))
    assert expected.any()
    assert not dense(graph).requires_grad
    assert isinstance(graph, EdgeList) == is_list
    if isinstance(graph, torch.Tensor):
        assert graph.dtype == DOUBLE


def test_the_state_may_be_of_three_dimensions():
    states = drawn(5, 8, 6)
    expected = GraphRule("k-nearest", k=2)(states[..., :3])
    assert torch.equal(LatentEdges("k-nearest:2")(states, StepInputs()), expected.to(DOUBLE))


@pytest.mark.parametrize(
    ("rule", "message"),
    [("visual", "body_length"), ("radios:1", "radios"), ("radius:-1", "radius")],
)
def test_rules_that_give_no_graph_are_refused(rule, message):
    with pytest.raises(InputError, match=message):
        LatentEdges(rule)
