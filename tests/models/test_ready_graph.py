"""The ready-made graph model: what its options make, and that it learns."""

import math

import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro import poutine

from swarmssm.errors import InputError
from swarmssm.inference import fit
from swarmssm.models import (
    LatentEdges,
    ObservedEdges,
    Scales,
    StepInputs,
    SwarmBatch,
    scales_of,
)
from swarmssm.models.presets import graph_ssm
from swarmssm.models.transitions import GraphTransition
from swarmssm.simulate import simulate_boids

NUMBER, TIMES = 4, 6


def scales(**changes):
    values = {
        "space": 2,
        "individuals": NUMBER,
        "dt": 0.5,
        "centre": (10.0, 20.0),
        "low": (0.0, 5.0),
        "high": (30.0, 40.0),
        "length": 7.0,
        "speed": 3.0,
        "slow": 0.5,
        "fast": 6.0,
        "spacing": 2.0,
        "step": 0.8,
        "noise": 0.1,
    }
    return Scales(**(values | changes))


def batch(features, seed=0):
    generator = torch.Generator().manual_seed(seed)
    states = torch.randn(3, TIMES, NUMBER, 4, generator=generator) + 1.0
    for t in range(1, TIMES):
        states[:, t, :, :2] = states[:, t - 1, :, :2] + 0.5 * states[:, t, :, 2:]
    mask = torch.ones(3, TIMES, NUMBER, dtype=torch.bool)
    graph = torch.ones(3, TIMES, NUMBER, NUMBER) - torch.eye(NUMBER)
    return SwarmBatch.of(states[..., :features], mask, graph)


def test_exact_states_are_scored_by_hand():
    """Untrained: N(v' | v, 0.8) on each axis of each step, and the wide first states."""
    plain = {"noise": "constant", "tails": "gaussian"}
    model = graph_ssm(scales(noise=0.0), observed="states", width=8, **plain)
    assert model.observes == "states"
    windows = batch(4)
    trace = poutine.trace(model).get_trace(windows)
    assert trace.nodes["states"]["is_observed"]
    states = windows.observations
    change = states[:, 1:, :, 2:] - states[:, :-1, :, 2:]
    expected = dist.Normal(0.0, 0.8).log_prob(change).sum()
    mean, scale = torch.tensor([10.0, 20.0, 0.0, 0.0]), torch.tensor([35.0, 35.0, 3.0, 3.0])
    expected += dist.Normal(mean, scale).log_prob(states[:, 0]).sum()
    torch.testing.assert_close(trace.log_prob_sum(), expected, rtol=1e-5, atol=0)


def test_positions_are_seen_with_the_noise_of_the_tracks():
    model = graph_ssm(scales(), width=8)
    assert model.observes == "positions"
    trace = poutine.trace(model).get_trace(batch(2))
    seen = trace.nodes["observations"]["fn"]
    while not isinstance(seen, dist.Normal):
        seen = seen.base_dist
    torch.testing.assert_close(seen.scale, torch.full_like(seen.scale, 0.1))
    assert any("noise" in name for name, _ in model.emission.named_parameters())


def test_learned_tracking_noise_stays_away_from_zero():
    model = graph_ssm(scales(noise=0.0), width=8)
    # A thousandth, and at first a hundredth, of 3 units per second times half a second.
    assert math.isclose(float(model.emission.noise.detach()), 0.015, rel_tol=1e-5)
    with torch.no_grad():
        for parameter in model.emission.parameters():
            parameter.fill_(-100.0)
    assert math.isclose(float(model.emission.noise.detach()), 0.0015, rel_tol=1e-5)


def test_given_tracking_noise_is_fixed():
    model = graph_ssm(scales(), width=8, observation_noise=0.25)
    assert float(model.emission.noise.detach()) == 0.25
    assert not list(model.emission.parameters())


@pytest.mark.parametrize("changes", [{"noise": 0.0, "step": 0.0}, {"speed": 0.0, "fast": 0.0}])
def test_degenerate_tracks_make_a_model_too(changes):
    model = graph_ssm(scales(slow=0.0, **changes), width=8, tails="student", noise="state")
    loss = -poutine.trace(model).get_trace(batch(2)).log_prob_sum()
    loss.backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in model.parameters())


