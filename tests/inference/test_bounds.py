"""Hold the bounds against each other, and against an evidence that is known."""

from dataclasses import replace

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import Trace_ELBO

from swarmssm.errors import InputError
from swarmssm.inference.bounds import Bound, annealing
from swarmssm.inference.guides import MarkovGuide, SmoothingGuide, SwarmGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    LinearTransition,
    PositionEmission,
    StateSpaceModel,
    SwarmBatch,
)

DOUBLE = torch.float64


@pytest.fixture(autouse=True)
def _parameters_in_modules():
    with quiet_pyro():
        yield


def swarm(noise=0.2):
    """Return a linear swarm in which two drift towards each other."""
    law = LinearTransition(2, 0.9 * torch.eye(2), 0.3 * torch.eye(2), coupling=0.1 * torch.eye(2))
    initial = InitialStates(torch.zeros(2), torch.ones(2))
    return StateSpaceModel(initial, law, PositionEmission(1, noise)).double()


def windows(model, count=2, times=3, individuals=2, seed=0):
    torch.manual_seed(seed)
    shape = (count, times, individuals)
    apart = (1.0 - torch.eye(individuals)).expand(count, times, -1, -1).double()
    mask = torch.ones(shape, dtype=torch.bool)
    batch = SwarmBatch.of(torch.zeros(*shape, 1, dtype=DOUBLE), mask, apart)
    with torch.no_grad():
        states = model.chain(batch, {}).sample()
    return replace(batch, observations=states[..., :1] + 0.2 * torch.randn(*shape, 1).double())


def unsure():
    return swarm(dist.LogNormal(torch.tensor(-1.5, dtype=DOUBLE), 0.5))


@pytest.mark.parametrize("guide", [MarkovGuide, SmoothingGuide])
def test_one_draw_is_the_elbo(guide):
    model = unsure()
    batch = replace(windows(swarm()), population=7, window_weight=torch.tensor([1.0, 2.0]))
    guide = guide(model).double()
    found = []
    for loss in (Bound(model, guide), Trace_ELBO()(model, guide)):
        torch.manual_seed(3)
        value = loss(batch)
        found.append((value, *torch.autograd.grad(value, guide.correct.bias)))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])


def test_the_weighted_bound_of_one_draw_is_the_elbo_too():
    model = unsure()
    batch = replace(windows(swarm()), population=7, window_weight=torch.tensor([1.0, 2.0]))
    guide = SmoothingGuide(model).double()
    bound = Bound(model, guide)
    torch.manual_seed(3)
    expected = bound(batch)
    torch.manual_seed(3)
    torch.testing.assert_close(bound._importance_weighted(batch), expected)


def wide(model):
    """Return a guide that is nearly the posterior, but wider, so that weights are bounded."""
    guide = MarkovGuide(model).double()
    with torch.no_grad():
        guide.correct.bias[-2:] = 0.5
    return guide


def test_more_draws_are_tighter_and_tend_to_the_evidence(dense_evidence):
    model = swarm()
    batch = windows(model)
    evidence = dense_evidence(model, batch).sum().item()
    guide = wide(model)
    values = {}
    with torch.no_grad():
        for draws, repeats in ((1, 60), (4, 30), (32, 20), (1000, 15)):
            bound = Bound(model, guide, draws)
            values[draws] = np.array([-bound(batch).item() for _ in range(repeats)])
    means = {draws: found.mean() for draws, found in values.items()}
    errors = {draws: found.std(ddof=1) / len(found) ** 0.5 for draws, found in values.items()}
    for few, many in ((1, 4), (4, 32)):
        assert means[many] - means[few] > 3 * np.hypot(errors[few], errors[many])
    # Of K draws the bound falls short of the evidence by var(w) / 2K, and its variance is
    # var(w) / K, in each of two windows alike.
    short = values[1000].var(ddof=1) / 2
    assert means[1000] == pytest.approx(evidence, abs=4 * errors[1000] + 2 * short)


