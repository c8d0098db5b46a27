"""Windows against small tracks worked out by hand."""

import numpy as np
import torch

from swarmssm.baselines.windows import Trials, carried_forward, graphs_of, standardiser
from swarmssm.graphs import GraphRule

FPS = 2.0


def line(frames=6):
    """One trial of two: (t, 0) with velocity (2, 0) at 2 frames per second, and one at rest."""
    states = np.zeros((1, frames, 2, 4))
    states[0, :, 0, 0] = np.arange(frames)
    states[0, :, 0, 2] = 2.0
    states[0, :, 1] = [3.0, 1.0, 0.0, 0.0]
    return states


def test_gaps_are_filled_at_constant_velocity_from_the_past_alone():
    states = line()
    states[0, 2:4, 0] = np.nan
    filled, seen = carried_forward(states, FPS, 2)
    np.testing.assert_array_equal(filled, line())
    assert seen.all()
    filled, seen = carried_forward(states, FPS, 1)
    assert seen[0, :, 0].tolist() == [True, True, True, False, True, True]
    np.testing.assert_array_equal(filled[0, 3, 0], 0.0)
    np.testing.assert_array_equal(filled[0, 2, 0], line()[0, 2, 0])


def test_before_the_first_known_frame_there_is_nothing():
    states = line()
    states[0, :3, 0, 1] = np.nan
    filled, seen = carried_forward(states, FPS, 5)
    assert seen[0, :, 0].tolist() == [False] * 3 + [True] * 3
    np.testing.assert_array_equal(filled[0, :3, 0], 0.0)


def test_the_standardiser_leaves_constants_alone():
    scaler = standardiser(line())
    scaled = scaler.transform(line())
    np.testing.assert_allclose(scaled.reshape(-1, 4).mean(0), 0.0, atol=1e-12)
    np.testing.assert_allclose(scaled.reshape(-1, 4).std(0), [1.0, 1.0, 1.0, 0.0], atol=1e-12)
    assert scaler.scale[3] == 1.0


def test_the_graph_is_that_of_the_rule_among_those_who_are_there():
    states = torch.tensor(line()[0, 2])
    both = torch.tensor([True, True])
    assert graphs_of(states, both, None).tolist() == [[False, True], [True, False]]
    assert graphs_of(states, both, GraphRule.parse("radius:1.5"))[0, 1]
    assert not graphs_of(states, both, GraphRule.parse("radius:1.4")).any()
    for rule in (None, GraphRule.parse("radius:9")):
        assert not graphs_of(states, torch.tensor([True, False]), rule).any()


def test_windows_reach_over_both_ends_of_a_trial():
    states = line(4)
    states[0, 3, 1] = np.nan
    trials = Trials(states, FPS, standardiser(states), None, 3, 2)
    assert trials.origins.tolist() == [[0, 0], [0, 1], [0, 2]]
    cut = trials.windows(trials.origins[[0, 2]])
    assert len(cut) == 2
    assert cut.known[0].tolist() == [[False] * 2, [False] * 2, [True] * 2, [True] * 2, [True] * 2]
    assert cut.known[1, :, 0].tolist() == [True, True, True, True, False]
    assert cut.known[1, :, 1].tolist() == [True, True, True, False, False]
    assert cut.seen[1, :, 1].all()
    assert cut.graph[1, :, 0, 1].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0]
    back = trials.scaler.inverse(cut.states[1, :4, 0].double().numpy())
    np.testing.assert_allclose(back, states[0, :, 0], atol=1e-6)
    assert cut.first(2).states.shape == (2, 2, 2, 4)


def test_graphs_made_window_by_window_are_the_same(monkeypatch):
    states = np.random.default_rng(0).standard_normal((2, 8, 3, 4))
    rule = GraphRule.parse("radius:1.0")
    kept = Trials(states, FPS, standardiser(states), rule, 3, 2)
    monkeypatch.setattr("swarmssm.baselines.windows.GRAPHS_KEPT", 0)
    made = Trials(states, FPS, standardiser(states), rule, 3, 2)
    assert made.graph is None
    first, second = (trials.windows(trials.origins).graph for trials in (kept, made))
    assert torch.equal(first, second)
    assert 0 < first.sum() < first.numel()
