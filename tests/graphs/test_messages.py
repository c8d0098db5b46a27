"""Sums over neighbours against numbers worked out by hand; matrix and list give the same."""

import pytest
import torch

from swarmssm.graphs import (
    EdgeList,
    degree,
    dense,
    neighbor_mean,
    neighbor_sum,
    pair_sum,
)

DOUBLE = torch.float64
#: float64 keeps sixteen digits, and a few dozen terms of size 1 are added in another order.
CLOSE = {"rtol": 1e-12, "atol": 1e-12}


def message(receiver, sender):
    """A message that is not symmetric, not linear, and of another width than the features."""
    offset = sender - receiver
    return torch.cat([offset.sin() * receiver, offset.square().sum(-1, keepdim=True)], -1)


FUNCTIONS = {
    "sum": neighbor_sum,
    "mean": lambda values, graph: neighbor_mean(values, graph)[0],
    "has neighbours": lambda values, graph: (
        neighbor_mean(values, graph)[1] * torch.ones_like(values)
    ),
    "degree": lambda values, graph: degree(values, graph) * values,
    "pairs": lambda values, graph: pair_sum(values, graph, message),
}


def drawn(*leading, seed=0, individuals=6, weighted=False):
    generator = torch.Generator().manual_seed(seed)
    shape = (*leading, individuals, individuals)
    matrix = (torch.rand(shape, generator=generator) < 0.4).to(DOUBLE)
    if weighted:
        matrix = matrix * (0.1 + torch.rand(shape, dtype=DOUBLE, generator=generator))
    # Individual 1 sees nobody, and nobody sees individual 2.
    matrix.diagonal(dim1=-2, dim2=-1).zero_()
    matrix[..., 1, :] = 0.0
    matrix[..., 2] = 0.0
    return matrix


def values_like(*shape, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, dtype=DOUBLE, generator=generator)


@pytest.mark.parametrize("kind", [lambda matrix: matrix, EdgeList.from_dense])
def test_by_hand(kind):
    # 0 sees 1 and 2, 1 sees 0, 2 sees nobody.
    graph = kind(torch.tensor([[0, 1, 1], [1, 0, 0], [0, 0, 0]]))
    values = torch.tensor([[1.0, 10.0], [2.0, 20.0], [5.0, 50.0]], dtype=DOUBLE)
    expected = torch.tensor([[7.0, 70.0], [1.0, 10.0], [0.0, 0.0]], dtype=DOUBLE)
    torch.testing.assert_close(neighbor_sum(values, graph), expected)
    mean, has_neighbor = neighbor_mean(values, graph)
    torch.testing.assert_close(mean, expected / torch.tensor([[2.0], [1.0], [1.0]]))
    assert has_neighbor.tolist() == [[True], [True], [False]]
    assert degree(values, graph).tolist() == [[2.0], [1.0], [0.0]]
    difference = pair_sum(values, graph, lambda mine, other: other - mine)
    expected = torch.tensor([[5.0, 50.0], [-1.0, -10.0], [0.0, 0.0]], dtype=DOUBLE)
    torch.testing.assert_close(difference, expected)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(
    ("graphs", "values"),
    [
        ((), ()),
        ((3,), (3,)),
        ((2, 3), (2, 3)),
        ((2, 3), (5, 2, 3)),
        ((3,), (4, 2, 3)),
        ((), (2, 3)),
        ((1, 3), (2, 3)),
        ((2, 3), (2, 1)),
        ((2, 3), ()),
    ],
    ids=str,
)
def test_matrix_and_list_agree_with_their_gradients(name, weighted, graphs, values):
    function = FUNCTIONS[name]
    matrix = drawn(*graphs, weighted=weighted)
    features = values_like(*values, 6, 3).requires_grad_()
    results, gradients = [], []
    for graph in (matrix, EdgeList.from_dense(matrix)):
        result = function(features, graph)
        weight = values_like(*result.shape, seed=2)
        results.append(result)
        if name == "has neighbours":
            continue
        (first,) = torch.autograd.grad((result * weight).sum(), features, create_graph=True)
        gradients.append(first)
        if name == "pairs":
            gradients[-1] = torch.autograd.grad(first.square().sum(), features)[0]
    torch.testing.assert_close(*results, **CLOSE)
    assert results[0].abs().sum() > 0
    if gradients:
        torch.testing.assert_close(*gradients, **CLOSE)
        assert gradients[0].abs().sum() > 0


