"""Kernels of distance against the boids law, automatic derivatives, symmetries and scipy."""

import math

import pytest
import torch
from scipy.interpolate import BSpline

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList
from swarmssm.models import StepInputs
from swarmssm.models.transitions import (
    BoidsTransition,
    KernelTransition,
    PowerBasis,
    SplineBasis,
    Transition,
)

# What torch itself says when it first differentiates forwards.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")

DOUBLE = torch.float64
DT = 0.1
WALL = {"wall_gain": 1.0, "half_width": 1.5, "center": 0.1}
REGULATION = {"relaxation_gain": 0.4, "preferred_speed": 1.2}


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def random_graph(*leading, individuals=5, seed=1):
    graph = (rand(*leading, individuals, individuals, seed=seed) > -0.3).to(DOUBLE)
    return graph * (1 - torch.eye(individuals, dtype=DOUBLE))


def splines(space=2, size=8, seed=3, **options):
    """Return a law with random kernels on a spline basis."""
    basis = SplineBasis(4.0, 0.5, size)
    coefficients = rand(3, size, seed=seed)
    given = {
        "attraction": coefficients[0],
        "alignment": coefficients[1],
        "repulsion": coefficients[2],
        "process_noise": torch.tensor(0.3, dtype=DOUBLE),
        **options,
    }
    return KernelTransition(space, DT, basis=basis, **given).double()


OPTIONS = {
    "plain": {},
    "one kernel along": {"repulsion": None},
    "summed": {"aggregation": "sum"},
    "by angle": {"modulation": rand(2, seed=5)},
    "senders": {"influence": rand(5, seed=6).exp()},
    "pairs and receivers": {
        "influence": rand(5, 5, seed=6).exp(),
        "responsiveness": rand(5, seed=7).exp(),
    },
    "fading view": {"radius": 1.6, "radius_width": 0.4},
    "fading view, summed": {"radius": 1.6, "radius_width": 0.4, "aggregation": "sum"},
    "sharp view": {"radius": 1.6},
    "walls and speed": {**WALL, **REGULATION},
    "all": {
        "modulation": rand(3, seed=5),
        "influence": rand(5, 5, seed=6).exp(),
        "responsiveness": rand(5, seed=7).exp(),
        "radius": 1.6,
        "radius_width": 0.4,
        **WALL,
        **REGULATION,
    },
}


@pytest.mark.parametrize("seed", [0, 1])
def test_boids_are_the_special_case_of_powers(seed):
    """F = kc r, q = -ks / r, g = ka, on any graph, with the same own terms and limits."""
    kc, ks, ka = 0.5, 0.3, 0.2
    own = {**WALL, **REGULATION, "min_speed": 0.5, "max_speed": 1.4, "process_noise": 0.3}
    boids = BoidsTransition(
        2, DT, cohesion_gain=kc, separation_gain=ks, alignment_gain=ka, **own
    ).double()
    kernel = KernelTransition(
        2,
        DT,
        basis=PowerBasis((1.0, -1.0, 0.0)),
        attraction=[kc, 0.0, 0.0],
        repulsion=[0.0, -ks, 0.0],
        alignment=[0.0, 0.0, ka],
        **own,
    ).double()
    states, inputs = rand(3, 4, 5, 4, seed=seed), StepInputs(random_graph(3, 4, seed=seed + 10))
    assert boids.terms == kernel.terms
    # Single precision in the gains, from which both are made.
    close = {"rtol": 1e-6, "atol": 1e-7}
    torch.testing.assert_close(kernel.forces(states, inputs), boids.forces(states, inputs), **close)
    torch.testing.assert_close(kernel(states, inputs).mean, boids(states, inputs).mean, **close)
    covariance = 0.01 * torch.eye(4, dtype=DOUBLE).expand(3, 4, 5, 4, 4)
    for ours, theirs in zip(
        kernel.linearize(states, inputs, covariance),
        boids.linearize(states, inputs, covariance),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs, **close)
    distance = torch.tensor([0.2, 1.0, 3.0], dtype=DOUBLE)
    for name, values in boids.kernels(distance).items():
        torch.testing.assert_close(kernel.kernels(distance)[name], values, **close)
    assert boids.kernel_kinds == kernel.kernel_kinds


