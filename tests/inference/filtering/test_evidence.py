"""The collapsed evidence against filterpy, a dense Gaussian, the plain filter, weighted paths."""

from dataclasses import replace

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from filterpy.kalman import KalmanFilter
from oracles.importance import weigh_paths
from oracles.iterated import iterated_smoother

from swarmssm.errors import WorkError
from swarmssm.inference.filtering import (
    collapsed_evidence,
    extended_kalman,
    linearization_points,
    smooth,
)
from swarmssm.inference.filtering.adjoint import AffineChain, chain_evidence, chain_smooth
from swarmssm.inference.filtering.banded import Band, band_mean, band_moments, log_integral
from swarmssm.inference.filtering.layouts import frames_of
from swarmssm.models import (
    ExactEmission,
    InitialStates,
    LatentEdges,
    PositionEmission,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.parameters import assign
from swarmssm.models.transitions.boids import BoidsTransition
from swarmssm.simulate import simulate_boids

DOUBLE = torch.float64
KINDS = ["kinematic", "general"]
METHODS = ["extended", "iterated"]
GAPS = [(0, slice(2, 4), 1), (1, 0, slice(None)), (1, 3, 0)]
ABSENT = [(0, slice(0, 3), 2), (1, slice(4, None), 1)]


def rand(*shape, seed):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def positive(*shape, seed):
    root = rand(*shape, shape[-1], seed=seed)
    return root @ root.mT + 0.5 * torch.eye(shape[-1], dtype=DOUBLE)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", KINDS)
def test_it_is_filterpys_log_likelihood(linear_swarm, windows, kind, method):
    model, batch = linear_swarm(kind), windows(missing=GAPS)
    found = collapsed_evidence(model, batch, method=method)
    for window in range(len(batch)):
        assert found[window].item() == pytest.approx(judged(model, batch, window), rel=1e-8)


def judged(model, batch, window):
    """Return filterpy's log-likelihood of one window of a linear swarm without entries."""
    individuals, times, state = batch.num_individuals, batch.num_times, model.state_dim
    joint = individuals * state
    initial = model.initial()
    judge = KalmanFilter(joint, 2 * individuals)
    judge.x = np.tile(initial.mean.numpy(), individuals)[:, None]
    judge.P = np.diag(np.tile(initial.variance.numpy(), individuals))
    pick = np.kron(np.eye(individuals), np.eye(2, state))
    tracking = np.tile(model.emission.noise.numpy() ** 2, individuals)
    total = 0.0
    for t in range(times):
        if t:
            inputs = batch.select(torch.tensor([window])).steps().at(t - 1)
            law = model.transition.linearize(
                torch.zeros(1, individuals, state, dtype=DOUBLE), inputs
            )
            judge.F = law.jacobian.reshape(joint, joint).numpy()
            judge.Q = torch.block_diag(*law.noise[0]).numpy()
            assert law.mean.abs().max() == 0
            judge.predict()
        rows = np.repeat(batch.mask[window, t].numpy(), 2)
        if rows.any():
            seen = batch.observations[window, t].numpy().reshape(-1)[rows, None]
            judge.update(seen, R=np.diag(tracking[rows]), H=pick[rows])
            total += judge.log_likelihood
    return total


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", KINDS)
def test_it_is_the_dense_gaussian_where_individuals_come_and_go(
    linear_swarm, windows, dense_judge, kind, method
):
    model, batch = linear_swarm(kind), windows(missing=[(0, 5, 0)], absent=ABSENT)
    found = collapsed_evidence(model, batch, method=method)
    for window in range(len(batch)):
        exact = dense_judge(model, batch, window).log_evidence
        assert found[window].item() == pytest.approx(exact, rel=1e-8)


def boids(noise=0.03, **options):
    given = {
        "cohesion_gain": 0.6,
        "separation_gain": 0.15,
        "alignment_gain": 0.8,
        "relaxation_gain": 0.5,
        "process_noise": 0.15,
    }
    transition = BoidsTransition(
        2, 0.1, preferred_speed=1.0, **{k: prior(v) for k, v in (given | options).items()}
    )
    initial = InitialStates(torch.zeros(4), torch.tensor([2.0, 2.0, 1.0, 1.0]))
    return StateSpaceModel(
        initial, transition, PositionEmission(2, prior(noise)), LatentEdges("radius:2.0")
    ).double()


def prior(middle):
    return dist.LogNormal(float(np.log(middle)), 0.5)


def flock(individuals=4, times=15, trials=2, seed=0):
    tracks = simulate_boids(
        individuals,
        times,
        trials,
        radius=2.0,
        cohesion_gain=0.6,
        separation_gain=0.15,
        alignment_gain=0.8,
        relaxation_gain=0.5,
        wall_gain=0.0,
        min_speed=0.0,
        max_speed=float("inf"),
        noise="additive",
        process_noise=0.15,
        observation_noise=0.03,
        seed=seed,
    )
    position = tracks["position"].transpose("trial", "time", "individual", "space").to_numpy()
    position = torch.from_numpy(np.ascontiguousarray(position))
    mask = torch.ones(position.shape[:3], dtype=torch.bool)
    complete = torch.ones(*position.shape[:3], individuals, dtype=DOUBLE)
    return SwarmBatch.of(position, mask, complete)


def truth(requires_grad=True):
    values = {
        "transition.cohesion_gain": 0.6,
        "transition.separation_gain": 0.15,
        "transition.alignment_gain": 0.8,
        "transition.relaxation_gain": 0.5,
        "transition.process_noise": 0.15,
        "emission.noise": 0.03,
    }
    return {
        k: torch.tensor(v, dtype=DOUBLE, requires_grad=requires_grad) for k, v in values.items()
    }


def with_gaps(batch):
    """One comes late, one leaves early, one is lost for a while."""
    mask = batch.mask.clone()
    mask[0, :4, 0] = False
    mask[0, 8:11, 2] = False
    mask[1, 9:, 1] = False
    observations = torch.where(mask.unsqueeze(-1), batch.observations, 0.0)
    return SwarmBatch.of(observations, mask, batch.adjacency)


def slopes(evidence, values):
    return torch.stack(torch.autograd.grad(evidence.sum(), list(values.values())))


@pytest.mark.parametrize("gaps", [False, True])
def test_the_adjoint_of_the_filter_is_its_derivative(gaps):
    """Autograd through the plain loop is the judge."""
    model, values = boids(), truth()
    batch = with_gaps(flock()) if gaps else flock()
    plain = extended_kalman(model, batch, values).log_evidence
    found = collapsed_evidence(model, batch, values, method="extended")
    torch.testing.assert_close(found, plain, rtol=1e-10, atol=0)
    torch.testing.assert_close(slopes(found, values), slopes(plain, values), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("gaps", [False, True])
def test_a_band_of_positions_is_the_filter_of_the_same_linear_model(gaps):
    """Value, derivative, smoothed mean and covariance, by two programs that share no line."""
    model, values = boids(), truth()
    batch = with_gaps(flock()) if gaps else flock()
    points = linearization_points(model, batch, values)
    found = collapsed_evidence(model, batch, values, points=points)
    with model.fixed(values):
        frames = frames_of(model, batch, "joint")
        chain = frames.about(points)
        plain = chain_evidence(chain)
    torch.testing.assert_close(found, plain, rtol=1e-10, atol=0)
    torch.testing.assert_close(slopes(found, values), slopes(plain, values), rtol=1e-7, atol=1e-7)
    chain = AffineChain(*(part.detach() for part in chain))
    smoothed = frames.points(*chain_smooth(chain))
    torch.testing.assert_close(points.covariance, smoothed.covariance, rtol=1e-6, atol=1e-9)


def test_points_are_the_most_probable_path():
    """No nudge of a whole path makes it more probable by more than it must."""
    model, values, batch = boids(), truth(requires_grad=False), flock(3, 12, 1)
    points = linearization_points(model, batch, values)

    def score(states):
        with model.fixed(values):
            seen = model.emission(states).to_event(2).log_prob(batch.observations)
            return model.chain(batch, values).log_prob(states) + seen

    first, free = points.mean[:, 0], points.mean[:, 1:, :, 2:]
    rebuilt = model.transition.path(first, free)
    torch.testing.assert_close(rebuilt, points.mean, rtol=0, atol=1e-12)
    best = score(rebuilt)
    for seed in range(5):
        for size in (1e-2, 1e-3):
            nudged = model.transition.path(
                first + size * rand(*first.shape, seed=seed),
                free + size * rand(*free.shape, seed=100 + seed),
            )
            assert score(nudged) < best + 0.01  # the search ends when a step gains 0.01 nat


def test_it_is_near_the_truth():
    """The truth by 2,000 weighted paths of the smoother, whose own error is estimated."""
    model, values, batch = boids(), truth(requires_grad=False), flock(3, 12, 2)
    smoother = iterated_smoother(model, batch, values)
    weighed = weigh_paths(model, batch, values, smoother.filtered, 2_000, seed=0)
    relative = (weighed.log_weights - weighed.log_evidence).exp()
    error = relative.std(0) / len(relative) ** 0.5
    assert (error < 0.05).all()
    off = (collapsed_evidence(model, batch, values) - weighed.log_evidence).abs()
    # 72 numbers were seen: a thousandth of a nat for each is what linearising costs.
    assert (off < 72e-3 + 6 * error).all()


def test_heavy_tails_are_laplaces_integral():
    """One individual that is seen once: the integral over its position by quadrature."""
    initial = InitialStates(torch.zeros(4), torch.tensor([1.0, 1e-3, 1e-3, 1e-3]))
    emission = PositionEmission(2, 0.1, tails="student", excess_degrees=3.0)
    model = StateSpaceModel(initial, boids().transition, emission, LatentEdges("radius:2.0"))
    model = model.double()
    seen = torch.tensor([0.4, 0.0], dtype=DOUBLE).reshape(1, 1, 1, 2)
    mask = torch.ones(1, 1, 1, dtype=torch.bool)
    batch = SwarmBatch.of(seen, mask, torch.zeros(1, 1, 1, 1, dtype=DOUBLE))
    values = {k: v for k, v in truth(False).items() if k.startswith("transition")}
    found = collapsed_evidence(model, batch, values).item()
    grid = torch.linspace(-3, 3, 20_001, dtype=DOUBLE)
    states = torch.zeros(len(grid), 4, dtype=DOUBLE)
    states[:, 0] = grid
    density = torch.distributions.Normal(0.0, 1.0).log_prob(grid)
    density = density + model.emission(states).log_prob(seen.reshape(2))
    exact = (density.logsumexp(0) + (grid[1] - grid[0]).log()).item()
    # The curvature that reweighting uses is w / s^2, and the density's own at its top the same:
    # w = (5 + 2) / 5 there. Tails make the integral wider by some tenths of a nat.
    peak = density.max().item() + 0.5 * np.log(2 * np.pi * 0.01 / 1.4)
    assert found == pytest.approx(peak, abs=0.02)
    assert found == pytest.approx(exact, abs=0.3)


def test_the_chains_derivatives_pass_gradcheck():
    times, batch, state, seen = 4, 2, 3, 2
    parts = [
        rand(batch, state, seed=0),
        positive(batch, state, seed=1),
        rand(times - 1, batch, state, state, seed=2),
        rand(times - 1, batch, state, seed=3),
        positive(times - 1, batch, state, seed=4),
        rand(times, batch, seen, state, seed=5),
        rand(times, batch, seen, seed=6),
        positive(times, batch, seen, seed=7),
        rand(times, batch, seen, seed=8),
    ]
    count = torch.full((batch,), times * seen)

    def evidence(*tensors):
        tensors = list(tensors)
        for index in (1, 4, 7):
            tensors[index] = 0.5 * (tensors[index] + tensors[index].mT)
        return chain_evidence(AffineChain(*tensors, count))

    assert torch.autograd.gradcheck(evidence, [part.requires_grad_() for part in parts])


def test_a_bands_moments_are_those_of_the_dense_matrix():
    blocks, batch, size = 7, 2, 3
    width = blocks * size
    lower = torch.tril(0.3 * rand(batch, width, width, seed=0))
    place = torch.arange(width) // size
    lower = lower * ((place[:, None] - place) <= 2) + 2 * torch.eye(width, dtype=DOUBLE)
    dense = lower @ lower.mT

    def block(matrix, i, j):
        return matrix[:, i * size : (i + 1) * size, j * size : (j + 1) * size]

    def diagonals(matrix):
        return [
            torch.stack([block(matrix, k + gap, k) for k in range(blocks - gap)])
            for gap in range(3)
        ]

    linear = rand(blocks, batch, size, seed=1)
    band = Band(*diagonals(dense), linear)
    flat = linear.transpose(0, 1).reshape(batch, width)
    inverse = torch.linalg.inv(dense)
    mean = (inverse @ flat.unsqueeze(-1)).squeeze(-1)
    exact = 0.5 * (flat * mean).sum(-1) - 0.5 * torch.logdet(dense)
    exact = exact + 0.5 * width * np.log(2 * np.pi)
    torch.testing.assert_close(log_integral(band), exact, rtol=1e-12, atol=0)
    found = band_moments(band)
    for given, wanted in zip(found[1:], diagonals(inverse), strict=True):
        torch.testing.assert_close(given, wanted, rtol=1e-10, atol=1e-14)
    split = mean.reshape(batch, blocks, size).transpose(0, 1)
    torch.testing.assert_close(found.mean, split, rtol=1e-10, atol=1e-14)
    torch.testing.assert_close(band_mean(band), split, rtol=1e-10, atol=1e-14)


def test_a_long_window_keeps_its_precision():
    """Rounding errors must not grow on the way back through the band."""
    model, values, batch = boids(), truth(), flock(10, 60, 1)
    points = linearization_points(model, batch, values)
    slope = slopes(collapsed_evidence(model, batch, values, points=points), values)
    with model.fixed(values):
        plain = chain_evidence(frames_of(model, batch, "joint").about(points))
    torch.testing.assert_close(slope, slopes(plain, values), rtol=1e-6, atol=1e-6)


def test_single_precision_models_are_filtered_in_double(linear_swarm, windows):
    model, batch = linear_swarm("kinematic"), windows()
    exact = collapsed_evidence(model, batch)
    single = replace(
        batch, observations=batch.observations.float(), adjacency=batch.adjacency.float()
    )
    for method in METHODS:
        found = collapsed_evidence(model.float(), single, method=method)
        assert found.dtype == DOUBLE
        torch.testing.assert_close(found, exact, rtol=1e-4, atol=0)


def test_parameters_of_the_model_are_differentiated(linear_swarm, windows):
    model, batch = linear_swarm("kinematic"), windows()
    assign(model.emission, "noise", torch.nn.Parameter(torch.tensor(0.25, dtype=DOUBLE)))
    (parameter,) = model.emission.parameters()
    for method in METHODS:
        parameter.grad = None
        collapsed_evidence(model, batch, method=method).sum().backward()
        step, start = 1e-5, parameter.detach().clone()
        ends = []
        for sign in (1, -1):
            parameter.data = start + sign * step
            ends.append(collapsed_evidence(model, batch, method=method).sum().item())
        parameter.data = start
        assert parameter.grad.item() == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_frames_that_are_given_take_the_prior_of_first_states_with_them(method):
    """By the chain rule; and what is left hardly knows how wide that prior was."""
    batch = flock(4, 40, 1)
    values, wholes, rests = truth(False), [], []
    for width in (1.0, 3.0):
        model = boids()
        model.initial.scale = width * model.initial.scale
        wholes.append(collapsed_evidence(model, batch, values, method=method))
        rests.append(collapsed_evidence(model, batch, values, method=method, given=15))
    # 16 coordinates, each with a density lower by log 3.
    assert (wholes[0] - wholes[1]).item() == pytest.approx(16 * np.log(3), rel=0.2)
    assert abs((rests[0] - rests[1]).item()) < 0.1
    # One frame more: the density of its positions given the others is not above that of noise
    # without any error of prediction.
    longer = collapsed_evidence(model, batch, values, method=method, given=16)
    most = -8 * (np.log(0.03) + 0.5 * np.log(2 * np.pi))
    assert (rests[1] - longer).item() < most
    with pytest.raises(ValueError, match="given must be from 0 to 39, and it is 40"):
        collapsed_evidence(model, batch, values, method=method, given=40)


def test_what_cannot_be_done_is_refused(linear_swarm, windows):
    model, batch = linear_swarm("kinematic"), windows()
    with pytest.raises(ValueError, match="'extended' or 'iterated', not 'exact'"):
        collapsed_evidence(model, batch, method="exact")
    with pytest.raises(ValueError, match="layout must be"):
        collapsed_evidence(model, batch, layout="wide")
    for method in METHODS:
        broken = linear_swarm("general")
        broken.emission.noise = torch.full((2,), torch.nan, dtype=DOUBLE)
        with pytest.raises(WorkError, match="not positive definite"):
            collapsed_evidence(broken, batch, method=method)
    model.emission = ExactEmission()
    with pytest.raises(ValueError, match="nothing to filter"):
        collapsed_evidence(model, batch, method="iterated", layout="blocks")


def test_smoothed_points_are_those_of_the_plain_smoother(linear_swarm, windows):
    for kind in KINDS:
        model, batch = linear_swarm(kind), windows(missing=GAPS)
        plain = smooth(extended_kalman(model, batch, {}))
        points = linearization_points(model, batch)
        torch.testing.assert_close(points.mean, plain.mean, rtol=1e-7, atol=1e-7)
        torch.testing.assert_close(points.covariance, plain.own_covariance, rtol=1e-7, atol=1e-9)
