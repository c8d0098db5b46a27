"""A list of edges is the adjacency that it was made of, whatever is done to it."""

import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList

LEADING, N = (3, 4), 5


def adjacency(seed=0, leading=LEADING, individuals=N, density=0.4):
    """Draw graphs, one frame of which has no edges."""
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.rand(*leading, individuals, individuals, generator=generator) < density
    drawn.diagonal(dim1=-2, dim2=-1).fill_(False)
    if leading:
        drawn[tuple(size // 2 for size in leading)] = False
    return drawn


def assert_same(edges, expected):
    """Hold a list against a matrix, and against the order that it must be in."""
    torch.testing.assert_close(edges.to_dense(expected.dtype), expected)
    assert edges.num_edges == int(expected.count_nonzero())
    assert edges.leading == tuple(expected.shape[:-2])
    numbers = edges.receiver * max(edges.num_nodes, 1) + edges.sender
    assert (numbers.diff() > 0).all()
    starts = edges.offsets
    degrees = expected.reshape(-1, edges.individuals).count_nonzero(-1)
    torch.testing.assert_close(starts.diff(), degrees)


def test_a_hand_written_graph():
    # Frame 0: 0 sees 2. Frame 1: none. Frame 2: 1 sees 0, 2 sees 0 and 1.
    matrix = torch.zeros(3, 3, 3)
    matrix[0, 0, 2] = matrix[2, 1, 0] = matrix[2, 2, 0] = matrix[2, 2, 1] = 1.0
    edges = EdgeList.from_dense(matrix)
    assert edges.receiver.tolist() == [0, 7, 8, 8]
    assert edges.sender.tolist() == [2, 6, 6, 7]
    assert edges.offsets.tolist() == [0, 1, 1, 1, 1, 1, 1, 1, 2, 4]
    order, receiver, offsets = edges.by_sender
    assert edges.sender[order].tolist() == [2, 6, 6, 7]
    assert receiver.tolist() == [0, 7, 8, 8]
    assert offsets.tolist() == [0, 0, 0, 1, 1, 1, 1, 3, 4, 4]
    assert (edges.num_frames, edges.num_nodes, edges.num_edges) == (3, 9, 4)
    assert edges.weight is None
    assert repr(edges) == "EdgeList(4 edges, leading=(3,), individuals=3)"


@pytest.mark.parametrize("leading", [(), (4,), (3, 4), (2, 1, 3)])
@pytest.mark.parametrize("dtype", [torch.bool, torch.uint8, torch.float64])
def test_dense_and_back(leading, dtype):
    matrix = adjacency(1, leading).to(dtype)
    assert_same(EdgeList.from_dense(matrix), matrix)


@pytest.mark.parametrize("shape", [(2, 3, 4, 4), (0, 4, 4), (2, 1, 1)])
def test_no_edges_at_all(shape):
    edges = EdgeList.from_dense(torch.zeros(shape))
    assert edges.num_edges == 0
    torch.testing.assert_close(edges.to_dense(torch.float32), torch.zeros(shape))
    order, receiver, offsets = edges.by_sender
    assert order.numel() == receiver.numel() == 0
    torch.testing.assert_close(offsets, torch.zeros(edges.num_nodes + 1, dtype=torch.long))
    if shape[0]:
        assert_same(edges[torch.tensor([0, 0])], torch.zeros(2, *shape[1:]))


def test_by_sender_turns_the_graph_round():
    matrix = adjacency(2)
    edges = EdgeList.from_dense(matrix)
    order, receiver, offsets = edges.by_sender
    assert (edges.sender[order].diff() >= 0).all()
    torch.testing.assert_close(edges.receiver[order], receiver)
    torch.testing.assert_close(offsets.diff(), matrix.sum(-2).reshape(-1))


@pytest.mark.parametrize(
    "index",
    [
        1,
        -1,
        slice(1, None),
        (slice(None), slice(0, 2)),
        (slice(None), 1),
        torch.tensor([2, 0, 2, 2]),
        torch.tensor([-1, 0]),
        torch.tensor([True, False, True]),
        torch.zeros(0, dtype=torch.long),
        torch.tensor([[0, 1], [1, 2]]),
        (torch.tensor([0, 1]), torch.tensor([3, 3])),
    ],
    ids=str,
)
def test_frames_are_indexed_like_a_tensor(index):
    matrix = adjacency(3)
    assert_same(EdgeList.from_dense(matrix)[index], matrix[index])


@pytest.mark.parametrize(("dim", "start", "stop"), [(0, 0, 2), (1, 1, 4), (-1, 2, 2), (-2, 2, 3)])
def test_select_narrows_a_dimension(dim, start, stop):
    matrix = adjacency(4)
    expected = matrix.narrow(dim % 2, start, stop - start)
    assert_same(EdgeList.from_dense(matrix).select(dim, start, stop), expected)


def test_select_refuses_frames_that_are_not_there():
    edges = EdgeList.from_dense(adjacency(4))
    with pytest.raises(RuntimeError):
        edges.select(1, 0, 5)
    with pytest.raises(IndexError):
        edges[torch.tensor([3])]


def test_frames_of_padding_have_no_edges():
    matrix = adjacency(5)
    index = torch.tensor([[11, -1, 0], [-1, 5, 0]])
    expected = matrix.reshape(12, N, N)[index.clamp(min=0)] & (index >= 0)[..., None, None]
    assert_same(EdgeList.from_dense(matrix).frames(index), expected)


def test_squeeze_and_expand():
    matrix = adjacency(6, (1, 4))
    edges = EdgeList.from_dense(matrix)
    assert_same(edges.squeeze(0), matrix[0])
    assert_same(edges.squeeze(-2), matrix[0])
    with pytest.raises(ValueError, match=r"dimension -1 of \(1, 4\) is not 1"):
        edges.squeeze(-1)
    assert edges.expand(1, 4) is edges
    assert_same(edges.expand(2, 3, 4), matrix.expand(2, 3, 4, N, N))
    with pytest.raises(RuntimeError):
        edges.expand(3, 5)


def test_between_drops_edges_at_either_end():
    matrix = adjacency(7)
    present = torch.rand(*LEADING, N, generator=torch.Generator().manual_seed(1)) < 0.6
    kept = matrix & present[..., :, None] & present[..., None, :]
    edges = EdgeList.from_dense(matrix).between(present)
    assert_same(edges, kept)
    with pytest.raises(ValueError, match=r"\(3, 4, 5\), and it is \(4, 5\)"):
        edges.between(present[0])


def weights():
    drawn = torch.rand(*LEADING, N, N, dtype=torch.float64, generator=torch.Generator())
    return torch.where(adjacency(8), drawn + 0.1, 0.0)


def test_weights_stay_with_their_edges():
    matrix = weights()
    edges = EdgeList.from_dense(matrix)
    assert_same(edges, matrix)
    assert_same(edges[torch.tensor([2, 0])], matrix[[2, 0]])
    assert_same(edges.select(1, 1, 3), matrix[:, 1:3])
    present = torch.arange(N) != 2
    both = present[:, None] & present
    assert_same(edges.between(present.expand(*LEADING, N)), matrix * both)
    mixed = torch.randperm(edges.num_edges, generator=torch.Generator().manual_seed(0))
    parts = (edges.receiver[mixed], edges.sender[mixed], LEADING, N, edges.weight[mixed])
    assert_same(EdgeList.from_pairs(*parts), matrix)


def test_gradients_flow_through_weights():
    matrix = weights().requires_grad_()
    factor = torch.arange(matrix.numel(), dtype=torch.float64).reshape(matrix.shape)
    edges = EdgeList.from_dense(matrix)[torch.tensor([0, 2])]
    (edges.to_dense() * factor[[0, 2]]).sum().backward()
    expected = torch.where(matrix.detach() > 0, factor, 0.0)
    expected[1] = 0.0
    torch.testing.assert_close(matrix.grad, expected)
    ones = adjacency(9).double().requires_grad_()
    assert EdgeList.from_dense(ones).weight.requires_grad


def test_pairs_are_sorted():
    matrix = adjacency(10)
    edges = EdgeList.from_dense(matrix)
    mixed = torch.randperm(edges.num_edges, generator=torch.Generator().manual_seed(0))
    again = EdgeList.from_pairs(
        edges.receiver[mixed].int(), edges.sender[mixed].int(), list(LEADING), N
    )
    assert_same(again, matrix)


@pytest.mark.parametrize(
    ("receiver", "sender", "message"),
    [
        ([0, 1], [1], r"shapes are \(1,\), \(2,\)"),
        ([0], [6], "whole numbers from 0 to 5"),
        ([-1], [1], "whole numbers from 0 to 5"),
        ([0.5], [1.0], "whole numbers from 0 to 5"),
        ([0], [3], "of the same frame"),
        ([0, 0], [1, 1], "only once"),
    ],
)
def test_pairs_that_make_no_graph_are_refused(receiver, sender, message):
    with pytest.raises(InputError, match=message):
        EdgeList.from_pairs(torch.tensor(receiver), torch.tensor(sender), (2,), 3)


def test_an_adjacency_that_is_not_square_is_refused():
    with pytest.raises(InputError, match=r"it is \(2, 3\)"):
        EdgeList.from_dense(torch.zeros(2, 3))


def test_another_device():
    matrix = weights()
    edges = EdgeList.from_dense(matrix)
    for moved in (edges.to("cpu"), edges.to(torch.device("cpu"))):
        assert_same(moved, matrix)
    assert edges.to("meta").receiver.device.type == edges.to("meta").weight.device.type == "meta"
