"""Every law, edge module and guide gives the same numbers on a matrix and on a list of edges."""

from dataclasses import replace

import pyro.distributions as dist
import pytest
import torch
from pyro import poutine

from swarmssm.graphs import EdgeList, dense, graph_by_rule, representation
from swarmssm.inference.guides import find_guide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    LatentEdges,
    LinearTransition,
    ObservedEdges,
    PositionEmission,
    Scales,
    StateEmission,
    StateSpaceModel,
    StepInputs,
    SwarmBatch,
)
from swarmssm.models.transitions import BoidsTransition, GraphTransition

# What torch itself says when it first differentiates forwards.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")

DOUBLE = torch.float64
#: float64 keeps sixteen digits; sums over some hundred terms, and what is divided by a noise of a
#: hundredth of the terms, are added in another order.
CLOSE = {"rtol": 1e-10, "atol": 1e-10}
WINDOWS, TIMES, INDIVIDUALS = 2, 6, 7
DT = 0.1
GAINS = {"cohesion_gain": 0.5, "separation_gain": 0.3, "alignment_gain": 0.2, "process_noise": 0.3}
SCALES = Scales(
    space=2,
    individuals=INDIVIDUALS,
    dt=DT,
    centre=(0.3, -0.2),
    low=(-3.0, -3.0),
    high=(3.0, 3.0),
    length=2.0,
    speed=0.9,
    slow=0.5,
    fast=1.3,
    spacing=0.8,
    step=0.04,
    noise=0.0,
)


def rand(*shape, seed=0):
    return torch.randn(shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def linear():
    return LinearTransition(4, 0.9 * torch.eye(4), 0.1 * torch.eye(4), 0.2 * torch.eye(4))


def boids(**options):
    return BoidsTransition(2, DT, **{**GAINS, **options})


def network(**options):
    torch.manual_seed(3)
    law = GraphTransition(SCALES, width=8, **options)
    with torch.no_grad():
        # Its last layers are 0 at first, and would hide what comes before.
        for parameter in law.network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return law


LAWS = {
    "linear": linear,
    "boids": boids,
    "boids by velocity": lambda: boids(form="velocity"),
    "boids with walls": lambda: boids(wall_gain=1.0, half_width=2.0, exponent=2.0),
    "boids of their own": lambda: boids(exponent=torch.linspace(0.5, 2.0, INDIVIDUALS)),
    "boids within a radius": lambda: boids(radius=1.5, radius_width=0.2),
    "boids with hard limits": lambda: boids(min_speed=0.6, max_speed=1.2),
    "network": network,
    "network of two rounds": lambda: network(rounds=2),
    "network with state noise": lambda: network(noise="state", tails="student"),
}


def model_of(name, edges=None):
    law = LAWS[name]()
    emission = StateEmission(2, 0.1, 0.2) if name == "linear" else PositionEmission(2, 0.05)
    initial = InitialStates(torch.zeros(4), torch.tensor([1.0, 1.0, 0.5, 0.5]))
    return StateSpaceModel(initial, law, emission, edges).double()


def batch_of(model):
    """Return a window with gaps, comers and goers, and graphs some of which have no edges."""
    mask = torch.ones(WINDOWS, TIMES, INDIVIDUALS, dtype=torch.bool)
    mask[0, :2, 0] = mask[0, 2:4, 1] = mask[1, 4:, 2] = False
    graph = (rand(WINDOWS, TIMES, INDIVIDUALS, INDIVIDUALS) > 0.3).to(DOUBLE)
    graph[1, 3] = 0.0
    graph[:, :, 4] = 0.0
    graph = graph * (1.0 - torch.eye(INDIVIDUALS, dtype=DOUBLE))
    graph = graph * mask.unsqueeze(-1) * mask.unsqueeze(-2)
    width = 2 if model.observes == "positions" else 4
    seen = rand(WINDOWS, TIMES, INDIVIDUALS, width, seed=1) * mask.unsqueeze(-1)
    return SwarmBatch.of(seen, mask, graph)


def as_list(batch):
    return replace(batch, adjacency=EdgeList.from_dense(batch.adjacency))


def assert_alike(model, pairs):
    """Hold values, and their gradients in all that can be learned, against each other."""
    for one, other in pairs:
        torch.testing.assert_close(one, other, **CLOSE)
    learned = [p for p in model.parameters() if p.requires_grad]
    if not learned or not pairs[0][0].requires_grad:
        return
    weights = [rand(*one.shape, seed=9) for one, _ in pairs]
    gradients = []
    for side in zip(*pairs, strict=True):
        total = sum((x * w).sum() for x, w in zip(side, weights, strict=True))
        gradients.append(torch.autograd.grad(total, learned, allow_unused=True))
    assert any(g is not None and g.any() for g in gradients[0])
    for one, other in zip(*gradients, strict=True):
        assert (one is None) == (other is None)
        if one is not None:
            torch.testing.assert_close(one, other, **CLOSE)


@pytest.mark.parametrize("name", LAWS)
def test_a_law(name):
    model = model_of(name)
    inputs = [batch.steps() for batch in (batch_of(model), as_list(batch_of(model)))]
    draws = rand(3, WINDOWS, TIMES - 1, INDIVIDUALS, 4, seed=2)
    for states in (draws[0], draws):
        following = [model.transition(states, one) for one in inputs]
        pairs = [tuple(f.mean for f in following), tuple(f.variance for f in following)]
        assert pairs[0][0].shape == states.shape
        assert_alike(model, pairs)
    with torch.no_grad():
        dependence = (
            (
                following[0].mean
                - model.transition(draws, StepInputs(torch.zeros_like(inputs[0].adjacency))).mean
            )
            .abs()
            .max()
        )
    assert dependence > 1e-4


@pytest.mark.parametrize("name", LAWS)
def test_its_linearisation(name):
    model = model_of(name)
    states = rand(WINDOWS, TIMES - 1, INDIVIDUALS, 4, seed=2)
    covariance = 0.01 * torch.eye(4, dtype=DOUBLE).expand(*states.shape, 4)
    found = [
        model.transition.linearize(states, batch.steps(), covariance)
        for batch in (batch_of(model), as_list(batch_of(model)))
    ]
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, **CLOSE)


