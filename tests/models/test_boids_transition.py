"""The boids law against hand-worked numbers, the simulator, and automatic derivatives."""

import itertools
import math

import pyro
import pyro.distributions as dist
import pytest
import torch
from oracles.radius_grid import RadiusGridModel
from pyro import poutine
from pyro.infer.autoguide import AutoMultivariateNormal

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList
from swarmssm.models import InitialStates, LatentEdges, StateSpaceModel, StepInputs, SwarmBatch
from swarmssm.models.distributions.speed_limits import limit_speed
from swarmssm.models.parameters import fixed
from swarmssm.models.transitions import BoidsTransition, Hierarchical, KinematicTransition
from swarmssm.simulate import dynamics_of, simulate_boids

# What torch itself says when it first differentiates forwards.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")

DOUBLE = torch.float64
DT = 0.1
GAINS = {"cohesion_gain": 0.5, "separation_gain": 0.3, "alignment_gain": 0.2}
WALL = {"wall_gain": 1.0, "half_width": 4.0}
REGULATION = {"relaxation_gain": 0.4, "preferred_speed": 1.2}
LIMITS = {"min_speed": 0.6, "max_speed": 1.2}


def law(space=2, **options):
    """Return the law with its numbers in double precision, not rounded before."""
    torch.set_default_dtype(DOUBLE)
    try:
        return BoidsTransition(space, DT, **{**GAINS, "process_noise": 0.3, **options})
    finally:
        torch.set_default_dtype(torch.float32)


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def random_graph(*leading, individuals=5, seed=1):
    graph = (rand(*leading, individuals, individuals, seed=seed) > 0).to(DOUBLE)
    return graph * (1 - torch.eye(individuals, dtype=DOUBLE))


def tensor(*values):
    return torch.tensor(values, dtype=DOUBLE)


PAIR = tensor([0.0, 0.0, 1.0, 0.0], [2.0, 0.0, 0.0, 1.0])
ONE_SEES = StepInputs(tensor([0.0, 1.0], [0.0, 0.0]))


def test_forces_of_two_individuals_are_those_worked_out_by_hand():
    """0 sees 1, two to the right of it; 1 sees nobody, is outside the wall, and too fast."""
    motion = law(wall_gain=2.0, half_width=1.5, **REGULATION)
    assert motion.terms == ("cohesion", "separation", "alignment", "wall", "speed_regulation")
    found = motion.forces(PAIR, ONE_SEES)
    expected = torch.zeros(5, 2, 2, dtype=DOUBLE)
    expected[0, 0] = 0.5 * tensor(2.0, 0.0)
    expected[1, 0] = 0.3 * tensor(-0.5, 0.0)
    expected[2, 0] = 0.2 * tensor(-1.0, 1.0)
    expected[3, 1] = 2.0 * tensor(-0.5, 0.0)
    expected[4, 0] = 0.4 * 0.2 * tensor(1.0, 0.0)
    expected[4, 1] = 0.4 * 0.2 * tensor(0.0, 1.0)
    torch.testing.assert_close(found, expected)
    following = motion(PAIR, ONE_SEES)
    velocity = PAIR[:, 2:] + DT * expected.sum(0)
    torch.testing.assert_close(following.mean[:, 2:], velocity)
    torch.testing.assert_close(following.mean[:, :2], PAIR[:, :2] + DT * velocity)
    deviation = torch.full((2, 2), 0.09 * DT, dtype=DOUBLE)
    torch.testing.assert_close(following.velocity.variance, deviation)