@pytest.mark.parametrize("exponent", [0.5, 2.0])
def test_other_exponents_are_other_powers(exponent):
    boids = BoidsTransition(
        3,
        DT,
        cohesion_gain=0.0,
        separation_gain=0.3,
        alignment_gain=0.0,
        exponent=exponent,
        process_noise=0.1,
    )
    kernel = KernelTransition(
        3,
        DT,
        basis=PowerBasis((-exponent,)),
        attraction=[0.0],
        repulsion=[-0.3],
        alignment=[0.0],
        process_noise=0.1,
    )
    states, inputs = rand(4, 5, 6).float(), StepInputs(random_graph(4).float())
    torch.testing.assert_close(
        kernel.forces(states, inputs), boids.forces(states, inputs), rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("name", OPTIONS)
def test_closed_form_is_the_automatic_derivative(name, space):
    """Both to rounding: the base class differentiates the mean of forward, by other code."""
    law = splines(space, **OPTIONS[name])
    states = rand(2, 5, 2 * space, seed=11)
    inputs = StepInputs(random_graph(2))
    automatic = Transition.linearize(law, states, inputs)
    closed = law.linearize(states, inputs)
    for ours, theirs in zip(closed, automatic, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("name", OPTIONS)
def test_edges_and_matrix_give_the_same_forces(name):
    law = splines(**OPTIONS[name])
    states, graph = rand(3, 5, 4, seed=2), random_graph(3)
    listed = law.forces(states, StepInputs(EdgeList.from_dense(graph)))
    torch.testing.assert_close(listed, law.forces(states, StepInputs(graph)))


@pytest.mark.parametrize("name", OPTIONS)
def test_terms_add_up_to_the_acceleration(name):
    law = splines(**OPTIONS[name])
    states, inputs = rand(3, 5, 4, seed=2), StepInputs(random_graph(3))
    change = (law(states, inputs).mean - states)[..., 2:] / DT
    torch.testing.assert_close(law.forces(states, inputs).sum(-3), change)


@pytest.mark.parametrize("space", [2, 3])
def test_turned_mirrored_and_moved_groups_do_the_same(space):
    """Social forces are equivariant under all of E(n)."""
    options = {k: v for k, v in OPTIONS["all"].items() if k not in WALL}
    law = splines(space, **options)
    turn, _ = torch.linalg.qr(rand(space, space, seed=4))
    states, inputs = rand(3, 5, 2 * space, seed=2), StepInputs(random_graph(3))
    for matrix in (turn, turn * torch.tensor([-1.0] + [1.0] * (space - 1), dtype=DOUBLE)):
        position = states[..., :space] @ matrix.T + 7.0
        image = torch.cat([position, states[..., space:] @ matrix.T], -1)
        expected = law.forces(states, inputs) @ matrix.T
        torch.testing.assert_close(law.forces(image, inputs), expected)


def test_forces_of_two_individuals_are_those_worked_out_by_hand():
    """0 sees 1, two ahead of it; f = r - 1/r, g = 0.5; M = 1 + 0.5 cos(angle)."""
    law = KernelTransition(
        2,
        DT,
        basis=PowerBasis((1.0, -1.0, 0.0)),
        attraction=[1.0, -1.0, 0.0],
        alignment=[0.0, 0.0, 0.5],
        modulation=[0.5],
        influence=[1.0, 3.0],
        process_noise=0.1,
    ).double()
    states = torch.tensor([[0.0, 0.0, 1.0, 0.0], [2.0, 0.0, 0.0, 1.0]], dtype=DOUBLE)
    sees = torch.tensor([[0.0, 1.0], [1.0, 0.0]], dtype=DOUBLE)
    # 0: angle 0, M = 1.5, weight 3, f(2) = 1.5. 1: its heading is across, M = 1, weight 1.
    forces = law.forces(states, StepInputs(sees))
    expected = torch.tensor(
        [
            [[6.75, 0.0], [-1.5, 0.0]],
            [[0.0, 0.0], [0.0, 0.0]],
            [[-2.25, 2.25], [0.5, -0.5]],
        ],
        dtype=DOUBLE,
    )
    torch.testing.assert_close(forces, expected)


def test_without_repulsion_the_sign_says_separation_or_cohesion():
    law = KernelTransition(
        2,
        DT,
        basis=PowerBasis((1.0, -1.0)),
        attraction=[1.0, -1.0],
        alignment=[0.0, 0.0],
        process_noise=0.1,
    ).double()
    states = torch.tensor(
        [[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0]], dtype=DOUBLE
    )
    sees = torch.tensor([[0.0, 1.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], dtype=DOUBLE)
    cohesion, separation, _ = law.forces(states, StepInputs(sees))[:, 0]
    torch.testing.assert_close(cohesion, torch.tensor([0.75, 0.0], dtype=DOUBLE))
    torch.testing.assert_close(separation, torch.tensor([0.0, -0.75], dtype=DOUBLE))


def test_who_sees_nobody_or_stands_on_another_feels_nothing_and_stays_finite():
    law = splines(**OPTIONS["all"] | {"influence": None, "responsiveness": None})
    states = torch.zeros(3, 4, dtype=DOUBLE, requires_grad=True)
    sees = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], dtype=DOUBLE)
    forces = law.forces(states, StepInputs(sees))
    assert (forces[:3] == 0).all()
    line = law.linearize(states, StepInputs(sees))
    (line.mean.sum() + line.jacobian.sum()).backward()
    assert states.grad is not None
    assert states.grad.isfinite().all()


def test_splines_are_those_of_scipy():
    """On the stretched axis log(1 + r / near), with the slope by the chain rule."""
    reach, near, size = 4.0, 0.5, 9
    basis = SplineBasis(reach, near, size)
    coefficients = rand(2, size)
    distance = torch.linspace(1e-3, reach - 1e-3, 50, dtype=DOUBLE)
    found = basis.double()(distance, coefficients)
    count = size - 3
    stretch = count / math.log1p(reach / near)
    place = stretch * torch.log1p(distance / near)
    for row in range(2):
        spline = BSpline(range(-3, size + 1), coefficients[row].numpy(), 3)
        # The constants are 1/6 in double precision on both sides.
        expected = torch.from_numpy(spline(place.numpy()))
        torch.testing.assert_close(found.value[:, row], expected, rtol=1e-10, atol=1e-12)
        slope = torch.from_numpy(spline.derivative()(place.numpy())) * stretch / (near + distance)
        torch.testing.assert_close(found.slope[:, row], slope, rtol=1e-10, atol=1e-12)


def test_beyond_the_reach_a_spline_goes_on_level():
    basis = SplineBasis(4.0, 0.5, 6).double()
    far = basis(torch.tensor([4.0, 5.0, 50.0], dtype=DOUBLE), rand(1, 6))
    torch.testing.assert_close(far.value, far.value[:1].expand(3, 1))
    assert (far.slope == 0).all()


def test_splines_are_highest_where_they_say():
    basis = SplineBasis(4.0, 0.5, 9).double()
    distance = torch.linspace(1e-4, 4.0, 20001, dtype=DOUBLE)
    values = basis(distance, torch.eye(9, dtype=DOUBLE)).value
    step = float(distance[1] - distance[0])
    for index in range(9):
        highest = distance[values[:, index].argmax()]
        assert abs(float(highest) - float(basis.heights[index])) <= step + 1e-4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"aggregation": "median"}, "aggregation: it must be 'mean' or 'sum'"),
        ({"attraction": [1.0, 2.0]}, "attraction: it must be .* in shape"),
        ({"influence": -torch.ones(5, dtype=DOUBLE)}, "influence: it must be"),
        ({"wall_gain": 1.0}, "half_width: with a wall_gain it must be given"),
    ],
)
def test_what_a_law_cannot_be_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        splines(**options)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((0.0, 1.0, 8), "reach: it must be a positive length"),
        ((1.0, math.inf, 8), "near: it must be a positive length"),
        ((1.0, 1.0, 3), "at least 4 basis functions"),
    ],
)
def test_what_a_basis_cannot_be_is_refused(given, words):
    with pytest.raises(InputError, match=words):
        SplineBasis(*given)
