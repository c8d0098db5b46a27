"""Edges that are right, upside down, or know nothing."""

import numpy as np
import pytest

from swarmssm.benchmark import make_task
from swarmssm.benchmark.edges import edge_scores
from swarmssm.graphs import radius_graph
from swarmssm.simulate import simulate_boids

from .conftest import straight


@pytest.fixture(scope="module")
def task():
    # A small radius: some of the pairs see each other, and others do not.
    return make_task(simulate_boids(8, 120, 8, radius=1.5, seed=5))


class Knows:
    """Says the true graph with certainty, as the type of the given number among three."""

    def __init__(self, place, upside_down=False):
        self.place, self.upside_down = place, upside_down

    def edge_probabilities(self, states, fps):
        import torch

        near = radius_graph(torch.from_numpy(states[..., :2]), 1.5).numpy().astype(float)
        out = np.full((*near.shape, 3), 1.0 / 3.0)
        out[..., self.place] = 1.0 - near if self.upside_down else near
        return out


@pytest.mark.parametrize("method", [Knows(0), Knows(2), Knows(1, upside_down=True)])
def test_a_type_may_stand_anywhere_and_for_no_edge(task, method):
    found = edge_scores(task, method)
    assert found["edge_auc"] == 1.0
    # Within a radius is what a distance tells.
    assert found["edge_auc_distance"] == 1.0
    assert abs(found["edge_auc_permuted"] - 0.5) < 0.2


class Nothing:
    """Draws numbers."""

    def edge_probabilities(self, states, fps):
        generator = np.random.default_rng(0)
        return generator.random((states.shape[0], 1, 8, 8, 2))


def test_edges_of_chance_are_worth_a_half(task):
    # One number a pair of each trial: at least 56 pairs in one test trial; sd of an AUC of n and m
    # is at most sqrt((n + m + 1) / (12 n m)), with at least a tenth of either.
    pairs = 56
    sd = np.sqrt((pairs + 1) / (12 * 0.1 * 0.9 * pairs**2))
    assert abs(edge_scores(task, Nothing())["edge_auc"] - 0.5) < 6 * sd


def test_nothing_is_said_where_nothing_is_known(task):
    assert edge_scores(task, object()) == {}
    assert edge_scores(make_task(straight()), Knows(0)) == {}
