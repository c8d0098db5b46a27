"""Whether a fit has come to rest."""

import numpy as np
import pytest
import torch

from swarmssm.inference import fit
from swarmssm.inference.convergence import add_distances, convergence
from swarmssm.simulate import simulate_boids

OPTIONS = {"walls": False, "limits": False, "relaxation": True, "noise": "additive"}


def rows(losses, distances=None):
    found = [{"step": float(i), "loss": float(loss)} for i, loss in enumerate(losses)]
    for row, distance in zip(found, distances if distances is not None else [], strict=False):
        row["distance"] = float(distance)
    return found


def test_a_straight_fall_is_told_exactly():
    found = convergence(rows(10.0 - 0.02 * np.arange(100)))
    # The last ten rows are nine steps apart.
    assert found.fall == pytest.approx(0.18)
    assert found.fall_error == pytest.approx(0.0, abs=1e-12)
    assert not found.converged
    assert "Not converged" in found.verdict


def test_noise_about_a_level_is_rest():
    noise = np.random.default_rng(0).normal(0.0, 0.1, 200)
    found = convergence(rows(3.0 + noise, np.r_[np.ones(150), np.zeros(50)]))
    assert found.converged
    assert found.distance == 0.0


def test_parameters_that_move_are_no_rest():
    assert not convergence(rows(np.zeros(50), np.linspace(20.0, 0.0, 50))).converged


def test_a_single_row_says_nothing():
    assert not convergence(rows([1.0])).converged


def test_distances_are_in_standard_deviations():
    places = [torch.tensor([0.0, 0.0]), torch.tensor([1.0, 4.0]), torch.tensor([1.0, 5.0])]
    history = rows(np.zeros(3))
    add_distances(history, places, torch.tensor([0.5, 2.0]))
    assert [row["distance"] for row in history] == [2.5, 0.5, 0.0]


def test_the_linearized_guide_takes_the_steps_that_are_asked_for():
    tracks = simulate_boids(4, steps=80, observation_noise=0.02, seed=3)
    brief = fit("boids", tracks, steps=3, model_options=OPTIONS, graph="radius:2")
    assert brief.history["step"].tolist() == [1.0, 2.0, 3.0]
    assert not convergence(brief.history).converged
    whole = fit("boids", tracks, model_options=OPTIONS, graph="radius:2")
    assert len(whole.history) > 3
    assert convergence(whole.history).converged
    passes = fit("boids", tracks, epochs=3, model_options=OPTIONS, graph="radius:2")
    assert passes.history["loss"].tolist() == brief.history["loss"].tolist()


def test_a_network_tells_how_far_its_parameters_moved():
    tracks = simulate_boids(4, steps=60, observation_noise=0.02, seed=3)
    options = {"model_options": OPTIONS, "guide": "markov", "graph": "radius:2"}
    history = fit("boids", tracks, steps=20, validate_every=1, **options).history
    assert history["distance"].iloc[-1] == 0.0
    assert history["distance"].iloc[0] > 0.0
