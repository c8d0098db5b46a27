"""Analyses of inferred edges look at these, not at the graph of the tracks."""

import numpy as np
import pytest
import torch

from swarmssm import inference, simulate
from swarmssm.analysis import analysis_page, analyze, inferred_edges, plots, to_inference_data
from swarmssm.analysis.interpretation import influence
from swarmssm.analysis.posterior.accelerations import acceleration_model, posterior_paths
from swarmssm.analysis.posterior.inferred_graph import graph_of_steps, step_inputs

KINDS = ("relational", "dynamic-relational")


@pytest.fixture(scope="module")
def flock():
    return simulate.simulate_boids(individuals=4, steps=30, trials=3, seed=1)


@pytest.fixture(scope="module", params=KINDS)
def fit(request, flock):
    return inference.fit(
        "linear",
        flock,
        model_options={"observed": "states"},
        edges=request.param,
        edge_options={"hidden": 4},
        window=10,
        steps=2,
    )


@pytest.fixture
def sure(fit):
    """Return a function that makes the encoder sure of one type, whatever it is told."""
    before = {key: value.clone() for key, value in fit.guide.state_dict().items()}

    def make(kind):
        head = fit.guide.edges_guide.encoder.head
        last = head if isinstance(head, torch.nn.Linear) else head[-1]
        with torch.no_grad():
            last.weight.zero_()
            last.bias.fill_(-60.0)
            last.bias[kind] = 60.0
        return fit

    yield make
    fit.guide.load_state_dict(before)


def moved(fit, tracks, graph, states, present):
    """Return what everybody's acceleration changes by if the first individual stands elsewhere."""
    motion = acceleration_model(fit)
    away = states.clone()
    away[:, :, 0, :2] += 0.3
    with torch.no_grad():
        here, there = (motion.acceleration(each, graph, present) for each in (states, away))
    return (there - here)[:, :, 1:]


# The last frame of a window moves nothing in it: its types are those of the prior.
@pytest.mark.parametrize("kind", [0, 1])
def test_the_law_of_motion_sees_the_inferred_edges(sure, flock, kind):
    fit = sure(kind)
    prepared = fit.prepare(flock)
    graph = graph_of_steps(fit, prepared).to(torch.float64)[:, :-1]
    pairs = ~torch.eye(4, dtype=torch.bool)
    assert graph.shape == (3, 29, 4, 4, 2)
    torch.testing.assert_close(graph[..., pairs, kind], torch.ones(3, 29, 12).double())
    assert not graph[..., ~pairs, :].any()
    paths = posterior_paths(fit, flock, draws=1)
    assert torch.equal(paths.adjacency[:, :-1], graph)
    states, present = paths.states[0, :, :-1], paths.present[:, :-1]
    felt = moved(fit, flock, graph, states, present)
    if kind == 0:
        assert not felt.any()
    else:
        assert felt.abs().max() > 1e-6
    inputs = step_inputs(fit.model, graph, present)
    torch.testing.assert_close(inputs.adjacency, graph[..., 1])


def test_without_edges_nobody_moves_another(sure, flock):
    short = flock.isel(time=slice(0, 10))
    found = influence.influence(sure(0), short, draws=1)
    strength = found["step_influence"].transpose("time", "individual", "neighbor", ...).to_numpy()
    pairs = ~np.eye(4, dtype=bool)
    assert len(strength) == 10
    assert not strength[:-1][:, pairs].any()


def test_everything_can_be_asked_of_it(fit, flock):
    short = flock.isel(time=slice(0, 12))
    asked = ["forces", "kernels", "force_maps", "influence"]
    found = analyze(fit, short, draws=1, only=asked)
    assert set(found.datasets) >= {*asked, "edges"}
    row = found.summary().loc[("edges", "AUC for the nearer half of the pairs")]
    assert row["value"] == float(found.edges["nearness_auc"])
    assert "Inferred edges" in analysis_page(found, fit, short).html()
    data = to_inference_data(fit, short, draws=2)
    density = data["log_likelihood"]["position"].to_numpy()
    # Nothing foresees the first frame of exactly observed states.
    assert np.isfinite(density[..., 1:, :]).all()


@pytest.mark.parametrize("kind", [0, 1])
def test_what_is_told_of_sure_edges(sure, flock, kind):
    fit = sure(kind)
    found = inferred_edges(fit, flock).isel(time=slice(0, -1))
    pairs = ~np.eye(4, dtype=bool)
    told = found["edge_probability"].isel(edge_type=kind).to_numpy()
    np.testing.assert_allclose(told[..., pairs], 1.0)
    assert np.isnan(told[..., ~pairs]).all()
    # One of thirty frames has the prior's.
    assert float(found["share"].isel(edge_type=kind)) > 29 / 30
    assert float(found["certainty"]) > 29 / 30
    _, axes = plots.plot_edge_probabilities(found)
    assert [ax.get_title() for ax in axes[0]] == ["type 1"]


def test_edges_of_the_near_are_told_by_distance(fit, flock, monkeypatch):
    """Planted: an edge the surer, the nearer; the graph of boids is that of a radius."""
    told = fit.edge_probabilities(flock)
    place = flock["position"].transpose("trial", "time", "individual", "space").to_numpy()
    apart = np.linalg.norm(place[:, :, :, None] - place[:, :, None], axis=-1)
    probability = np.where(np.eye(4, dtype=bool), np.nan, np.exp(-apart))
    planted = told.copy(data=np.stack([1.0 - probability, probability], -1))
    monkeypatch.setattr(type(fit), "edge_probabilities", lambda self, tracks: planted)
    found = inferred_edges(fit, flock)
    for name in ("nearness_auc", "graph_auc", "distance_auc"):
        assert float(found[name]) == pytest.approx(1.0)
    turned = planted.copy(data=planted.to_numpy()[..., ::-1])
    monkeypatch.setattr(type(fit), "edge_probabilities", lambda self, tracks: turned)
    assert float(inferred_edges(fit, flock)["nearness_auc"]) == pytest.approx(0.0)
