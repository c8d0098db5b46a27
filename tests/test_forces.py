"""Hold the boids terms against numbers worked out by hand, and against their symmetries."""

import math

import pytest
import torch

from swarmssm import forces
from swarmssm.graphs import EdgeList

NAN = math.nan
# 0 sees 1 and 2; 1 sees 0; 2 sees nobody.
POSITIONS = torch.tensor([[0.0, 0.0], [3.0, 4.0], [1.0, 0.0]], dtype=torch.float64)
VELOCITIES = torch.tensor([[1.0, 0.0], [0.0, 2.0], [2.0, 2.0]], dtype=torch.float64)
ADJACENCY = torch.tensor([[0, 1, 1], [1, 0, 0], [0, 0, 0]], dtype=torch.uint8)


def close(actual, expected):
    expected = torch.tensor(expected, dtype=torch.float64)
    torch.testing.assert_close(actual, expected, rtol=1e-12, atol=1e-12)


def test_cohesion_points_to_the_mean_of_the_neighbours():
    close(forces.cohesion(POSITIONS, ADJACENCY), [[2.0, 2.0], [-3.0, -4.0], [0.0, 0.0]])


@pytest.mark.parametrize(
    ("exponent", "expected"),
    [
        # From (3, 4) at distance 5: -(3, 4) / 5 ** (n + 1); from (1, 0): -(1, 0).
        (1, [[-3 / 25 - 1, -4 / 25], [3 / 25, 4 / 25], [0.0, 0.0]]),
        (2, [[-3 / 125 - 1, -4 / 125], [3 / 125, 4 / 125], [0.0, 0.0]]),
        (0, [[-3 / 5 - 1, -4 / 5], [3 / 5, 4 / 5], [0.0, 0.0]]),
    ],
)
def test_separation_falls_with_the_distance(exponent, expected):
    close(forces.separation(POSITIONS, ADJACENCY, exponent), expected)


def test_separation_takes_an_exponent_for_each_individual():
    exponents = torch.tensor([2.0, 1.0, 1.0], dtype=torch.float64)
    expected = [[-3 / 125 - 1, -4 / 125], [3 / 25, 4 / 25], [0.0, 0.0]]
    close(forces.separation(POSITIONS, ADJACENCY, exponents), expected)


def test_softening_bounds_the_push():
    # d ** 2 + s ** 2 = 25 + 75 = 100, and 1 + 75 = 76.
    softened = forces.separation(POSITIONS, ADJACENCY, softening=math.sqrt(75.0))
    close(softened, [[-0.03 - 1 / 76, -0.04], [0.03, 0.04], [0.0, 0.0]])


def test_alignment_is_the_mean_velocity_or_the_difference_from_it():
    close(
        forces.alignment(VELOCITIES, ADJACENCY, relative=False),
        [[1.0, 2.0], [1.0, 0.0], [0.0, 0.0]],
    )
    relative = forces.alignment(VELOCITIES, ADJACENCY)
    close(relative, [[0.0, 2.0], [1.0, -2.0], [0.0, 0.0]])


def test_weights_make_weighted_means():
    weights = torch.tensor([[0.0, 0.25, 0.75], [0.5, 0, 0], [0, 0, 0]], dtype=torch.float64)
    # 0.25 * (3, 4) + 0.75 * (1, 0); a single neighbour's weight cancels from its mean.
    close(forces.cohesion(POSITIONS, weights), [[1.5, 1.0], [-3.0, -4.0], [0.0, 0.0]])
    pushed = forces.separation(POSITIONS, weights)
    close(pushed, [[-0.03 - 0.75, -0.04], [0.06, 0.08], [0.0, 0.0]])


def test_wall_pushes_back_only_outside():
    positions = torch.tensor([[5.0, -4.5], [3.9, -3.9], [4.0, 0.0]], dtype=torch.float64)
    close(forces.wall(positions, 4.0), [[-1.0, 0.5], [0.0, 0.0], [0.0, 0.0]])
    halves, center = torch.tensor([1.0, 2.0]), torch.tensor([3.0, -2.0])
    close(forces.wall(positions, halves, center), [[-1.0, 0.5], [0.0, 0.0], [0.0, 0.0]])


def test_wall_around_a_moved_center():
    positions = torch.tensor([[12.5, 4.0], [9.0, 9.0]], dtype=torch.float64)
    close(forces.wall(positions, 2.0, 10.0), [[-0.5, 4.0], [0.0, 0.0]])


