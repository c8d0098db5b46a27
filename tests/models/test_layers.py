"""Hold the graph layers against another library, hand-worked numbers and relabelled groups."""

import math
import warnings
from types import SimpleNamespace

import pytest
import torch

from swarmssm.graphs import normalized_adjacency
from swarmssm.models.layers import (
    GatedGraphLayer,
    GraphConvolution,
    fan_in_uniform_,
    multilayer_perceptron,
)

DOUBLE = torch.float64
#: Sums of at most some tens of numbers of size one, in float64.
CLOSE = {"rtol": 1e-6, "atol": 1e-12}


def draw(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def directed_graph(*shape, seed=1):
    """Return a graph that is not symmetric, some rows and columns of which are empty."""
    size = shape[-1]
    adjacency = (draw(*shape, size, seed=seed) > 0.5).to(DOUBLE)
    adjacency.diagonal(dim1=-2, dim2=-1).zero_()
    adjacency[..., 0, :] = 0.0
    adjacency[..., :, 1] = 0.0
    return adjacency


@pytest.fixture(scope="module")
def geometric():
    with warnings.catch_warnings():
        # It uses functions of torch that are going out of use.
        warnings.simplefilter("ignore")
        nn = pytest.importorskip("torch_geometric.nn", reason="torch_geometric judges the layers")
        utils = pytest.importorskip("torch_geometric.utils")
        return SimpleNamespace(nn=nn, utils=utils)


def edge_index(geometric, adjacency):
    """Return edges from source to target: i receives from j where ``adjacency[i, j]`` is 1."""
    index, weight = geometric.utils.dense_to_sparse(adjacency.T)
    assert (weight == 1).all()
    return index


@pytest.mark.parametrize(("features", "rounds"), [(3, 1), (5, 1), (3, 4)])
def test_gated_layer_agrees_with_torch_geometric(geometric, features, rounds):
    layer = GatedGraphLayer(features, 5, rounds).to(DOUBLE)
    theirs = geometric.nn.GatedGraphConv(5, rounds).to(DOUBLE)
    with torch.no_grad():
        theirs.weight.copy_(layer.weight)
        for name, value in layer.unit.named_parameters():
            value.uniform_(-1.0, 1.0)  # the biases too, which start at zero
            getattr(theirs.rnn, name).copy_(value)
    nodes, adjacency = draw(4, 7, features), directed_graph(4, 7)
    ours = layer(nodes, adjacency)
    for x, graph, out in zip(nodes, adjacency, ours, strict=True):
        torch.testing.assert_close(out, theirs(x, edge_index(geometric, graph)), **CLOSE)
    # The judge notices the direction of the edges.
    reverse = theirs(nodes[0], edge_index(geometric, adjacency[0].T))
    assert (ours[0] - reverse).abs().max() > 0.01


def test_convolution_agrees_with_torch_geometric(geometric):
    layer = GraphConvolution(3, 5, self_weight=False).to(DOUBLE)
    theirs = geometric.nn.GCNConv(3, 5).to(DOUBLE)
    with torch.no_grad():
        layer.bias.uniform_(-1.0, 1.0)
        theirs.lin.weight.copy_(layer.neighbor.weight)
        theirs.bias.copy_(layer.bias)
    nodes, adjacency = draw(4, 7, 3), directed_graph(4, 7)
    ours = layer(nodes, normalized_adjacency(adjacency))
    for x, graph, out in zip(nodes, adjacency, ours, strict=True):
        torch.testing.assert_close(out, theirs(x, edge_index(geometric, graph)), **CLOSE)
    reverse = theirs(nodes[0], edge_index(geometric, adjacency[0].T))
    assert (ours[0] - reverse).abs().max() > 0.01


@pytest.mark.parametrize("self_weight", [True, False])
def test_convolution_by_hand(self_weight):
    """Three nodes, one feature, (3.7) and (3.8): 0 hears 1 and 2, 1 hears 0, 2 hears nobody."""
    layer = GraphConvolution(1, 1, self_weight=self_weight).to(DOUBLE)
    with torch.no_grad():
        layer.neighbor.weight.fill_(2.0)
        layer.bias.fill_(0.5)
        if self_weight:
            layer.own.weight.fill_(10.0)
    adjacency = torch.tensor([[0.0, 1, 1], [1, 0, 0], [0, 0, 0]], dtype=DOUBLE)
    nodes = torch.tensor([[1.0], [-3.0], [4.0]], dtype=DOUBLE)
    # Degrees with self-loops: 3, 2 and 1. c_ij is 1 / sqrt(degree_i degree_j) where j is heard.
    summed = [
        1.0 / 3 - 3.0 / math.sqrt(6) + 4.0 / math.sqrt(3),
        1.0 / math.sqrt(6) - 3.0 / 2,
        4.0,
    ]
    own = [10.0, -30.0, 40.0] if self_weight else [0.0, 0.0, 0.0]
    expected = [[o + 2.0 * s + 0.5] for o, s in zip(own, summed, strict=True)]
    out = layer(nodes, normalized_adjacency(adjacency))
    torch.testing.assert_close(out, torch.tensor(expected, dtype=DOUBLE), **CLOSE)


def test_without_own_weight_those_who_all_see_each_other_become_equal():
    nodes = draw(4, 3)
    complete = normalized_adjacency(1.0 - torch.eye(4, dtype=DOUBLE))
    merged = GraphConvolution(3, 2, self_weight=False).to(DOUBLE)(nodes, complete)
    torch.testing.assert_close(merged, merged[:1].expand(4, 2), **CLOSE)
    apart = GraphConvolution(3, 2).to(DOUBLE)(nodes, complete)
    assert (apart - apart[:1]).abs()[1:].amin() > 1e-3


def test_gated_layer_by_hand():
    """One feature and one round: two nodes, 0 hears 1 and nobody hears 0."""
    layer = GatedGraphLayer(1, 1).to(DOUBLE)
    with torch.no_grad():
        layer.weight.fill_(3.0)
        # Rows of torch's unit: reset, update (share of the old state that is kept), candidate.
        layer.unit.weight_ih.copy_(torch.tensor([[0.1], [0.2], [0.3]]))
        layer.unit.weight_hh.copy_(torch.tensor([[-0.4], [0.5], [0.6]]))
        layer.unit.bias_ih.zero_()
        layer.unit.bias_hh.zero_()
    adjacency = torch.tensor([[0.0, 1.0], [0.0, 0.0]], dtype=DOUBLE)
    nodes = torch.tensor([[0.7], [-1.1]], dtype=DOUBLE)
    expected = []
    for state, message in ((0.7, 3.0 * -1.1), (-1.1, 0.0)):
        reset = 1 / (1 + math.exp(-(0.1 * message - 0.4 * state)))
        keep = 1 / (1 + math.exp(-(0.2 * message + 0.5 * state)))
        candidate = math.tanh(0.3 * message + reset * 0.6 * state)
        expected.append([(1 - keep) * candidate + keep * state])
    # The 0.1 and so on were copied from float32.
    torch.testing.assert_close(
        layer(nodes, adjacency), torch.tensor(expected, dtype=DOUBLE), rtol=1e-6, atol=1e-7
    )


@pytest.mark.parametrize("kind", ["gated", "convolution", "without own weight"])
def test_relabelling_individuals_relabels_the_result(kind):
    nodes, adjacency = draw(2, 3, 6, 4), directed_graph(2, 3, 6)
    order = torch.tensor([3, 0, 5, 1, 4, 2])
    if kind == "gated":
        layer = GatedGraphLayer(4, 5, 2).to(DOUBLE)

        def run(x, a):
            return layer(x, a)
    else:
        convolution = GraphConvolution(4, 5, self_weight=kind == "convolution").to(DOUBLE)

        def run(x, a):
            return convolution(x, normalized_adjacency(a))

    relabelled = run(nodes[..., order, :], adjacency[..., order, :][..., order])
    torch.testing.assert_close(relabelled, run(nodes, adjacency)[..., order, :], **CLOSE)


@pytest.mark.parametrize("seed", range(3))
def test_initial_weights_fill_their_range(seed):
    """(3.60): uniform within 1 / sqrt(columns), so with that mean and variance; biases zero."""
    torch.manual_seed(seed)
    network = torch.nn.Sequential(torch.nn.Linear(25, 400), torch.nn.Linear(400, 100))
    fan_in_uniform_(network)
    for layer, bound in zip(network, (1 / 5, 1 / 20), strict=True):
        weights = layer.weight.detach().to(DOUBLE)
        assert (layer.bias == 0).all()
        assert weights.abs().max() <= bound * (1 + 1e-6)  # rounded to float32
        # The largest of n uniform numbers is within 20 / n of the bound but for e^-20.
        assert weights.abs().max() > bound * (1 - 20 / weights.numel())
        deviation = bound / math.sqrt(3)
        assert weights.mean().abs() < 6 * deviation / math.sqrt(weights.numel())
        # The variance of x^2 is 4 / 45 bound^4.
        error = 6 * math.sqrt(4 / 45 / weights.numel()) * bound**2
        assert abs((weights**2).mean() - deviation**2) < error


def test_all_layers_start_so():
    gated, plain = GatedGraphLayer(2, 9, 3), multilayer_perceptron([4, 16, 2])
    convolution = GraphConvolution(9, 4)
    bounds = [
        (gated.weight, 1 / 3),
        (gated.unit.weight_ih, 1 / 3),
        (gated.unit.weight_hh, 1 / 3),
        (plain[0].weight, 1 / 2),
        (plain[2].weight, 1 / 4),
        (convolution.own.weight, 1 / 3),
        (convolution.neighbor.weight, 1 / 3),
    ]
    for weights, bound in bounds:
        # At least 32 numbers each: their largest is above half the bound but for 2^-32.
        assert bound / 2 < weights.abs().max() <= bound * (1 + 1e-6)
    for bias in (gated.unit.bias_ih, gated.unit.bias_hh, plain[0].bias, convolution.bias):
        assert (bias == 0).all()


def test_perceptron_is_linear_after_the_last_layer_alone():
    network = multilayer_perceptron([3, 8, 2])
    kinds = [type(part).__name__ for part in network]
    assert kinds == ["Linear", "ReLU", "Linear"]
    x = draw(5, 3).float()
    hidden = (x @ network[0].weight.T + network[0].bias).clamp(min=0)
    expected = hidden @ network[2].weight.T + network[2].bias
    torch.testing.assert_close(network(x), expected)
    assert [type(part).__name__ for part in multilayer_perceptron([3, 2])] == ["Linear"]


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: GatedGraphLayer(4, 3), r"out_features \(3\) must be at least 4"),
        (lambda: GatedGraphLayer(4, 5, 0), "num_rounds must be a positive whole number, not 0"),
        (lambda: GraphConvolution(0, 5), "in_features must be a positive whole number, not 0"),
        (lambda: GraphConvolution(4, 2.5), r"out_features must be .* not 2\.5"),
        (lambda: multilayer_perceptron([4, True, 2]), r"widths\[1\] must be .* not True"),
        (lambda: multilayer_perceptron([4]), "at least two"),
    ],
)
def test_sizes_that_are_none_are_refused(build, sentence):
    with pytest.raises(ValueError, match=sentence):
        build()