def test_edges_are_the_observed_ones_or_those_of_a_rule():
    assert isinstance(graph_ssm(scales(), width=8).edges, ObservedEdges)
    model = graph_ssm(scales(), width=8, edges="radius:1.5")
    assert isinstance(model.edges, LatentEdges)
    assert model.edges.rule.radius == 1.5


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"observed": "speeds"}, "observed"),
        ({"observed": "states", "observation_noise": 0.1}, "observation_noise"),
        ({"edges": "nearby"}, "nearby"),
        ({"tails": "fat"}, "tails"),
        ({"symmetries": "square", "controls": 1}, "symmetries"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, named):
    with pytest.raises(InputError, match=named):
        graph_ssm(scales(), **options)


@pytest.mark.parametrize("space", [2, 3])
def test_windows_are_drawn_with_gaps(space):
    low = (0.0,) * space
    own = scales(space=space, centre=low, low=low, high=(9.0,) * space)
    model = graph_ssm(own, width=8, tails="student", rounds=2)
    mask = torch.ones(3, TIMES, NUMBER, dtype=torch.bool)
    mask[0, :3, 1] = False
    mask[1, 2, 2] = False
    graph = torch.ones(3, TIMES, NUMBER, NUMBER) - torch.eye(NUMBER)
    graph[0, :3, 1] = graph[0, :3, :, 1] = 0.0
    windows = SwarmBatch.of(torch.zeros(3, TIMES, NUMBER, space), mask, graph)
    states = model(windows)
    assert states.shape == (3, TIMES, NUMBER, 2 * space)
    assert (states[0, :3, 1] == 0).all()
    assert states.isfinite().all()


def test_it_finds_forces_that_constant_velocity_lacks():
    """Against the true step without noise, which the simulation records, in another trial."""
    pyro.set_rng_seed(0)
    tracks = simulate_boids(individuals=8, steps=600, trials=2, seed=1)
    order = ("trial", "time", "individual", "space")
    position, velocity, truth = (
        torch.from_numpy(tracks[name].transpose(*order).values).float()
        for name in ("position", "velocity", "next_velocity")
    )
    states = torch.cat([position, velocity], dim=-1)
    graph = torch.from_numpy(tracks.adjacency.values).float()
    model = graph_ssm(
        scales_of(tracks.isel(trial=[0])),
        observed="states",
        width=32,
        symmetries="square",
        noise="constant",
        tails="gaussian",
    )
    # Windows of one step each.
    cut = torch.stack([states[0, :-1], states[0, 1:]], dim=1)
    graphs = torch.stack([graph[0, :-1], graph[0, 1:]], dim=1)
    windows = SwarmBatch.of(cut, torch.ones(cut.shape[:-1], dtype=torch.bool), graphs)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.02)
    steps = 150
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        image = model.augmented(windows.select(torch.randint(len(windows), (100,))))
        loss = -model.step(image.observations[:, 0], StepInputs(image.adjacency[:, 0])).log_prob(
            image.observations[:, 1]
        )
        optimizer.zero_grad()
        loss.mean().backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        own = model.step(states[1], StepInputs(graph[1])).mean[..., 2:]
    known = truth[1].isfinite()
    error = (own - truth[1])[known].square().mean()
    still = (velocity[1] - truth[1])[known].square().mean()
    # Constant velocity misses all of the forces; noise of 0.02 |v| hides 1 to 2 % of them.
    assert error < 0.15 * still


def test_training_sees_images(monkeypatch):
    seen = []

    def augmented(self, windows):
        seen.append(len(windows))
        return windows

    monkeypatch.setattr(GraphTransition, "augmented", augmented)
    tracks = simulate_boids(individuals=3, steps=60, seed=1)
    options = {"observed": "states", "width": 4, "symmetries": "circle"}
    fit("graph-ssm", tracks, guide="parameters", steps=3, window=5, model_options=options)
    assert len(seen) == 3
