"""Windows as models see them: who is there, and parts of them with any kind of graph."""

import dataclasses

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from swarmssm.graphs import EdgeList
from swarmssm.models import SwarmBatch
from swarmssm.models.batch import presence

WINDOWS, TIMES, INDIVIDUALS = 4, 6, 5


def draw(*shape, seed, share=0.6):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed)) < share


@pytest.fixture
def batch():
    """Windows of another weight each, out of more, with controls and a graph as a matrix."""
    mask = draw(WINDOWS, TIMES, INDIVIDUALS, seed=0)
    observations = torch.randn(*mask.shape, 4) * mask.unsqueeze(-1)
    adjacency = draw(*mask.shape, INDIVIDUALS, seed=1) & mask[..., None] & mask[..., None, :]
    adjacency &= ~torch.eye(INDIVIDUALS, dtype=torch.bool)
    controls = torch.randn(WINDOWS, TIMES, 2)
    made = SwarmBatch.of(observations, mask, adjacency.to(torch.float32), controls)
    weight = torch.tensor([1.0, 2.0, 0.5, 3.0])
    return dataclasses.replace(made, window_weight=weight, population=9)


@pytest.fixture
def listed(batch):
    """The same with the graph as a list of edges."""
    return dataclasses.replace(batch, adjacency=EdgeList.from_dense(batch.adjacency))


def dense(graph):
    return graph.to_dense(torch.float32) if isinstance(graph, EdgeList) else graph


def test_presence_by_hand():
    """From the first sighting to the last, gaps included; who is never seen is never there."""
    seen = ["-xx-x-", "x-----", "------", "x----x", "xxxxxx"]
    there = ["-xxxx-", "x-----", "------", "xxxxxx", "xxxxxx"]
    mask, expected = (
        torch.tensor([[c == "x" for c in row] for row in rows]).T for rows in (seen, there)
    )
    assert torch.equal(presence(mask), expected)
    # Each window for itself.
    both = torch.stack([mask, ~mask])
    assert torch.equal(presence(both)[0], expected)
    assert torch.equal(presence(both)[1], presence(~mask))


@given(times=st.integers(1, 9), seed=st.integers(0, 10**6), share=st.sampled_from([0.1, 0.5, 0.9]))
def test_presence_is_the_shortest_stay_that_holds_all_sightings(times, seed, share):
    mask = draw(2, times, 3, seed=seed, share=share)
    found = presence(mask)
    assert found.dtype == torch.bool
    for window in range(2):
        for individual in range(3):
            rows = mask[window, :, individual].nonzero().flatten().tolist()
            stay = range(rows[0], rows[-1] + 1) if rows else range(0)
            assert found[window, :, individual].nonzero().flatten().tolist() == list(stay)
    assert torch.equal(presence(found), found)
    # It knows no direction of time.
    assert torch.equal(presence(mask.flip(-2)), found.flip(-2))


def test_a_batch_made_of_windows_is_its_own_population(batch):
    made = SwarmBatch.of(batch.observations, batch.mask, batch.adjacency)
    assert made.population == len(made) == WINDOWS
    assert (made.num_times, made.num_individuals) == (TIMES, INDIVIDUALS)
    assert torch.equal(made.window_weight, torch.ones(WINDOWS))
    assert torch.equal(made.present, presence(batch.mask))
    assert made.controls is None
    assert made.steps().controls is None
    # Weights are of the observations' type, with which they are multiplied.
    double = SwarmBatch.of(batch.observations.double(), batch.mask, batch.adjacency)
    assert double.window_weight.dtype == torch.float64


def test_steps_know_what_is_at_their_beginning(batch, listed):
    for one in (batch, listed):
        steps = one.steps()
        assert isinstance(steps.adjacency, type(one.adjacency))
        assert torch.equal(dense(steps.adjacency), batch.adjacency[:, :-1])
        assert torch.equal(steps.controls, batch.controls[:, :-1])
        assert torch.equal(steps.present, batch.present[:, :-1])
        for step in range(TIMES - 1):
            at = steps.at(step)
            assert torch.equal(dense(at.adjacency), batch.adjacency[:, step])
            assert torch.equal(at.controls, batch.controls[:, step])
            assert torch.equal(at.present, batch.present[:, step])
    single = SwarmBatch.of(batch.observations[:, :1], batch.mask[:, :1], listed.adjacency[:, :1])
    assert single.steps().adjacency.leading == (WINDOWS, 0)
    assert single.steps().adjacency.num_edges == 0


@pytest.mark.parametrize("index", [[2, 0], [1], [3, 3, 0, 1, 2], []])
def test_selected_windows_belong_together(batch, listed, index):
    rows = torch.tensor(index, dtype=torch.long)
    for one in (batch, listed):
        picked = one.select(rows)
        assert (len(picked), picked.population) == (len(index), 9)
        assert isinstance(picked.adjacency, type(one.adjacency))
        assert torch.equal(dense(picked.adjacency), batch.adjacency[rows])
        for name in ("observations", "mask", "window_weight", "present", "controls"):
            assert torch.equal(getattr(picked, name), getattr(batch, name)[rows])
        # Parts of parts are parts.
        steps = picked.steps()
        assert torch.equal(dense(steps.adjacency), batch.adjacency[rows][:, :-1])


def test_selected_windows_keep_who_is_said_to_be_there(batch):
    """Presence may be known better than from the sightings in the window."""
    everybody = dataclasses.replace(batch, present=torch.ones_like(batch.mask))
    assert everybody.select(torch.tensor([1, 2])).present.all()


def test_all_of_a_batch_moves_to_another_device(batch, listed):
    for one in (batch, listed, dataclasses.replace(batch, controls=None)):
        moved = one.to(torch.device("meta"))
        for name in ("observations", "mask", "window_weight", "present"):
            assert getattr(moved, name).device.type == "meta"
        if one.controls is None:
            assert moved.controls is None
        else:
            assert moved.controls.device.type == "meta"
        graph = moved.adjacency
        edges = graph.sender if isinstance(graph, EdgeList) else graph
        assert edges.device.type == "meta"
        assert moved.population == 9
