"""The same graph whether it is a matrix or a list, and whichever way the neighbours are found."""

import math

import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import (
    EdgeList,
    GraphRule,
    between,
    dense,
    edges_by_rule,
    graph_by_rule,
    represent,
    take_frames,
)
from swarmssm.graphs.neighbors import TREE_FROM
from swarmssm.graphs.representation import MATRIX_FROM_DENSITY, MATRIX_UP_TO

LARGE = TREE_FROM + 44


def scattered(*shape, seed=0, dtype=torch.float64, absent=0.1):
    """Return positions in a square of side 10, some of them NaN."""
    generator = torch.Generator().manual_seed(seed)
    drawn = 10.0 * torch.rand(*shape, dtype=dtype, generator=generator)
    gone = torch.rand(shape[:-1], generator=generator) < absent
    return drawn.masked_fill(gone.unsqueeze(-1), math.nan)


RULES = [
    "radius:1.2",
    "radius:0",
    "radius:radius=1.2,box=10",
    "radius:radius=5,box=10",
    "k-nearest:1",
    "k-nearest:6",
    "k-nearest:500",
    "complete",
]


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("individuals", [1, 2, 7, 40, LARGE])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_list_made_at_once_is_the_matrix(rule, individuals, dtype):
    rule = GraphRule.parse(rule)
    positions = scattered(2, 2, individuals, 2, dtype=dtype)
    expected = rule(positions)
    edges = edges_by_rule(rule, positions)
    assert edges.leading == (2, 2)
    assert torch.equal(edges.to_dense(torch.bool), expected)
    assert (edges.receiver * max(edges.num_nodes, 1) + edges.sender).diff().gt(0).all()


@pytest.mark.parametrize("rule", ["radius:1", "radius:radius=1,box=18", "k-nearest:3"])
@pytest.mark.parametrize("space", [2, 3])
def test_ties_are_decided_alike(rule, space):
    """On a lattice every individual has several neighbours at exactly the same distance."""
    side = torch.arange(18.0 if space == 2 else 7.0)
    lattice = torch.cartesian_prod(*[side] * space)
    # Outside the box too, where it is periodic.
    positions = torch.stack([lattice, lattice - 4.0])
    assert len(lattice) > TREE_FROM
    rule = GraphRule.parse(rule)
    edges = edges_by_rule(rule, positions)
    assert torch.equal(edges.to_dense(torch.bool), rule(positions))
    if rule.kind == "k-nearest":
        assert (edges.offsets.diff() == 3).all()
    elif rule.box == 18 and space == 2:
        assert (edges.offsets.diff() == 4).all()


def test_individuals_at_the_very_same_place():
    positions = torch.zeros(LARGE, 2)
    for rule in (GraphRule("radius", radius=0.0), GraphRule("k-nearest", k=2)):
        edges = edges_by_rule(rule, positions)
        assert torch.equal(edges.to_dense(torch.bool), rule(positions))


def test_nobody_is_there():
    positions = torch.full((3, LARGE, 2), math.nan)
    for rule in (GraphRule("radius", radius=1.0), GraphRule("k-nearest", k=2)):
        assert edges_by_rule(rule, positions).num_edges == 0
        assert edges_by_rule(rule, positions[:0]).leading == (0,)


def test_a_visual_graph_needs_velocities():
    rule = GraphRule.parse("visual:1")
    positions = scattered(2, 40, 2, absent=0.0)
    velocities = torch.randn(2, 40, 2, dtype=torch.float64, generator=torch.Generator())
    expected = rule(positions, velocities)
    assert expected.any()
    edges = edges_by_rule(rule, positions, velocities)
    assert torch.equal(edges.to_dense(torch.bool), expected)
    with pytest.raises(InputError, match="velocities"):
        edges_by_rule(rule, positions)
    with pytest.raises(InputError, match=r"that of the positions, \(2, 40, 2\)"):
        edges_by_rule(rule, positions, velocities[:1])