def test_velocity_form_and_multiplicative_noise_are_those_worked_out_by_hand():
    motion = law(form="velocity", noise="multiplicative", process_noise=0.1)
    following = motion(torch.cat([PAIR[:, :2], 2 * PAIR[:, 2:]], -1), ONE_SEES)
    expected = tensor([1.0 - 0.15, 0.4], [0.0, 0.0])
    torch.testing.assert_close(following.mean[:, 2:], expected)
    torch.testing.assert_close(following.velocity.stddev, torch.full((2, 2), 0.2, dtype=DOUBLE))


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize(
    ("form", "options"),
    [
        ("acceleration", {}),
        ("acceleration", {"relaxation_gain": 0.7, "exponent": 2.0, "min_speed": 0.0}),
        ("velocity", {"wall_gain": 0.8, "max_speed": 1.0, "half_width": 1.0}),
    ],
)
def test_it_is_the_law_of_the_simulator(space, form, options):
    """The simulator's own noise-free next velocities, limits of speed included."""
    tracks = simulate_boids(6, 30, 2, form=form, space=space, seed=3, **options)
    order = ("trial", "time", "individual", "space")
    position, velocity, after = (
        torch.from_numpy(tracks[name].transpose(*order).values.copy())
        for name in ("position", "velocity", "next_velocity")
    )
    inputs = StepInputs(torch.from_numpy(tracks["adjacency"].values))
    truth = dynamics_of(tracks)
    motion = law(
        space,
        form=form,
        cohesion_gain=truth.cohesion_gain,
        separation_gain=truth.separation_gain,
        alignment_gain=truth.alignment_gain,
        wall_gain=truth.wall_gain,
        half_width=truth.half_width,
        relaxation_gain=truth.relaxation_gain,
        preferred_speed=truth.preferred_speed,
        exponent=truth.exponent,
    )
    moved = motion(torch.cat([position, velocity], -1), inputs).velocity.mean
    found = limit_speed(moved, truth.min_speed, truth.max_speed)
    torch.testing.assert_close(found, after, rtol=1e-10, atol=1e-12)
    terms = motion.forces(torch.cat([position, velocity], -1), inputs)
    force = tracks["force"].transpose("trial", "time", "term", "individual", "space")
    for term in force["term"].values:
        mine = terms[:, :-1, motion.terms.index(str(term))]
        other = torch.from_numpy(force.sel(term=term).values.copy())[:, :-1]
        torch.testing.assert_close(mine, other, rtol=1e-10, atol=1e-12)


CASES = list(
    itertools.product(
        (2, 3),
        ("acceleration", "velocity"),
        ("additive", "multiplicative"),
        ({}, {"radius": 1.2}, {"radius": 1.2, "radius_width": 0.3}),
        ({}, LIMITS),
    )
)


