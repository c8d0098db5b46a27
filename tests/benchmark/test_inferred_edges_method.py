"""Edges that are inferred under a law that is held, as a method of the benchmark."""

from dataclasses import replace

import pytest

from swarmssm.benchmark import inferred_edges_method, make_task
from swarmssm.benchmark.edges import edge_scores
from swarmssm.benchmark.models import MODELS
from swarmssm.models.parameters import priors_of
from swarmssm.simulate import simulate_boids


def test_it_takes_no_graph_and_holds_a_law(flock, monkeypatch):
    for name in ("FEWEST", "PILOT_STEPS"):
        monkeypatch.setattr(inferred_edges_method, name, 2)
    task = make_task(flock, horizons=(1,), origins=5, free_steps=10)
    method = replace(MODELS["boids-edges"], spacings=(3.0,), neighbors=(3,))
    fit = method.fit(task, 1.0, 0)
    assert fit.settings.edges == "dynamic-relational"
    assert fit.settings.graph == "auto"
    assert priors_of(fit.model) == []
    assert set(edge_scores(task, fit)) == {"edge_auc", "edge_auc_distance", "edge_auc_permuted"}


@pytest.mark.slow
def test_the_radius_graph_is_found():
    """Held-out trials; the law alone reaches 0.5 in these 2 minutes if both are learned at once."""
    flock = simulate_boids(10, 400, 6, seed=0)
    task = make_task(flock, split_by="trial", horizons=(1,), origins=5, free_steps=10)
    found = edge_scores(task, MODELS["boids-edges"].fit(task, 120.0, 0))
    assert found["edge_auc"] > 0.9
    assert abs(found["edge_auc_permuted"] - 0.5) < 0.1