def test_large_swarms_never_become_a_matrix(monkeypatch):
    """5,000 individuals in a frame would be 25 million pairs."""

    def refuse(*_):
        raise AssertionError("a matrix of all pairs was asked for")

    rules = GraphRule("k-nearest", k=10), GraphRule("radius", radius=0.25)
    monkeypatch.setattr(GraphRule, "__call__", refuse)
    monkeypatch.setattr(EdgeList, "to_dense", refuse)
    positions = scattered(1, 5000, 2)
    present = positions[0].isfinite().all(-1)
    nearest, around = (graph_by_rule(rule, positions) for rule in rules)
    torch.testing.assert_close(nearest.offsets.diff(), 10 * present.long())
    # About 4500 x 4500 x pi 0.25 ** 2 / 100 ordered pairs, less what the border cuts off.
    assert 0.9 < around.num_edges / (present.sum() ** 2 * math.pi * 0.25**2 / 100) < 1.02


@pytest.mark.parametrize(
    ("individuals", "density", "is_list"),
    [
        (MATRIX_UP_TO, 0.01, False),
        (MATRIX_UP_TO + 1, 0.01, True),
        (100, 0.9 * MATRIX_FROM_DENSITY, True),
        (100, 1.1 * MATRIX_FROM_DENSITY, False),
        (200, 0.0, True),
    ],
)
def test_size_and_density_decide(individuals, density, is_list):
    matrix = torch.zeros(3, individuals * individuals)
    matrix[:, : round(density * individuals**2)] = 1.0
    matrix = matrix.reshape(3, individuals, individuals)
    for given in (matrix, matrix.bool(), EdgeList.from_dense(matrix)):
        found = represent(given)
        assert isinstance(found, EdgeList) == is_list
        assert torch.equal(dense(found).to(torch.float32), matrix)
    assert dense(represent(matrix, torch.float64)).dtype == (
        torch.get_default_dtype() if is_list else torch.float64
    )


def test_weights_outlast_the_change():
    generator = torch.Generator().manual_seed(0)
    matrix = torch.rand(2, 40, 40, dtype=torch.float64, generator=generator)
    for share in (0.1, 0.9):
        weighted = torch.where(matrix < share, matrix, 0.0)
        found = represent(weighted)
        assert isinstance(found, EdgeList) == (share == 0.1)
        assert torch.equal(dense(found), weighted)
        assert torch.equal(dense(represent(EdgeList.from_dense(weighted))), weighted)


def test_a_rule_gives_what_suits():
    positions = scattered(2, 100, 2)
    assert isinstance(graph_by_rule(GraphRule("radius", radius=1.0), positions), EdgeList)
    for rule, count in (("radius:8", 100), ("complete", 100), ("radius:1", 20)):
        rule = GraphRule.parse(rule)
        graph = graph_by_rule(rule, positions[:, :count])
        assert torch.equal(graph, rule(positions[:, :count]).to(torch.float64))
    assert graph_by_rule(GraphRule("complete"), positions, dtype=torch.float32).dtype.itemsize == 4


def test_between_and_frames_are_the_same_on_both():
    generator = torch.Generator().manual_seed(1)
    matrix = torch.rand(2, 3, 6, 6, generator=generator) < 0.5
    present = torch.rand(2, 3, 6, generator=generator) < 0.7
    index = torch.tensor([[3, -1], [0, 5]])
    expected = matrix & present[..., None] & present[..., None, :]
    padded = matrix.reshape(6, 6, 6)[index.clamp(min=0)]
    padded[0, 1] = False
    for kind in (lambda m: m, lambda m: m.float(), EdgeList.from_dense):
        graph = kind(matrix)
        kept, taken = between(graph, present), take_frames(graph, index)
        if isinstance(graph, torch.Tensor):
            assert kept.dtype == taken.dtype == graph.dtype
        assert torch.equal(dense(kept, torch.bool).bool(), expected)
        assert torch.equal(dense(taken, torch.bool).bool(), padded)