def test_speed_regulation_is_along_the_velocity():
    velocities = torch.tensor([[3.0, 4.0], [0.0, 0.5], [0.0, 0.0]], dtype=torch.float64)
    close(forces.speed_regulation(velocities, 1.0), [[-2.4, -3.2], [0.0, 0.5], [0.0, 0.0]])
    each = torch.tensor([10.0, 0.5, 1.0], dtype=torch.float64)
    close(forces.speed_regulation(velocities, each), [[3.0, 4.0], [0.0, 0.0], [0.0, 0.0]])


def test_three_dimensions():
    positions = torch.tensor([[0.0, 0, 0], [2, 3, 6]], dtype=torch.float64)  # 7 apart
    both = torch.tensor([[0, 1], [1, 0]])
    close(forces.cohesion(positions, both), [[2, 3, 6], [-2, -3, -6]])
    pushed = [[-2 / 49, -3 / 49, -6 / 49], [2 / 49, 3 / 49, 6 / 49]]
    close(forces.separation(positions, both), pushed)
    close(forces.wall(positions, 2.5), [[0, 0, 0], [0, -0.5, -3.5]])


def test_an_absent_individual_is_left_out_and_gets_nothing():
    positions = torch.tensor([[0.0, 0.0], [NAN, NAN], [1.0, 0.0]], dtype=torch.float64)
    velocities = torch.tensor([[1.0, 0.0], [0.0, NAN], [2.0, 2.0]], dtype=torch.float64)
    complete = 1 - torch.eye(3)
    close(forces.cohesion(positions, complete), [[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]])
    close(forces.separation(positions, complete), [[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    aligned = forces.alignment(velocities, complete)
    close(aligned, [[1.0, 2.0], [0.0, 0.0], [-1.0, -2.0]])
    # A velocity rule needs the neighbours' velocities alone.
    close(
        forces.alignment(velocities, complete, relative=False), [[2.0, 2.0], [1.5, 1.0], [1.0, 0.0]]
    )
    close(forces.wall(positions, 0.5), [[0.0, 0.0], [0.0, 0.0], [-0.5, 0.0]])
    regulated = forces.speed_regulation(velocities, 2.0)
    close(regulated[:2], [[1.0, 0.0], [0.0, 0.0]])


def terms(positions, velocities, adjacency):
    """Return every term of one state, stacked."""
    return torch.stack(
        [
            forces.cohesion(positions, adjacency),
            forces.separation(positions, adjacency, 1.5),
            forces.alignment(velocities, adjacency, relative=True),
            forces.alignment(velocities, adjacency, relative=False),
            forces.wall(positions, 0.3),
            forces.speed_regulation(velocities, 0.7),
        ]
    )


def test_gradients_are_finite_where_values_are_not_defined():
    """Coincident, resting, lonely and absent individuals at once."""
    positions = torch.tensor([[1.0, 1], [1, 1], [NAN, NAN], [2, 1]], dtype=torch.float64)
    velocities = torch.tensor([[0.0, 0], [1, 0], [NAN, NAN], [0, 0]], dtype=torch.float64)
    adjacency = torch.tensor([[0, 1, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 0, 0, 0.0]])
    inputs = [t.requires_grad_() for t in (positions, velocities, adjacency)]
    result = terms(*inputs)
    assert result.isfinite().all()
    result.sum().backward()
    for tensor in inputs:
        assert tensor.grad.isfinite().all()
    # The two at the same place do not push each other; the third pushes 1 along -x.
    close(forces.separation(*inputs[::2])[:2].detach(), [[0.0, 0.0], [-1.0, 0.0]])


def test_gradients_agree_with_finite_differences():
    generator = torch.Generator().manual_seed(3)
    positions, velocities = torch.randn(2, 2, 4, 3, dtype=torch.float64, generator=generator)
    adjacency = torch.rand(2, 4, 4, dtype=torch.float64, generator=generator)
    inputs = [t.requires_grad_() for t in (positions, velocities, adjacency)]
    assert torch.autograd.gradcheck(terms, inputs)


def rotation(space, generator):
    """Return a random proper or improper rotation."""
    drawn = torch.randn(space, space, dtype=torch.float64, generator=generator)
    return torch.linalg.qr(drawn).Q


@pytest.mark.parametrize("space", [2, 3])
def test_terms_turn_with_the_swarm_and_follow_its_relabelling(space):
    generator = torch.Generator().manual_seed(space)
    draw = {"dtype": torch.float64, "generator": generator}
    positions, velocities = torch.randn(2, 5, 6, space, **draw)
    adjacency = (torch.rand(5, 6, 6, **draw) < 0.5) & ~torch.eye(6, dtype=torch.bool)
    turn, shift = rotation(space, generator), torch.randn(space, **draw)
    order = torch.randperm(6, generator=generator)

    def social(p, v, a):
        """Return all terms but the wall, which stands still."""
        return terms(p, v, a)[[0, 1, 2, 3, 5]]

    before = social(positions, velocities, adjacency)
    turned = social(positions @ turn + shift, velocities @ turn, adjacency)
    # Rounding: sums of six terms of order 10, of numbers of order 1.
    torch.testing.assert_close(turned, before @ turn, rtol=0, atol=1e-11)
    relabelled = social(positions[:, order], velocities[:, order], adjacency[:, order][:, :, order])
    torch.testing.assert_close(relabelled, before[..., order, :], rtol=0, atol=1e-11)


def test_a_mutual_graph_conserves_momentum():
    """What i and j do to each other by separation cancels, so its sum is 0."""
    generator = torch.Generator().manual_seed(0)
    positions = torch.randn(8, 2, dtype=torch.float64, generator=generator)
    complete = 1 - torch.eye(8)
    total = forces.separation(positions, complete, 1.0).sum(0)
    torch.testing.assert_close(total, torch.zeros(2, dtype=torch.float64), rtol=0, atol=1e-11)


def test_leading_dimensions_broadcast():
    positions = torch.stack([POSITIONS, 2 * POSITIONS])
    together = forces.separation(positions, ADJACENCY)
    torch.testing.assert_close(together[1], forces.separation(2 * POSITIONS, ADJACENCY))
    each = forces.cohesion(POSITIONS, torch.stack([ADJACENCY, ADJACENCY.T]))
    torch.testing.assert_close(each[1], forces.cohesion(POSITIONS, ADJACENCY.T))


FRAMES = [((), ()), ((3,), (3,)), ((3,), (2, 3)), ((), (2, 3))]


@pytest.mark.parametrize(("graphs", "frames"), FRAMES, ids=str)
@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("weighted", [False, True])
def test_a_list_of_edges_gives_the_same_terms_and_gradients(graphs, frames, space, weighted):
    """With coincident, lonely and absent individuals among them."""
    generator = torch.Generator().manual_seed(5)
    positions, velocities = torch.randn(
        2, *frames, 6, space, dtype=torch.float64, generator=generator
    )
    positions[..., 1, :] = positions[..., 0, :]
    positions[..., 2, 0] = velocities[..., 2, 0] = NAN
    adjacency = torch.rand(*graphs, 6, 6, dtype=torch.float64, generator=generator)
    adjacency = torch.where(adjacency < 0.6, adjacency if weighted else 1.0, 0.0)
    adjacency.diagonal(dim1=-2, dim2=-1).zero_()
    adjacency[..., 3, :] = 0.0
    results, gradients = [], []
    for kind in (lambda matrix: matrix, EdgeList.from_dense):
        leaves = [t.clone().requires_grad_() for t in (positions, velocities)]
        weight = adjacency.clone().requires_grad_(weighted)
        result = terms(*leaves, kind(weight))
        results.append(result.detach())
        result.square().sum().backward()
        gradients.append([leaf.grad for leaf in leaves])
        if weighted:
            # An entry of 0 is no edge, and a list has no gradient for it.
            gradients[-1].append(torch.where(adjacency > 0, weight.grad, 0.0))
    close(results[1], results[0].tolist())
    for one, other in zip(*gradients, strict=True):
        assert one.isfinite().all()
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-10)


def test_each_individual_may_have_its_exponent_on_a_list_of_edges():
    edges = EdgeList.from_dense(ADJACENCY)
    exponents = torch.tensor([2.0, 1.0, 1.0], dtype=torch.float64, requires_grad=True)
    expected = [[-3 / 125 - 1, -4 / 125], [3 / 25, 4 / 25], [0.0, 0.0]]
    pushed = forces.separation(POSITIONS, edges, exponents)
    close(pushed.detach(), expected)
    # d/dn of 3 / 5 ** (n + 1), and so on: -log(5) times the push from (3, 4).
    (slope,) = torch.autograd.grad(pushed[1, 0], exponents)
    close(slope, [0.0, -math.log(5.0) * 3 / 25, 0.0])
    draws = torch.stack([exponents, torch.ones(3, dtype=torch.float64)])
    both = forces.separation(POSITIONS.expand(2, 3, 2), edges, draws)
    close(both[0].detach(), expected)
    close(both[1].detach(), forces.separation(POSITIONS, ADJACENCY).tolist())
    softened = forces.separation(POSITIONS, edges, softening=math.sqrt(75.0))
    close(softened, [[-0.03 - 1 / 76, -0.04], [0.03, 0.04], [0.0, 0.0]])
