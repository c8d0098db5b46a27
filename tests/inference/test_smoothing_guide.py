"""Hold the smoothing guide against the best that independent Gaussians can do."""

import math
from dataclasses import replace

import pyro.distributions as dist
import pytest
import torch
from pyro.infer import Trace_ELBO

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList
from swarmssm.inference.guides import MarkovGuide, SmoothingGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    KinematicTransition,
    LinearTransition,
    PositionEmission,
    StateEmission,
    StateSpaceModel,
    SwarmBatch,
)

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script.:DeprecationWarning")

DOUBLE = torch.float64
BATCH, TIMES, INDIVIDUALS = 3, 10, 4
DT = 0.1


class Coasting(KinematicTransition):
    """Bodies that keep their velocities, but for noise."""

    def velocity(self, positions, velocities, inputs):
        return dist.Normal(velocities, torch.full_like(velocities, 0.1)).to_event(1)


def initial():
    return InitialStates(
        torch.tensor([1.0, 0.0, 0.2, 0.0], dtype=DOUBLE),
        torch.tensor([1.0, 1.0, 0.5, 0.5], dtype=DOUBLE),
    )


def coasting():
    return StateSpaceModel(initial(), Coasting(2, DT), PositionEmission(2, 0.05)).double()


def linear():
    matrix = torch.eye(4)
    matrix[0, 2] = matrix[1, 3] = 0.2
    matrix[2, 0] = matrix[3, 1] = -0.1
    law = LinearTransition(4, matrix, 0.1 * torch.eye(4))
    return StateSpaceModel(initial(), law, StateEmission(2, 0.1, 0.2)).double()


def drawn(model, mask=None, times=TIMES):
    torch.manual_seed(0)
    shape = (BATCH, times, INDIVIDUALS)
    mask = torch.ones(shape, dtype=torch.bool) if mask is None else mask
    graph = 1.0 - torch.eye(INDIVIDUALS, dtype=DOUBLE).expand(*shape, -1)
    graph = graph * mask.unsqueeze(-1) * mask.unsqueeze(-2)
    width = 2 if model.observes == "positions" else 4
    batch = SwarmBatch.of(torch.zeros(*shape, width, dtype=DOUBLE), mask, graph)
    with torch.no_grad():
        states = model.chain(batch, {}).sample()
        observations = model.emission(states).sample() * mask.unsqueeze(-1)
    return replace(batch, observations=observations), states


@pytest.fixture
def ragged():
    mask = torch.ones(BATCH, TIMES, INDIVIDUALS, dtype=torch.bool)
    mask[0, :4, 0] = False
    mask[0, 3:8, 1] = False
    mask[1, 7:, 2] = False
    mask[1, :, 3] = False
    mask[2, 2:9:2, 1:3] = False
    return mask


def coordinates_of(model, batch, one):
    """Return the precision matrix of one individual's path, given everything that was seen.

    In the coordinates of the guide: the first state, then the free features of each later one.
    Found by differentiating log p(z, x) twice.
    """
    window, who = one
    (frames,) = torch.nonzero(batch.present[window, :, who], as_tuple=True)
    sub = SwarmBatch(
        batch.observations[window : window + 1, frames, who : who + 1],
        batch.mask[window : window + 1, frames, who : who + 1],
        batch.adjacency.new_zeros(1, len(frames), 1, 1),
        torch.ones(1),
        1,
        batch.present[window : window + 1, frames, who : who + 1],
    )
    free = model.transition.noise_dim

    def joint(path):
        first, later = path[:4], path[4:].reshape(1, -1, 1, free)
        states = model.transition.path(first.reshape(1, 1, 4), later)
        seen = model.emission(states).mask(sub.mask).to_event(2)
        return (model.chain(sub, {}).log_prob(states) + seen.log_prob(sub.observations)).sum()

    size = 4 + free * (len(frames) - 1)
    zero = torch.zeros(size, dtype=DOUBLE)
    slope = torch.autograd.functional.jacobian(joint, zero)
    return -torch.autograd.functional.hessian(joint, zero), slope


@pytest.mark.parametrize("make", [coasting, linear])
@pytest.mark.parametrize("one", [(0, 0), (0, 1), (1, 2), (2, 1), (2, 3)])
def test_it_starts_as_the_best_independent_gaussian(make, one, ragged):
    """Means of the posterior, and scales from the diagonal of its precision."""
    model = make()
    batch, _ = drawn(model, ragged)
    guide = SmoothingGuide(model).double()
    with torch.no_grad():
        known = guide.setting(batch, {})
        parts = known.sightings, known.law, known.start, batch.present
        mean = known.reference + guide.chain.steps(*parts).mean(known.reference)
        spread = guide.chain.spread(*parts)
    precision, slope = coordinates_of(model, batch, one)
    window, who = one
    (frames,) = torch.nonzero(batch.present[window, :, who], as_tuple=True)
    best = torch.linalg.solve(precision, slope)
    free = model.transition.stochastic_features(mean)[window, frames[1:], who]
    found = torch.cat([mean[window, frames[0], who], free.flatten()])
    torch.testing.assert_close(found, best, rtol=1e-6, atol=1e-7)
    scales = [spread.first[window, frames[0], who], spread.free[window, frames[1:] - 1, who]]
    found = torch.cat([part.flatten() for part in scales])
    torch.testing.assert_close(found, precision.diagonal().rsqrt(), rtol=1e-6, atol=0)