@pytest.mark.parametrize(
    ("space", "form", "noise", "sight", "limits"),
    [case for case in CASES if not (case[4] and case[2] == "multiplicative")],
)
def test_the_closed_form_is_the_automatic_derivative(space, form, noise, sight, limits):
    """With the limits too, whose linearisation is the derivative of their mean: additive noise."""
    motion = law(
        space,
        form=form,
        noise=noise,
        exponent=1.7,
        softening=0.1,
        wall_gain=1.3,
        half_width=[0.5, 1.0, 0.7][:space],
        center=0.1,
        **REGULATION,
        **sight,
        **limits,
    )
    motion.separation_gain = tensor(0.1, 0.5, 0.2, 0.3, 0.4)
    states = rand(3, 2, 5, 2 * space)
    graph = random_graph(3, 2)
    graph[0, 0, 1] = 0
    found = motion.linearize(states, StepInputs(graph))
    judge = KinematicTransition.linearize(motion, states, StepInputs(graph))
    for mine, other in zip(found, judge, strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-10, atol=1e-11)
    sparse = StepInputs(EdgeList.from_dense(graph))
    for mine, other in zip(motion.linearize(states, sparse), found, strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(
        motion.forces(states, sparse), motion.forces(states, StepInputs(graph))
    )


@pytest.mark.parametrize("sight", [{}, {"radius": 1.2, "radius_width": 0.3}])
def test_single_precision_differs_by_its_rounding(sight):
    double = law(**WALL, **REGULATION, **LIMITS, **sight)
    single = BoidsTransition(
        2, DT, **GAINS, process_noise=0.3, **WALL, **REGULATION, **LIMITS, **sight
    )
    states, graph = rand(4, 5, 4), random_graph(4)
    spread = 0.01 * torch.eye(4, dtype=DOUBLE).expand(4, 5, 4, 4)
    expected = double.linearize(states, StepInputs(graph), spread)
    found = single.linearize(states.float(), StepInputs(graph.float()), spread.float())
    for mine, other in zip(found, expected, strict=True):
        assert mine.dtype == torch.float32
        torch.testing.assert_close(mine.double(), other, rtol=2e-5, atol=2e-5)


def moved_swarm(states, turn, shift):
    half = states.shape[-1] // 2
    return torch.cat([states[..., :half] @ turn.T + shift, states[..., half:] @ turn.T], -1)


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("limits", [{}, LIMITS])
def test_turned_shifted_and_renumbered_swarms_move_alike(space, limits):
    """Means, covariances and densities; walls are left out, since they have a place."""
    motion = law(space, noise="multiplicative", radius=1.5, radius_width=0.2, **limits)
    states, graph = rand(4, 5, 2 * space), random_graph(4)
    turn = torch.linalg.qr(rand(space, space, seed=5))[0]
    shift = rand(space, seed=6)
    here = motion(states, StepInputs(graph))
    torch.manual_seed(0)
    after = here.sample()
    there = motion(moved_swarm(states, turn, shift), StepInputs(graph))
    torch.testing.assert_close(there.mean, moved_swarm(here.mean, turn, shift))
    score = here.log_prob(after)
    torch.testing.assert_close(there.log_prob(moved_swarm(after, turn, shift)), score)
    both = torch.block_diag(turn, turn)
    torch.testing.assert_close(
        there.covariance_matrix, both @ here.covariance_matrix @ both.T, rtol=1e-6, atol=1e-12
    )
    order = torch.tensor([3, 0, 4, 1, 2])
    renumbered = motion(states[:, order], StepInputs(graph[:, order][:, :, order]))
    torch.testing.assert_close(renumbered.log_prob(after[:, order]), score[:, order])


@pytest.mark.parametrize("sight", [{}, {"radius": 1.2}, {"radius": 1.2, "radius_width": 0.3}])
@pytest.mark.parametrize("kind", ["dense", "edges"])
def test_the_absent_exert_no_force_and_feel_none(sight, kind):
    """Their states are 0, where they would pull everybody to the origin."""
    motion = law(wall_gain=1.0, half_width=1.0, center=5.0, **sight).requires_grad_(True)
    states = rand(3, 5, 4) + 1.0
    there = torch.tensor([True, False, True, True, False])
    states[:, ~there] = 0
    full = (1 - torch.eye(5, dtype=DOUBLE)).expand(3, 5, 5)
    graph = full if kind == "dense" else EdgeList.from_dense(full)
    found = motion.forces(states, StepInputs(graph, None, there.expand(3, 5)))
    rest = (1 - torch.eye(3, dtype=DOUBLE)).expand(3, 3, 3)
    alone = motion.forces(states[:, there], StepInputs(rest))
    torch.testing.assert_close(found[:, :, there], alone)
    assert (found[:, :, ~there] == 0).all()
    line = motion.linearize(states, StepInputs(graph, None, there.expand(3, 5)))
    small = motion.linearize(states[:, there], StepInputs(rest))
    kept = line.jacobian[:, there][:, :, :, there]
    torch.testing.assert_close(kept, small.jacobian)
    assert (line.jacobian[:, there][:, :, :, ~there] == 0).all()


@pytest.mark.parametrize("noise", ["additive", "multiplicative"])
@pytest.mark.parametrize("limits", [{}, LIMITS])
@pytest.mark.parametrize("sight", [{}, {"radius": 1.0, "radius_width": 0.3}])
def test_coincident_lonely_and_resting_individuals_leave_everything_finite(noise, limits, sight):
    """0 and 1 are at one place, 2 has no neighbour, 3 rests, 4 is absent, and all at once."""
    gain = torch.nn.Parameter(tensor(0.3).squeeze())
    motion = law(noise=noise, **REGULATION, **WALL, **limits, **sight)
    motion.separation_gain = gain
    states = rand(5, 4).requires_grad_(True)
    with torch.no_grad():
        states[1, :2] = states[0, :2]
        states[3, 2:] = 0
        states[4] = 0
    graph = 1 - torch.eye(5, dtype=DOUBLE)
    graph[2] = 0
    present = torch.tensor([True, True, True, True, False])
    inputs = StepInputs(graph, None, present)
    after = rand(5, 4, seed=2)
    score = motion(states, inputs).log_prob(after)[present]
    for total in (score.sum(), sum(part.sum() for part in motion.linearize(states, inputs))):
        assert total.isfinite()
        gradients = torch.autograd.grad(total, (states, gain), retain_graph=True)
        assert all(gradient.isfinite().all() for gradient in gradients)


def test_gains_of_each_individual_and_of_each_draw_are_its_own():
    states, graph = rand(3, 5, 4), random_graph(3)
    each = tensor(0.1, 0.2, 0.3, 0.4, 0.5)
    found = law(cohesion_gain=each).forces(states, StepInputs(graph))[:, 0]
    unit = law(cohesion_gain=1.0).forces(states, StepInputs(graph))[:, 0]
    torch.testing.assert_close(found, each[:, None] * unit)

    prior = dist.LogNormal(0.0, 1.0)
    many = law(cohesion_gain=prior, half_width=prior, wall_gain=1.0, process_noise=prior)
    draws = tensor(0.2, 0.7).reshape(2, 1, 1)
    names = ("cohesion_gain", "half_width", "process_noise")
    with fixed(many, dict.fromkeys(names, draws)):
        together = many(states, StepInputs(graph)).log_prob(states)
    assert together.shape == (2, 3, 5)
    for draw, value in enumerate((0.2, 0.7)):
        single = law(cohesion_gain=value, half_width=value, wall_gain=1.0, process_noise=value)
        expected = single(states, StepInputs(graph)).log_prob(states)
        torch.testing.assert_close(together[draw], expected)


def hierarchical_model():
    population = Hierarchical(dist.LogNormal(-1.0, 0.5), dist.HalfNormal(0.5), 5)
    motion = BoidsTransition(
        2, DT, **{**GAINS, "cohesion_gain": population}, process_noise=dist.LogNormal(-2.0, 0.5)
    )
    return StateSpaceModel(InitialStates(torch.zeros(4), torch.ones(4)), motion, None)


def test_a_hierarchy_is_three_sites_in_the_order_of_their_dependence():
    model = hierarchical_model()
    names = [
        "transition.cohesion_gain_median",
        "transition.cohesion_gain_spread",
        "transition.cohesion_gain",
        "transition.process_noise",
    ]
    pyro.set_rng_seed(2)
    trace = poutine.trace(model.sample_globals).get_trace()
    assert list(trace.stochastic_nodes) == names
    values = {name: trace.nodes[name]["value"] for name in names}
    assert values[names[2]].shape == (5,)
    own = dist.LogNormal(values[names[0]].log(), values[names[1]])
    trace.compute_log_prob()
    torch.testing.assert_close(
        trace.nodes[names[2]]["log_prob"], own.log_prob(values[names[2]]).sum()
    )


def test_a_hierarchy_is_inferred_by_an_automatic_guide():
    model = hierarchical_model()
    guide = AutoMultivariateNormal(model.sample_globals)
    drawn = guide()
    # Median, spread, five gains and the noise.
    assert guide.get_posterior().event_shape == (8,)
    assert drawn["transition.cohesion_gain"].shape == (5,)
    with model.fixed({name: drawn[name] for name in list(drawn)}):
        gain = model.transition.cohesion_gain
        found = model.transition.forces(torch.randn(5, 4), StepInputs(1 - torch.eye(5)))
    assert gain is drawn["transition.cohesion_gain"]
    assert found.isfinite().all()


def test_individual_gains_may_have_either_sign_in_a_hierarchy():
    either = Hierarchical(dist.Normal(0.0, 1.0), dist.HalfNormal(0.5), 400, positive=False)
    motion = BoidsTransition(2, DT, **{**GAINS, "cohesion_gain": either}, process_noise=1.0)
    pyro.set_rng_seed(0)
    values = {"cohesion_gain_median": torch.tensor(0.2), "cohesion_gain_spread": torch.tensor(0.5)}
    with fixed(motion, values):
        gains = motion.cohesion_gain
    assert abs(gains.mean() - 0.2) < 6 * 0.5 / 400**0.5
    assert (gains < 0).any()


def test_a_sharp_radius_is_the_graph_of_those_within_it():
    states = rand(4, 5, 4)
    graph = random_graph(4)
    near = (torch.cdist(states[..., :2], states[..., :2]) <= 1.1).to(DOUBLE)
    for form in ("acceleration", "velocity"):
        found = law(form=form, radius=1.1).forces(states, StepInputs(graph))
        expected = law(form=form).forces(states, StepInputs(graph * near))
        torch.testing.assert_close(found, expected)
        narrow = law(form=form, radius=1.1, radius_width=1e-6)
        torch.testing.assert_close(narrow.forces(states, StepInputs(graph)), expected)


def test_a_single_neighbour_fades_out_at_a_soft_radius():
    """At the radius it is seen with probability 1/2; far beyond, it does not pull at all."""
    motion = law(radius=2.0, radius_width=0.5)
    for distance in (0.5, 2.0, 3.0, 30.0):
        pair = tensor([0.0, 0.0, 0.0, 0.0], [distance, 0.0, 0.0, 1.0])
        weight = 1 / (1 + math.exp((distance - 2.0) / 0.5))
        found = motion.forces(pair, ONE_SEES)[:, 0]
        expected = weight * tensor([0.5 * distance, 0.0], [-0.3 / distance, 0.0], [0.0, 0.2])
        torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-15)


