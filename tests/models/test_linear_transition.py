"""Linear laws of motion: hand-worked numbers, and their own derivatives."""

import pyro.distributions as dist
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList
from swarmssm.models import LinearTransition, StepInputs
from swarmssm.models.transitions import LinearForceTransition, Transition

# Said by torch of itself, the first time that it differentiates forwards.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.torch.jit.script. is deprecated:DeprecationWarning"
)
DOUBLE = torch.float64
STEPS, INDIVIDUALS = 3, 4


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def general():
    tril = torch.tril(rand(4, 4, seed=1), -1) + torch.eye(4, dtype=DOUBLE)
    return LinearTransition(4, rand(4, 4), tril, rand(4, 4, seed=2), rand(4, seed=3))


def springs(**changed):
    options = {
        "cohesion_gain": 0.5,
        "alignment_gain": 0.25,
        "damping": 0.1,
        "process_noise": 0.2,
        "homing_gain": 0.3,
        "home": [1.0, -1.0],
    }
    return LinearForceTransition(2, 0.5, **{**options, **changed}).double()


def graphs(*leading):
    """Random graphs in which somebody sees nobody."""
    graph = (rand(*leading, INDIVIDUALS, INDIVIDUALS, seed=5) > 0).to(DOUBLE)
    graph[..., 1, :] = 0
    return graph * (1 - torch.eye(INDIVIDUALS, dtype=DOUBLE))


def test_linear_transition_by_hand():
    """Two individuals, the first of which sees the second."""
    matrix = torch.tensor([[1.0, 0.5], [0.0, 0.8]])
    coupling = torch.tensor([[0.1, 0.0], [0.2, 0.4]])
    offset = torch.tensor([0.0, 1.0])
    transition = LinearTransition(2, matrix, 2.0, coupling, offset)
    states = torch.tensor([[1.0, 2.0], [3.0, 0.0]])
    following = transition(states, StepInputs(torch.tensor([[0.0, 1.0], [0.0, 0.0]])))
    # F z + b = (2, 2.6) and (3, 1); the first is (2, -2) away from its neighbour: G of it is
    # (0.2, -0.4).
    torch.testing.assert_close(following.mean, torch.tensor([[2.2, 2.2], [3.0, 1.0]]))
    torch.testing.assert_close(following.covariance_matrix[0], 4.0 * torch.eye(2))
    alone = transition(states, StepInputs())
    torch.testing.assert_close(alone.mean, torch.tensor([[2.0, 2.6], [3.0, 1.0]]))


def test_linear_forces_by_hand():
    """Three individuals, the first of which sees the others; the last is at home."""
    positions = torch.tensor([[0.0, 0.0], [2.0, 0.0], [1.0, -1.0]], dtype=DOUBLE)
    velocities = torch.tensor([[1.0, 0.0], [0.0, 2.0], [0.0, 0.0]], dtype=DOUBLE)
    graph = torch.tensor([[0.0, 1, 1], [0, 0, 0], [0, 0, 0]], dtype=DOUBLE)
    following = springs()(torch.cat([positions, velocities], -1), StepInputs(graph))
    # Neighbours' means: position (1.5, -0.5), velocity (0, 1).
    first = 0.5 * torch.tensor([1.5, -0.5]) + 0.25 * torch.tensor([-1.0, 1.0])
    first = first - 0.1 * torch.tensor([1.0, 0.0]) + 0.3 * torch.tensor([1.0, -1.0])
    second = -0.1 * torch.tensor([0.0, 2.0]) + 0.3 * torch.tensor([-1.0, -1.0])
    force = torch.stack([first, second, torch.zeros(2)]).to(DOUBLE)
    expected = velocities + 0.5 * force
    torch.testing.assert_close(following.mean[:, 2:], expected)
    torch.testing.assert_close(following.mean[:, :2], positions + 0.5 * expected)
    variance = torch.full((3, 2), 0.04 * 0.5, dtype=DOUBLE)
    torch.testing.assert_close(following.variance[:, 2:], variance)


@pytest.mark.parametrize(
    "build",
    [general, springs, lambda: springs(cohesion_gain=rand(INDIVIDUALS), damping=rand(INDIVIDUALS))],
    ids=["general", "springs", "springs of each"],
)
@pytest.mark.parametrize("sparse", [False, True], ids=["dense", "list"])
def test_linearization_is_the_derivative(build, sparse):
    """The ready formula against forward-mode differentiation, and the mean far away."""
    transition = build()
    dense = graphs(2, STEPS)
    inputs = StepInputs(EdgeList.from_dense(dense) if sparse else dense)
    mean = rand(2, STEPS, INDIVIDUALS, 4, seed=6)
    line = transition.linearize(mean, inputs)
    judge = Transition.linearize(transition, mean, StepInputs(dense))
    for found, expected in zip(line, judge, strict=True):
        torch.testing.assert_close(found, expected.expand_as(found), rtol=1e-12, atol=1e-12)
    far = 100 * rand(2, STEPS, INDIVIDUALS, 4, seed=7)
    moved = line.mean + torch.einsum("...iajb,...jb->...ia", line.jacobian, far - mean)
    torch.testing.assert_close(transition(far, inputs).mean, moved, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("build", [general, springs])
def test_without_a_graph_everybody_is_alone(build):
    transition = build()
    mean = rand(2, INDIVIDUALS, 4)
    nobody = StepInputs(torch.zeros(INDIVIDUALS, INDIVIDUALS, dtype=DOUBLE))
    torch.testing.assert_close(
        transition(mean, StepInputs()).mean, transition(mean, nobody).mean, rtol=1e-14, atol=0
    )
    line = transition.linearize(mean, StepInputs())
    torch.testing.assert_close(line.jacobian, transition.linearize(mean, nobody).jacobian)


def test_individuals_may_differ_and_be_drawn_for():
    each = springs(alignment_gain=torch.tensor([0.0, 0.5, 1.0, 2.0]))
    graph = 1 - torch.eye(INDIVIDUALS, dtype=DOUBLE)
    states = rand(INDIVIDUALS, 4)
    found = each(states, StepInputs(graph)).mean
    for i, gain in enumerate([0.0, 0.5, 1.0, 2.0]):
        same = springs(alignment_gain=gain)(states, StepInputs(graph)).mean
        torch.testing.assert_close(found[i], same[i], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("matrix", torch.eye(3), r"matrix: it must be \(4, 4\) in shape, and it is \(3, 3\)"),
        ("offset", torch.ones(3), r"offset: it must be \(4,\) in shape, and it is \(3,\)"),
        ("coupling", dist.Normal(0.0, 1.0), r"coupling: it must be \(4, 4\) in shape"),
        ("noise_tril", torch.ones(4, 4), "noise_tril: it must be a lower triangular matrix"),
    ],
)
def test_parameters_of_other_shapes_are_refused(name, value, message):
    given = {"matrix": 1.0, "noise_tril": 1.0, name: value}
    with pytest.raises(InputError, match=message):
        LinearTransition(4, **given)


def test_springs_refuse_what_they_cannot_have():
    with pytest.raises(InputError, match="process_noise: it must be positive"):
        springs(process_noise=dist.Normal(0.0, 1.0))
    with pytest.raises(InputError, match="home"):
        springs(home=[0.0, 0.0, 0.0])