@pytest.mark.parametrize("name", ["sum", "mean", "degree", "pairs"])
def test_gradients_of_weights_agree(name):
    matrix = drawn(2, 3, weighted=True)
    features = values_like(2, 3, 6, 3)
    gradients = []
    for kind in (lambda m: m, EdgeList.from_dense):
        leaf = matrix.clone().requires_grad_()
        FUNCTIONS[name](features, kind(leaf)).square().sum().backward()
        gradients.append(leaf.grad)
    # An entry of 0 is no edge: a list has no gradient for it.
    torch.testing.assert_close(gradients[0] * (matrix > 0), gradients[1], **CLOSE)
    assert gradients[1].abs().sum() > 0


@pytest.mark.parametrize("name", ["sum", "mean", "pairs"])
def test_derivatives_are_right_to_second_order(name):
    graph = EdgeList.from_dense(drawn(2))
    features = values_like(2, 6, 2).requires_grad_()
    function = FUNCTIONS[name]
    assert torch.autograd.gradcheck(lambda x: function(x, graph), features)
    if name == "pairs":
        assert torch.autograd.gradgradcheck(lambda x: function(x, graph), features)


@pytest.mark.parametrize("name", ["sum", "mean", "pairs"])
@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
@pytest.mark.parametrize("transform", [torch.func.jacfwd, torch.func.jacrev])
def test_function_transforms_go_through(name, transform):
    matrix = drawn(2)
    features = values_like(2, 6, 2)
    expected = transform(lambda x: FUNCTIONS[name](x, matrix))(features)
    # What the list keeps from a transform must serve outside it too.
    graph = EdgeList.from_dense(matrix)
    actual = transform(lambda x: FUNCTIONS[name](x, graph))(features)
    torch.testing.assert_close(actual, expected, **CLOSE)
    plain = FUNCTIONS[name](features, graph)
    torch.testing.assert_close(plain, FUNCTIONS[name](features, matrix), **CLOSE)
    batch = values_like(4, 2, 6, 2, seed=5)
    mapped = torch.func.vmap(lambda x: FUNCTIONS[name](x, graph))(batch)
    torch.testing.assert_close(mapped, FUNCTIONS[name](batch, matrix), **CLOSE)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_graphs_without_edges_give_zero(name):
    features = values_like(2, 6, 3).requires_grad_()
    result = FUNCTIONS[name](features, EdgeList.from_dense(torch.zeros(2, 6, 6)))
    assert (result == 0).all()
    if result.requires_grad:
        result.sum().backward()
        assert (features.grad == 0).all()


def test_single_precision_agrees():
    matrix = drawn(2, 3).float()
    features = values_like(2, 3, 6, 3).float()
    for function in FUNCTIONS.values():
        actual = function(features, EdgeList.from_dense(matrix))
        assert actual.dtype in (torch.float32, torch.float64)
        torch.testing.assert_close(actual, function(features, matrix), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("shape", [(2, 4, 6, 3), (2, 3, 5, 3), (2, 3)])
def test_frames_of_another_shape_are_refused(shape):
    graph = EdgeList.from_dense(drawn(2, 3))
    with pytest.raises(ValueError, match=r"shape \(2, 3, 6\), and the values have") as caught:
        neighbor_sum(torch.zeros(shape), graph)
    assert str(shape[:-1]) in str(caught.value)


def test_dense_returns_the_matrix():
    matrix = drawn(2)
    assert dense(matrix) is matrix
    torch.testing.assert_close(dense(EdgeList.from_dense(matrix), DOUBLE), matrix)