def test_the_density_is_smooth_in_the_radius_of_each():
    states, graph, after = rand(2, 5, 4), random_graph(2), rand(2, 5, 4, seed=3)

    def density(radius):
        motion = law(radius=dist.LogNormal(0.0, 1.0), radius_width=0.4)
        with fixed(motion, {"radius": radius}):
            return motion(states, StepInputs(graph)).log_prob(after)

    torch.autograd.gradcheck(density, (tensor(1.0, 0.8, 1.2, 0.5, 2.0).requires_grad_(True),))


def test_walls_are_averaged_over_the_uncertainty_of_a_position():
    """E max(x, 0) of a normal x, by Gauss-Hermite quadrature of the transition's own mean."""
    motion = law(wall_gain=2.0, half_width=[1.0, 1.5], center=[0.2, 0.0])
    states = tensor([1.25, 0.1, 1.0, 0.0])
    covariance = torch.diag(tensor(0.04, 0.5, 1e-12, 1e-12))[None]
    graph = torch.zeros(1, 1, dtype=DOUBLE)
    found = motion.linearize(states, StepInputs(graph), covariance)
    node = torch.linspace(-9, 9, 40_001, dtype=DOUBLE)
    weight = torch.exp(-0.5 * node**2) / math.sqrt(2 * math.pi) * (node[1] - node[0])
    for axis in (0, 1):
        moved = states.repeat(len(node), 1, 1)
        moved[:, 0, axis] += node * covariance[0, axis, axis].sqrt()
        mean = motion(moved, StepInputs(graph)).mean[:, 0, 2 + axis]
        expected = mean @ weight
        torch.testing.assert_close(found.mean[0, 2 + axis], expected, rtol=0, atol=1e-7)
        slope = (mean * node) @ weight / covariance[0, axis, axis].sqrt()
        torch.testing.assert_close(found.jacobian[0, 2 + axis, 0, axis], slope, rtol=0, atol=1e-6)


