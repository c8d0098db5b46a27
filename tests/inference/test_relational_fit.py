"""Edges that are inferred: with every law and guide; planted graphs, forecasts, run folders."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
import xarray as xr
from pyro.infer import Trace_ELBO

from swarmssm.errors import InputError
from swarmssm.inference import Fit, fit
from swarmssm.inference.agreement import check_agreement
from swarmssm.inference.bounds import Bound
from swarmssm.inference.collapsed_model import collapsed, windows_plate
from swarmssm.inference.guides import (
    LinearizedGuide,
    MarkovGuide,
    ParameterGuide,
    SmoothingGuide,
)
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    LinearTransition,
    PositionEmission,
    RelationalEdges,
    Scales,
    StateEmission,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.presets import boids, graph_ssm, kernel, linear, with_edges
from swarmssm.models.transitions import LinearForceTransition
from swarmssm.tracks import make_tracks

SETTINGS = {"model": "linear", "steps": 3, "window": 12, "batch_windows": 3, "seed": 3}


def scales(individuals=4):
    box = {"centre": (0.0, 0.0), "low": (-3.0, -3.0), "high": (3.0, 3.0)}
    return Scales(2, individuals, 0.1, **box, length=2.0, speed=1.0, slow=0.5, fast=1.5,
                  spacing=1.0, step=0.1, noise=0.02)  # fmt: skip


def straight(seed=0, batch=3, times=6, individuals=4, *, positions=False):
    """Return windows in which bodies move nearly straight on."""
    torch.manual_seed(seed)
    velocity = torch.randn(batch, 1, individuals, 2) + 0.1 * torch.randn(
        batch, times, individuals, 2
    )
    velocity = 0.8 * velocity / velocity.norm(dim=-1, keepdim=True)
    position = torch.randn(batch, 1, individuals, 2) + 0.1 * velocity.cumsum(1)
    states = torch.cat([position, velocity], -1)
    mask = torch.ones(batch, times, individuals, dtype=torch.bool)
    mask[0, :2, 1] = mask[1, 3, 2] = False
    graph = torch.zeros(batch, times, individuals, individuals)
    return SwarmBatch.of(position if positions else states, mask, graph)


def full_linear(scale, observed):
    """Return a law in which all features have noise."""
    seen = None if observed == "states" else StateEmission(2, 0.1, 0.1)
    law = LinearTransition(4, torch.eye(4), 0.3, coupling=0.2)
    return StateSpaceModel(InitialStates.for_scales(scale), law, seen)


def built(name, observed, edges, types):
    ready = {"boids": boids, "kernel": kernel, "graph": graph_ssm, "linear": linear}
    if name == "full":
        model = full_linear(scales(), observed)
    elif name in ("boids", "kernel"):
        model = ready[name](scales(), observed=observed, limits=observed == "states")
    else:
        model = ready[name](scales(), observed=observed)
    model = with_edges(model, scales(), edges, types, {"sparsity": 0.7, "hidden": 8})
    return model.to(torch.float32)


CASES = [
    *itertools.product(["boids", "kernel", "graph", "linear", "full"], ["states"], [None]),
    *itertools.product(
        ["boids", "kernel", "graph", "linear", "full"], ["positions"], [MarkovGuide, SmoothingGuide]
    ),
]


@pytest.mark.parametrize("edges", ["relational", "dynamic-relational"])
@pytest.mark.parametrize(("name", "observed", "guide"), CASES)
def test_the_bound_of_every_law_reaches_the_encoder(name, observed, guide, edges):
    types = 3 if name in ("kernel", "full") else 2
    with quiet_pyro(), torch.random.fork_rng():
        torch.manual_seed(0)
        model = built(name, observed, edges, types)
        guide = (guide or ParameterGuide)(model)
        batch = straight(positions=observed == "positions" and name != "full")
        check_agreement(model, guide, batch)
        if name == "graph":
            # A network that begins as constant velocity knows no neighbours.
            with torch.no_grad():
                for law in getattr(model.transition, "laws", [model.transition]):
                    law.network.straight.weight.normal_(std=0.3)
        loss = Bound(model, guide)(batch)
        loss.backward()
    assert torch.isfinite(loss)
    weights = [*guide.edges_guide.encoder.parameters()]
    assert all(w.grad is not None and w.grad.isfinite().all() for w in weights)
    assert sum(float(w.grad.abs().sum()) for w in weights) > 0


def first_pair(law, types, batch):
    """Return how much more probable the path is with the edge from 1 to 0 than without."""
    scores = []
    for kind in (0, 1):
        given = types.clone()
        given[:, :, 0, 1] = torch.eye(2)[kind]
        put = law.edges.with_edge_types(batch, given)
        scores.append(law.chain(put, {}).log_prob(batch.observations))
    return scores[1] - scores[0]


def test_the_encoder_learns_the_conditional_probability_by_hand():
    model = hooke(3, 1.0, RelationalEdges(scales(3), sparsity=0.7))
    batch = model.simulate(6, 3, num_windows=4, seed=1).batch()
    prior = model.edges.prior(batch)
    logits = torch.zeros(4, 1, 3, 3, 2, requires_grad=True)
    types = model.edges.distribution(logits, prior.pairs).rsample()
    put = model.edges.with_edge_types(batch, types)
    chain = model.chain(put, {})
    term = model.edges.conditional_term(
        chain.transition, batch.observations, batch.mask, chain.inputs, types, prior
    )
    assert not term.any()
    (gradient,) = torch.autograd.grad(term.sum(), logits)
    odds = first_pair(model, types.detach(), batch) + np.log(0.3 / 0.7)
    # Of the cross-entropy with the conditional probability, at a probability of one half.
    assert torch.allclose(gradient[:, 0, 0, 1, 1], torch.sigmoid(odds) - 0.5, atol=1e-3)
    assert not gradient[:, 0, 0, 0].any()


@pytest.mark.parametrize("gradient", ["straight-through", "relaxed"])
@pytest.mark.parametrize("edges", ["relational", "dynamic-relational"])
def test_other_gradients_come_through_the_graph(edges, gradient):
    with quiet_pyro():
        torch.manual_seed(0)
        options = {"gradient": gradient, "hidden": 8}
        model = with_edges(linear(scales(), observed="states"), scales(), edges, 2, options)
        guide = ParameterGuide(model)
        batch = straight()
        law = model.edges.posterior(batch, guide.edges_guide.encoder, model.edges.prior(batch))
        put = model.edges.with_edge_types(batch, law.rsample())
        values = guide.parameters_guide.median()
        model.chain(put, values).log_prob(batch.observations).sum().backward()
        found = sum(float(w.grad.abs().sum()) for w in guide.edges_guide.encoder.parameters())
        assert found > 0
        guide.zero_grad()
        Bound(model, guide)(batch).backward()
    assert all(w.grad.isfinite().all() for w in guide.edges_guide.encoder.parameters())


def test_importance_weights_are_those_of_drawn_edges():
    with quiet_pyro():
        torch.manual_seed(0)
        model = built("linear", "states", "relational", 2)
        guide = ParameterGuide(model)
        assert guide.edges_guide.integrates
        Bound(model, guide, draws=3)(straight()).backward()
        assert not guide.edges_guide.integrates
        Bound(model, guide)
        assert guide.edges_guide.integrates


def hooke(individuals, coupling, edges, noise=0.05):
    law = LinearForceTransition(2, 0.1, cohesion_gain=coupling, alignment_gain=0.0, damping=0.0,
                                process_noise=noise)  # fmt: skip
    return StateSpaceModel(InitialStates.for_scales(scales(individuals)), law, None, edges)


def exact_marginals(model, batch):
    """Return the posterior probability of each edge, by all graphs of each receiver."""
    n = batch.num_individuals
    found = torch.zeros(len(batch), n, n)
    with torch.no_grad():
        for i in range(n):
            others = [j for j in range(n) if j != i]
            scores, rows = [], []
            for bits in itertools.product([0.0, 1.0], repeat=n - 1):
                row = torch.zeros(n)
                row[others] = torch.tensor(bits)
                graph = torch.zeros(n, n)
                graph[i] = row
                put = replace(batch, adjacency=graph.expand(len(batch), batch.num_times, n, n))
                inputs = put.steps()
                step = model.transition(batch.observations[:, :-1], inputs)
                scores.append(step.log_prob(batch.observations[:, 1:])[..., i].sum(1))
                rows.append(row)
            weight = torch.stack(scores).softmax(0)
            found[:, i] = torch.einsum("gb,gj->bj", weight, torch.stack(rows))
    return found


@pytest.mark.slow
def test_planted_graphs_are_found_nearly_as_well_as_can_be():
    n, number = 3, 400
    units = replace(scales(n), spacing=8.0, speed=5.0, step=0.6)
    model = hooke(n, 1.0, RelationalEdges(units, hidden=16), noise=0.5)
    drawn = model.simulate(10, n, num_windows=number, seed=4)
    truth, batch = drawn.adjacency[:, 0] > 0.5, drawn.batch()
    train = batch.select(torch.arange(number - 100))
    test = batch.select(torch.arange(number - 100, number))
    off = ~torch.eye(n, dtype=torch.bool)

    def accuracy(probability):
        return float(((probability > 0.5) == truth[-100:])[:, off].float().mean())

    with quiet_pyro(), torch.random.fork_rng():
        torch.manual_seed(0)
        guide = ParameterGuide(model)
        bound = Bound(model, guide)
        optimizer = torch.optim.Adam(guide.parameters(), lr=0.01)
        for _ in range(120):
            optimizer.zero_grad()
            bound(train.select(torch.randperm(len(train))[:60])).backward()
            optimizer.step()
        found = guide.with_edges(test, sample=False).adjacency[:, 0]
    # All graphs of a receiver can be tried: nobody is right more often in the mean.
    assert accuracy(exact_marginals(model, test)) > 0.97
    assert accuracy(found) > 0.9


def springy(trials=3, frames=40, individuals=4, seed=0):
    model = hooke(individuals, 2.0, RelationalEdges(scales(individuals)))
    drawn = model.simulate(frames, individuals, num_windows=trials, seed=seed)
    states = drawn.states.double().numpy()
    return make_tracks(
        states[..., :2], velocity=states[..., 2:], fps=10, adjacency=drawn.adjacency.numpy()
    )


@pytest.fixture(scope="module")
def tracks():
    return springy()


@pytest.fixture(scope="module", params=["relational", "dynamic-relational"])
def relational(request, tracks) -> Fit:
    options = {"observed": "states" if request.param == "relational" else "positions"}
    return fit(tracks=tracks, edges=request.param, edge_types=3, edge_options={"hidden": 8},
               model_options=options, guide="auto" if request.param == "relational" else "markov",
               **SETTINGS)  # fmt: skip


def test_probabilities_have_labels_and_add_up(relational, tracks):
    found = relational.edge_probabilities(tracks)
    assert found.dims == ("trial", "time", "individual", "neighbor", "edge_type")
    assert found["edge_type"].values.tolist() == ["none", "type 1", "type 2"]
    assert found["neighbor"].values.tolist() == found["individual"].values.tolist()
    assert found.sizes["time"] == 40
    each = found.sum("edge_type", skipna=False).to_numpy()
    off = ~np.eye(4, dtype=bool)
    assert np.allclose(each[..., off], 1.0, atol=1e-5)
    assert np.isnan(each[..., ~off]).all()
    static = relational.model.edges.is_static
    fixed = found.isel(time=slice(0, 12)).std("time").max()
    assert (float(fixed) < 1e-6) == static


def test_a_forecast_knows_the_history_alone(relational, tracks):
    changed = tracks.copy(deep=True)
    changed["position"][:, 25:] += 3.0
    prepared = relational.prepare(tracks), relational.prepare(changed)
    predictor = relational.predictor()
    rows = torch.tensor([24, 20, 24])
    runs = []
    for one in prepared:
        torch.manual_seed(0)
        start = predictor.begin(one, torch.arange(3), rows, 2)
        runs.append(predictor.run(start, 3, sample=True))
    assert torch.equal(runs[0].states, runs[1].states)
    assert torch.equal(runs[0].edge_types, runs[1].edge_types)
    assert runs[0].states.shape == (2, 3, 3, 4, 4)
    off = ~torch.eye(4, dtype=torch.bool)
    assert set(runs[0].edge_types[..., off, :].unique().tolist()) == {0.0, 1.0}


@pytest.mark.parametrize("draws", [0, 3])
def test_forecasts_and_free_runs(relational, tracks, draws):
    ahead = relational.forecast(tracks, 4, draws)
    assert ahead["position"].sizes["time"] == 4
    assert bool(ahead["position"].notnull().all())
    probability = ahead["edge_probability"]
    assert float(probability.min()) >= 0
    assert float(probability.max()) <= 1.0 + 1e-6
    assert relational.rollout(tracks, 5, draws).sizes["time"] == 6
    one = relational.predictive(tracks.isel(trial=[0], time=slice(0, 8)), draws)
    assert bool(one["position"].isel(time=slice(1, None)).notnull().all())


def test_paths_and_kernels(relational, tracks):
    assert relational.posterior(tracks, draws=2)["states"].sizes["draw"] == 2
    predictor = relational.predictor()
    prepared = relational.prepare(tracks)
    assert bool(predictor.mean_states(prepared).isfinite().all())
    start = predictor.begin(prepared, torch.arange(3), torch.tensor([20, 20, 20]), 2)
    kernels = predictor.kernels(start, 3)
    assert kernels.location.shape == (2, 3, 3, 4, 2)
    assert bool((kernels.variance > 0).all())


def test_a_run_folder_gives_the_same_numbers_again(relational, tracks, tmp_path):
    relational.save(tmp_path / "run")
    again = Fit.load(tmp_path / "run")
    assert again.settings.edges == relational.settings.edges
    assert again.settings.edge_types == 3
    xr.testing.assert_identical(
        again.edge_probabilities(tracks), relational.edge_probabilities(tracks)
    )
    xr.testing.assert_identical(
        again.forecast(tracks, 3, 2, seed=1), relational.forecast(tracks, 3, 2, seed=1)
    )


def test_paths_summed_out(tracks):
    few = tracks.isel(trial=[0, 1], time=slice(0, 24))
    found = fit(tracks=few, edges="relational", edge_options={"hidden": 8}, fractions=(1, 0, 0),
                guide="linearized", **{**SETTINGS, "steps": 2})  # fmt: skip
    assert isinstance(found.guide, LinearizedGuide)
    assert found.guide.globals == "multivariate"
    assert found.history["loss"].notnull().all()
    assert bool(found.forecast(few, 2, 2)["position"].notnull().all())
    assert found.edge_probabilities(few).sizes["edge_type"] == 2


def test_the_collapsed_bound_reaches_the_encoder():
    with quiet_pyro():
        torch.manual_seed(0)
        model = built("linear", "positions", "relational", 2)
        guide = LinearizedGuide(model, given=0)

        def draw(batch):
            guide.parameters_guide()
            with windows_plate(batch):
                guide.edges_guide(batch)

        batch = straight(positions=True)
        loss = Trace_ELBO().differentiable_loss(collapsed(model), draw, batch)
        loss.backward()
        encoder = guide.edges_guide.encoder.head.weight.grad.clone()
        guide.edges_guide.encoder.zero_grad()
        put = guide.with_edges(batch)
        types = put.edge_types.clone().requires_grad_()
        values = guide.parameters_guide.median()
        model.edges.gradient = "straight-through"
        evidence = collapsed(model).evidence(model.edges.with_edge_types(batch, types), values)
        (gradient,) = torch.autograd.grad(evidence, types)
    assert encoder.isfinite().all()
    assert float(encoder.abs().sum()) > 0
    assert gradient.isfinite().all()
    assert float(gradient[..., 1].abs().sum()) > 0


def test_runs_without_inferred_edges_say_so(fitted, swarm):
    with pytest.raises(InputError, match='edges="relational"'):
        fitted.edge_probabilities(swarm)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"edges": "relational", "model": "graph-vae"}, "no state-space model"),
        ({"edge_types": 3}, "choose relational"),
        ({"edge_options": {"sparsity": 0.5}}, "choose relational"),
        ({"edges": "relational", "edge_options": {"sparsity": 2.0}}, "sparsity"),
        ({"edges": "relational", "edge_types": 0}, "edge_types"),
        ({"edges": "everybody"}, "'everybody'"),
    ],
)
def test_settings_that_cannot_be_are_refused(tracks, settings, words):
    with pytest.raises(InputError, match=words):
        fit(tracks=tracks, **{**SETTINGS, **settings})


def test_positions_alone_tell_edges():
    with quiet_pyro():
        torch.manual_seed(0)
        model = built("linear", "positions", "dynamic-relational", 2)
        assert isinstance(model.emission, PositionEmission)
        prior = model.edges.prior(straight(positions=True))
    assert prior.log_p.isfinite().all()