@pytest.mark.parametrize("make", [coasting, linear])
def test_density_is_that_of_its_draws(make, ragged):
    """With the best scales, E log p(x, z) - log q(z) is the evidence less a known divergence."""
    model = make()
    batch, _ = drawn(model, ragged)
    guide = SmoothingGuide(model).double()
    one = (0, 1)
    precision, slope = coordinates_of(model, batch, one)
    # KL of independent Gaussians with the precision's diagonal from the Gaussian itself.
    expected = 0.5 * (precision.diagonal().log().sum() - precision.logdet())
    sub = SwarmBatch.of(
        batch.observations[:1, :, 1:2],
        batch.mask[:1, :, 1:2],
        torch.zeros(1, TIMES, 1, 1, dtype=DOUBLE),
    )
    best = torch.linalg.solve(precision, slope)
    torch.manual_seed(0)
    gaps = []
    with torch.no_grad():
        top = None
        for _ in range(60):
            states, density = guide.path(sub, {})
            seen = model.emission(states).mask(sub.mask).to_event(2)
            joint = model.chain(sub, {}).log_prob(states) + seen.log_prob(sub.observations)
            if top is None:
                first, later = best[:4].reshape(1, 1, 4), best[4:].reshape(1, TIMES - 1, 1, -1)
                at = model.transition.path(first, later)
                at_seen = model.emission(at).mask(sub.mask).to_event(2)
                top = model.chain(sub, {}).log_prob(at) + at_seen.log_prob(sub.observations)
                # Laplace's integral is exact for a Gaussian.
                evidence = top + 0.5 * (len(best) * math.log(2 * math.pi) - precision.logdet())
            gaps.append(evidence - joint + density)
    gaps = torch.cat(gaps)
    assert abs(gaps.mean() - expected) < 4 * gaps.std() / math.sqrt(len(gaps))


@pytest.mark.parametrize("make", [coasting, linear])
def test_edge_list_gives_the_same_numbers(make, ragged):
    model = make()
    batch, _ = drawn(model, ragged)
    guide = SmoothingGuide(model).double()
    torch.manual_seed(5)
    with torch.no_grad():
        guide.correct.weight.normal_(std=0.2)
    sparse = replace(batch, adjacency=EdgeList.from_dense(batch.adjacency))
    found = []
    for one in (batch, sparse):
        torch.manual_seed(0)
        found.append(guide.path(one, {}))
    torch.testing.assert_close(found[0], found[1], rtol=1e-6, atol=1e-6)


def test_states_of_the_absent_are_zero_and_positions_follow(ragged):
    model = coasting()
    batch, _ = drawn(model, ragged)
    again = batch.present.clone()
    again[1, 3:5, 1] = False
    for present in (batch.present, again):
        one = replace(batch, present=present, mask=batch.mask & present)
        states, density = SmoothingGuide(model).double().path(one, {})
        assert not states[~present].any()
        chain = model.chain(one, {})
        chain._validate_args = True
        assert (chain.log_prob(states) - density).isfinite().all()


def test_long_float32_windows_far_from_the_origin_keep_to_their_surface():
    model = StateSpaceModel(
        InitialStates(torch.tensor([5000.0, -3000, 0, 0]), torch.tensor([10.0, 10, 1, 1])),
        Coasting(2, DT),
        PositionEmission(2, 0.05),
    )
    mask = torch.ones(1, 400, 2, dtype=torch.bool)
    torch.manual_seed(0)
    blank = SwarmBatch.of(torch.zeros(1, 400, 2, 2), mask, torch.zeros(1, 400, 2, 2))
    truth = model.chain(blank, {}).sample()
    batch = replace(blank, observations=truth[..., :2] + 0.05 * torch.randn(1, 400, 2, 2))
    states, density = SmoothingGuide(model).path(batch, {})
    chain = model.chain(batch, {})
    chain._validate_args = True
    assert (chain.log_prob(states) - density).isfinite().all()
    assert (states - truth)[..., :2].square().mean().sqrt() < 0.05


def test_independence_costs_more_than_keeping_time_together():
    """Fitted side by side: the gap of the guide with correlation in time is far smaller."""
    model = coasting()
    batch, _ = drawn(model, times=20)
    losses = {}
    with quiet_pyro():
        for kind in (SmoothingGuide, MarkovGuide):
            guide = kind(model).double()
            elbo = Trace_ELBO()(model, guide)
            optimizer = torch.optim.Adam(guide.parameters(), lr=0.003)
            for _ in range(5):
                optimizer.zero_grad()
                elbo(batch).backward()
                optimizer.step()
            with torch.no_grad():
                losses[kind] = torch.stack([elbo(batch) for _ in range(10)]).mean()
    each = (losses[SmoothingGuide] - losses[MarkovGuide]) / batch.observations.numel()
    assert each > 0.05


def test_training_undoes_a_wrong_scale():
    model = coasting()
    batch, _ = drawn(model)
    with quiet_pyro():
        guide = SmoothingGuide(model).double()
        elbo = Trace_ELBO()(model, guide)

        def mean_loss():
            with torch.no_grad():
                return sum(elbo(batch) for _ in range(10)) / 10

        best = mean_loss()
        with torch.no_grad():
            guide.correct.bias[-4:] = 1.0
        before = mean_loss()
        optimizer = torch.optim.Adam(guide.parameters(), lr=0.05)
        for _ in range(20):
            optimizer.zero_grad()
            elbo(batch).backward()
            optimizer.step()
        assert mean_loss() - best < 0.3 * (before - best)


class Clamped(Coasting):
    @property
    def is_smooth(self):
        return False


def test_limits_are_refused():
    model = StateSpaceModel(initial(), Clamped(2, DT), PositionEmission(2, 0.05))
    with pytest.raises(InputError, match="SmoothingGuide needs next states that have a density"):
        SmoothingGuide(model)