@pytest.mark.parametrize("speed", [0.62, 0.9, 1.18, 1.3])
def test_limits_are_linearised_over_the_uncertainty_of_a_velocity(speed):
    """Mean and covariance of the next velocity, by draws of the state and of the noise."""
    motion = law(noise="multiplicative", process_noise=0.03, **LIMITS)
    states = tensor([0.0, 0.0, speed, 0.0], [1.0, 0.3, 0.0, 0.8])
    covariance = torch.diag(tensor(0.001, 0.001, 0.0036, 0.0016)).expand(2, 4, 4)
    inputs = StepInputs(1 - torch.eye(2, dtype=DOUBLE))
    line = motion.linearize(states, inputs, covariance)
    torch.manual_seed(1)
    number = 400_000
    drawn = states + torch.randn(number, 2, 4, dtype=DOUBLE) * covariance[0].diagonal().sqrt()
    after = motion(drawn, inputs).sample()[:, 0, 2:]
    expected = torch.cov(after.T)
    blocks = line.jacobian[0, 2:]
    found = sum(blocks[:, j] @ covariance[j] @ blocks[:, j].T for j in range(2))
    found = found + line.noise[0, 2:, 2:]
    error = expected.diagonal().sqrt() * 6 / number**0.5
    # Neglected: curvature, of the order of squared variances over the speed; the neighbour's
    # covariance in the width of the step.
    assert ((after.mean(0) - line.mean[0, 2:]).abs() < error + 2e-4).all()
    assert ((expected - found).abs() < 6 * expected.trace() * (2 / number) ** 0.5 + 1e-4).all()


