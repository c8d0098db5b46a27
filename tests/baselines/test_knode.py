"""KNODE on a damped oscillator whose path is known."""

import pickle
import sys

import numpy as np
import pytest
import scipy.linalg
import torch

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.knode import KNODE, constant_velocity
from swarmssm.errors import InputError

FPS = 10.0
STIFFNESS, DAMPING = 4.0, 0.3


def oscillator(states, graph):
    """The true derivative: each coordinate swings about 0 by itself."""
    position, velocity = states.chunk(2, dim=-1)
    return torch.cat([velocity, -STIFFNESS * position - DAMPING * velocity], dim=-1)


def swings(trials, frames, seed):
    """Paths by the matrix exponential, from starts of size 1."""
    eye = np.eye(2)
    matrix = np.block([[0 * eye, eye], [-STIFFNESS * eye, -DAMPING * eye]])
    step = scipy.linalg.expm(matrix / FPS)
    state = np.random.default_rng(seed).standard_normal((trials, 3, 4)) * [1, 1, 2, 2]
    states = np.empty((trials, frames, 3, 4))
    for frame in range(frames):
        states[:, frame] = state
        state = state @ step.T
    return states


def without_network(baseline):
    baseline.epochs = 1
    baseline.fit_states(swings(3, 40, 0), FPS, Training())
    for part in baseline.network.rest.parameters():
        torch.nn.init.zeros_(part)
    return baseline


def test_without_its_network_it_follows_what_is_known():
    states = swings(2, 40, 1)
    told = without_network(KNODE(prior=oscillator))
    path = told.predict(states[:, :10], 30, FPS)
    # Runge-Kutta: (2 * 0.1) ** 5 / 120 a step and 30 steps, about 1e-4 of an amplitude of 3.
    np.testing.assert_allclose(path, states[:, 10:], rtol=0, atol=5e-4)
    blind = without_network(KNODE())
    straight = blind.predict(states[:, :10], 2, FPS)
    expected = states[:, 9, :, :2] + 0.2 * states[:, 9, :, 2:]
    np.testing.assert_allclose(straight[:, 1, :, :2], expected, rtol=0, atol=1e-5)


def test_it_learns_a_damped_oscillator():
    baseline = KNODE()
    baseline.ahead, baseline.epochs, baseline.learning_rate = 2, 20, 1e-2
    baseline.fit_states(swings(40, 60, 0), FPS, Training())
    test = swings(20, 60, 2)
    path = baseline.predict(test[:, :10], 50, FPS)
    size = np.sqrt((test[:, 10:] ** 2).mean())
    error = np.sqrt(((path - test[:, 10:]) ** 2).mean())
    assert error < 0.1 * size


def test_a_prior_of_a_module_is_pickled():
    baseline = without_network(KNODE(prior=constant_velocity))
    copy = pickle.loads(pickle.dumps(baseline))
    states = swings(2, 10, 1)
    np.testing.assert_array_equal(copy.predict(states, 3, FPS), baseline.predict(states, 3, FPS))


def test_the_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torchdiffeq", None)
    with pytest.raises(InputError, match=r"knode: it needs torchdiffeq. Install it with"):
        KNODE().fit_states(swings(2, 20, 0), FPS, Training())