@pytest.mark.parametrize("name", LAWS)
def test_a_path_is_drawn_and_scored(name):
    model = model_of(name)
    drawn, scored = [], []
    for batch in (batch_of(model), as_list(batch_of(model))):
        chain = model.chain(batch, {})
        torch.manual_seed(0)
        with torch.no_grad():
            drawn.append(chain.sample())
        scored.append(chain.log_prob(drawn[0]))
    torch.testing.assert_close(*drawn, **CLOSE)
    assert scored[0].isfinite().all()
    assert_alike(model, [tuple(scored)])


@pytest.mark.parametrize("rule", ["radius:1.2", "k-nearest:2", "complete"])
@pytest.mark.parametrize("name", ["boids", "network"])
def test_edges_of_latent_states(rule, name, monkeypatch):
    """The same rule, made to choose the one and the other."""
    found, kinds = [], []
    for up_to, from_density in ((INDIVIDUALS, 0.0), (0, 1.0)):
        monkeypatch.setattr(representation, "MATRIX_UP_TO", up_to)
        monkeypatch.setattr(representation, "MATRIX_FROM_DENSITY", from_density)
        model = model_of(name, LatentEdges(rule))
        batch = batch_of(model)
        states = rand(WINDOWS, TIMES, INDIVIDUALS, 4, seed=2)
        states = states * batch.present.unsqueeze(-1)
        inputs = model.edges.complete(states[:, :-1], batch.steps())
        kinds.append(type(inputs.adjacency))
        torch.manual_seed(0)
        with torch.no_grad():
            drawn = model.chain(batch, {}).sample()
        found.append(
            (dense(inputs.adjacency, DOUBLE), drawn, model.chain(batch, {}).log_prob(drawn))
        )
    assert kinds == [torch.Tensor, torch.Tensor if rule == "complete" else EdgeList]
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, **CLOSE)


GUIDED = [
    (guide, law)
    for guide in ("smoothing", "markov")
    for law in ("linear", "boids", "network", "network of two rounds")
] + [("linearized", law) for law in ("linear", "boids", "network")]


@pytest.mark.parametrize(("guide", "name"), GUIDED)
def test_a_guide(guide, name):
    with quiet_pyro():
        model = model_of(name)
        torch.manual_seed(1)
        posterior = find_guide(guide)(model).double()
        with torch.no_grad():
            for parameter in posterior.parameters():
                parameter.add_(0.1 * torch.randn_like(parameter))
        found = []
        for batch in (batch_of(model), as_list(batch_of(model))):
            torch.manual_seed(0)
            drawn = poutine.trace(posterior).get_trace(batch)
            states = drawn.nodes["states"]["value"]
            scored = poutine.trace(poutine.replay(model, trace=drawn)).get_trace(batch)
            found.append((states, scored.log_prob_sum() - drawn.log_prob_sum()))
        assert found[0][1].isfinite()
        trained = posterior if any(p.requires_grad for p in posterior.parameters()) else model
        assert_alike(trained, list(zip(*found, strict=True)))


def test_observed_edges_pass_either_on():
    batch = batch_of(model_of("linear"))
    for one in (batch, as_list(batch)):
        assert ObservedEdges()(one.observations, one.steps()) is one.steps().adjacency


def test_a_batch_keeps_its_graph():
    batch = batch_of(model_of("linear"))
    index = torch.tensor([1, 0, 1])
    pairs = [(batch, as_list(batch)), (batch.select(index), as_list(batch).select(index))]
    for one, other in pairs:
        assert torch.equal(other.adjacency.to_dense(DOUBLE), one.adjacency)
        assert torch.equal(other.steps().adjacency.to_dense(DOUBLE), one.steps().adjacency)
        for t in range(TIMES - 1):
            at = other.steps().at(t).adjacency
            assert torch.equal(at.to_dense(DOUBLE), one.steps().at(t).adjacency)
            assert at.leading == (len(other),)


def test_an_edge_list_of_weights_is_a_weighted_adjacency():
    """Soft edges: a boids law takes weighted means, and gradients reach the weights."""
    law = boids()
    states = rand(INDIVIDUALS, 4, seed=2)
    drawn = dist.Uniform(0.1, 1.0).sample((INDIVIDUALS, INDIVIDUALS)).double()
    matrix = drawn * (1.0 - torch.eye(INDIVIDUALS, dtype=DOUBLE))
    gradients = []
    for kind in (lambda graph: graph, EdgeList.from_dense):
        leaf = matrix.clone().requires_grad_()
        law.double()(states, StepInputs(kind(leaf))).mean.square().sum().backward()
        gradients.append(leaf.grad)
    torch.testing.assert_close(gradients[0] * (matrix > 0), gradients[1], **CLOSE)
    assert gradients[1].abs().sum() > 0


def test_large_swarms_take_the_list():
    positions = rand(1, 60, 2)
    graph = graph_by_rule(LatentEdges("k-nearest:3").rule, positions)
    assert isinstance(graph, EdgeList)