def test_the_linearisation_is_smooth_in_limits_and_walls():
    """The gradient by finite differences, just where the kinks are."""
    names = ("min_speed", "max_speed", "half_width", "process_noise")
    prior = dist.LogNormal(0.0, 1.0)
    motion = law(noise="multiplicative", wall_gain=1.0, **dict.fromkeys(names, prior))
    states = tensor([1.0, 0.5, 1.2, 0.0], [0.2, 0.0, 0.0, 0.6])
    covariance = (0.01 * torch.eye(4, dtype=DOUBLE)).expand(2, 4, 4)
    inputs = StepInputs(1 - torch.eye(2, dtype=DOUBLE))

    def everything(*values):
        with fixed(motion, dict(zip(names, values, strict=True))):
            return tuple(motion.linearize(states, inputs, covariance))

    values = tuple(tensor(0.6, 1.2, 1.0, 0.05).requires_grad_(True).unbind())
    torch.autograd.gradcheck(everything, values)


def test_noise_is_positive_definite_whatever_the_limits_leave():
    motion = law(process_noise=0.01, **LIMITS)
    states = tensor([0.0, 0.0, 9.0, 0.0], [1.0, 0.0, 0.01, 0.0], [5.0, 0.0, 0.9, 0.0])
    covariance = (1e-4 * torch.eye(4, dtype=DOUBLE)).expand(3, 4, 4)
    line = motion.linearize(states, StepInputs(torch.zeros(3, 3, dtype=DOUBLE)), covariance)
    assert (torch.linalg.eigvalsh(line.noise[:, 2:, 2:]) > 0).all()
    assert not motion.is_smooth
    assert law().is_smooth


def gains_and_errors(tracks, limits):
    """Return the most probable gains given exact states, and their standard deviations."""
    order = ("trial", "time", "individual", "space")
    states = torch.cat(
        [
            torch.from_numpy(tracks[name].transpose(*order).values.copy())
            for name in ("position", "velocity")
        ],
        -1,
    )
    inputs = StepInputs(torch.from_numpy(tracks["adjacency"].values[:, :-1]))
    names = ("cohesion_gain", "separation_gain", "alignment_gain", "wall_gain", "process_noise")
    prior = dist.LogNormal(0.0, 10.0)
    motion = law(noise="multiplicative", half_width=4.0, **dict.fromkeys(names, prior), **limits)

    def loss(logs):
        with fixed(motion, dict(zip(names, logs.exp().unbind(), strict=True))):
            return -motion(states[:, :-1], inputs).log_prob(states[:, 1:]).sum()

    logs = tensor(0.3, 0.3, 0.3, 0.8, 0.04).log().requires_grad_(True)
    optimizer = torch.optim.LBFGS([logs], max_iter=60, line_search_fn="strong_wolfe")

    def closure():
        optimizer.zero_grad()
        value = loss(logs) / 1e4
        value.backward()
        return value

    optimizer.step(closure)
    curvature = torch.autograd.functional.hessian(loss, logs.detach())
    best = logs.detach().exp()
    return best, best * curvature.inverse().diagonal().sqrt()


def test_known_gains_are_found_if_limits_are_known_and_missed_if_they_are_not():
    tracks = simulate_boids(10, 300, 2, seed=5)
    truth = tensor(0.5, 0.3, 0.2, 1.0, 0.02)
    best, error = gains_and_errors(tracks, LIMITS)
    assert ((best - truth).abs() < 3.5 * error).all()
    assert (error < 0.1 * truth).all()
    ignored, narrow = gains_and_errors(tracks, {})
    assert ((ignored - truth).abs() > 5 * narrow)[:3].all()