def test_windows_are_weighed_each_for_itself(dense_evidence):
    """Weights and population multiply what each window says."""
    model = swarm()
    batch = windows(model)
    evidence = dense_evidence(model, batch)
    scaled = replace(batch, population=10, window_weight=torch.tensor([1.0, 3.0]).double())
    guide = wide(model)
    with torch.no_grad():
        found = np.array([-Bound(model, guide, 1000)(scaled).item() for _ in range(8)])
    expected = 10 / 2 * (evidence[0] + 3 * evidence[1]).item()
    error, short = found.std(ddof=1) / 8**0.5, found.var(ddof=1) / (2 * 5)
    assert found.mean() == pytest.approx(expected, abs=4 * error + 2 * short)


def test_gradient_of_the_weighted_bound():
    model = swarm()
    batch = windows(model)
    guide = SmoothingGuide(model).double()
    bound = Bound(model, guide, 3)

    def loss(shift):
        with torch.no_grad():
            guide.correct.bias[-1] = shift
        torch.manual_seed(0)
        return bound(batch)

    loss(0.1).backward()
    slope = (loss(0.101) - loss(0.099)).item() / 0.002
    assert guide.correct.bias.grad[-1].item() == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("draws", [1, 3])
def test_annealing_weighs_latent_sites_alone(draws):
    """The loss is affine in the weight where there is one draw; at 0, only sightings count."""
    model = unsure()
    batch = windows(swarm())
    guide = SmoothingGuide(model).double()
    bound = Bound(model, guide, draws)
    with torch.no_grad():
        torch.manual_seed(1)
        nothing = bound(batch, 0.0)
        torch.manual_seed(1)
        copies = batch.select(torch.arange(2).repeat(draws))
        trace = pyro.poutine.trace(guide).get_trace(copies)
        model_trace = pyro.poutine.trace(pyro.poutine.replay(model, trace)).get_trace(copies)
        model_trace.compute_log_prob()
        each = model_trace.nodes["observations"]["unscaled_log_prob"].reshape(draws, 2)
        seen = (each.logsumexp(0) - np.log(draws)).sum()
        torch.testing.assert_close(nothing, -seen)
        if draws == 1:
            torch.manual_seed(1)
            whole = bound(batch, 1.0)
            torch.manual_seed(1)
            torch.testing.assert_close(bound(batch, 0.25), 0.75 * nothing + 0.25 * whole)


def test_schedule():
    assert [annealing(step, 4) for step in range(6)] == [0.2, 0.4, 0.6, 0.8, 1.0, 1.0]
    assert annealing(0, 0) == 1.0


@pytest.mark.parametrize("draws", [1, 4])
def test_mini_batches_have_the_bound_of_all_windows(draws):
    """The prior of a parameter counts once, whatever the size of a mini-batch."""
    model = unsure()
    batch = windows(swarm(), count=12)
    guide = MarkovGuide(model, parameters="normal").double()
    bound = Bound(model, guide, draws)
    torch.manual_seed(2)
    with torch.no_grad():
        full = np.array([bound(batch).item() for _ in range(40)])
        parts = []
        for _ in range(20):
            order = torch.randperm(12)
            parts.append(np.mean([bound(batch.select(p)).item() for p in order.split(4)]))
    error = np.hypot(full.std() / len(full) ** 0.5, np.std(parts) / len(parts) ** 0.5)
    assert abs(full.mean() - np.mean(parts)) < 4 * error
    # Counted three times as often, the divergence of the parameter from its prior would show.
    with torch.no_grad():
        values = torch.stack([guide.parameters_guide()["emission.noise"] for _ in range(200)]).log()
        divergence = 0.5 * ((values.var() + (values.mean() + 1.5) ** 2) / 0.25 - 1)
        divergence = divergence - (values.std() / 0.5).log()
    assert 2 * divergence > 4 * error


class Coin(SwarmGuide):
    """A guide with a draw that has no derivative."""

    def forward(self, batch):
        pyro.sample("coin", dist.Bernoulli(0.5))
        rows = torch.arange(len(batch))
        with pyro.plate("windows", batch.population, subsample=rows, dim=-1):
            states = torch.zeros(*batch.observations.shape[:-1], 2, dtype=DOUBLE)
            pyro.sample("states", dist.Delta(states, event_dim=3))


def test_draws_without_derivative_are_refused():
    model = swarm()
    with pytest.raises(InputError, match=r"those of 'coin' .* are not"):
        Bound(model, Coin(), 2)(windows(model))
    with pytest.raises(InputError, match="at least one, not 0"):
        Bound(model, Coin(), 0)