def test_what_does_not_go_together_is_refused():
    for options, words in (
        ({"form": "momentum"}, "form: it must be one of acceleration, velocity"),
        ({"noise": "pink"}, "noise: it must be one of additive, multiplicative"),
        ({"wall_gain": 1.0}, "half_width: with a wall_gain"),
        ({"relaxation_gain": 1.0}, "preferred_speed: with a relaxation_gain"),
        ({"process_noise": -1.0}, "process_noise: it must be positive"),
        ({"radius": dist.Normal(0.0, 1.0)}, "radius: it must be positive"),
        ({"cohesion_gain": torch.ones(2, 2)}, "cohesion_gain: it must be"),
        ({"wall_gain": 1.0, "half_width": torch.ones(3)}, "half_width: it must be"),
    ):
        with pytest.raises(InputError, match=words):
            law(**options)


def test_without_a_graph_nobody_sees_anybody():
    states = rand(3, 5, 4)
    found = law(radius=2.0).forces(states, StepInputs())
    assert (found == 0).all()
    line = law().linearize(states, StepInputs())
    torch.testing.assert_close(line.mean[..., 2:], states[..., 2:])


def grid_model(radii=(1.5, 2.0, 2.5, 3.0, 3.5), **options):
    prior = dist.LogNormal(-1.0, 1.0)
    motion = law(
        noise="multiplicative",
        radius=1.0,
        **{**WALL, **LIMITS, "cohesion_gain": prior, "process_noise": 0.02},
    )
    first = InitialStates(torch.zeros(4), 3.0 * torch.ones(4))
    return RadiusGridModel(first, motion, radii, edges=LatentEdges("complete"), **options)


@pytest.fixture(scope="module")
def exact_windows():
    tracks = simulate_boids(6, 40, 3, seed=8)
    order = ("trial", "time", "individual", "space")
    states = torch.cat(
        [
            torch.from_numpy(tracks[name].transpose(*order).values.copy())
            for name in ("position", "velocity")
        ],
        -1,
    )
    seen = torch.ones(states.shape[:-1], dtype=torch.bool)
    return SwarmBatch.of(states, seen, torch.zeros(*seen.shape, 6, dtype=DOUBLE))


def test_a_radius_is_summed_out_over_a_grid(exact_windows):
    """The sum of the densities of models that have one of the radii each, and the right one."""
    weights = [1.0, 1.0, 2.0, 1.0, 1.0]
    model = grid_model(weights=weights)
    values = {"transition.cohesion_gain": tensor(0.5)[0]}
    found = model.radius_log_densities(exact_windows, values)
    for radius, density in zip((1.5, 2.0, 2.5, 3.0, 3.5), found, strict=True):
        motion = law(noise="multiplicative", radius=radius, **WALL, **LIMITS, process_noise=0.02)
        single = StateSpaceModel(model.initial, motion, None, LatentEdges("complete"))
        expected = single.chain(exact_windows, {}).log_prob(exact_windows.observations).sum()
        torch.testing.assert_close(density, expected)
    assert model.radius_posterior(exact_windows, values)[2] > 0.999
    trace = poutine.trace(poutine.condition(model, values)).get_trace(exact_windows)
    prior = dist.LogNormal(-1.0, 1.0).log_prob(torch.tensor(0.5))
    total = (found + (torch.tensor(weights) / 6).log()).logsumexp(0) + prior
    torch.testing.assert_close(trace.log_prob_sum(), total, check_dtype=False)


def test_a_grid_needs_a_sharp_radius_and_positive_numbers():
    first = InitialStates(torch.zeros(4), torch.ones(4))
    for motion in (law(), law(radius=1.0, radius_width=0.1)):
        with pytest.raises(InputError, match="must have a radius"):
            RadiusGridModel(first, motion, [1.0])
    for radii in ([], [0.0, 1.0]):
        with pytest.raises(InputError, match="radii"):
            grid_model(radii)
    with pytest.raises(InputError, match="weights: they must be 5"):
        grid_model(weights=[1.0])
