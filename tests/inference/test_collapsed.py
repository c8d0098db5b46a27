"""The collapsed model: exact posteriors by SVI, NUTS and Laplace's method; weights of windows."""

import math
from dataclasses import replace

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import MCMC, NUTS, SVI, Trace_ELBO
from pyro.infer.autoguide import AutoNormal
from pyro.optim import ClippedAdam

from swarmssm.errors import InputError
from swarmssm.inference.collapsed_fit import fit_collapsed
from swarmssm.inference.collapsed_model import collapsed
from swarmssm.inference.filtering import collapsed_evidence, linearization_points
from swarmssm.inference.guides import GlobalGuide, LinearizedGuide
from swarmssm.inference.laplace_method import laplace
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    LinearTransition,
    PositionEmission,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.emissions.exact import ExactEmission
from swarmssm.models.parameters import assign
from swarmssm.models.transitions.boids import BoidsTransition
from swarmssm.simulate import simulate_boids

DOUBLE = torch.float64
OFFSET = "transition.offset"


def drifting(offset=None, noise=0.3):
    """A linear swarm in the plane whose drift has a normal prior: its posterior is normal."""
    offset = dist.Normal(torch.zeros(2), 1.0).to_event(1) if offset is None else offset
    transition = LinearTransition(2, 0.9 * torch.eye(2), 0.2 * torch.eye(2), offset=offset)
    initial = InitialStates(torch.zeros(2), torch.ones(2))
    return StateSpaceModel(initial, transition, PositionEmission(2, noise)).double()


def zero():
    return torch.zeros(2, dtype=DOUBLE)


def windows(number=4, times=6, individuals=2):
    generator = torch.Generator().manual_seed(0)
    shape = (number, times, individuals)
    seen = 0.5 + torch.randn(*shape, 2, dtype=DOUBLE, generator=generator)
    graph = torch.zeros(*shape, individuals, dtype=DOUBLE)
    return SwarmBatch.of(seen, torch.ones(shape, dtype=torch.bool), graph)


@pytest.fixture(scope="module")
def exact():
    """Mean, covariance and evidence of the drift's normal posterior, from the evidence at points.

    The log-evidence is a quadratic function of the drift, so that second differences are exact.
    """
    model, batch = drifting(), windows()

    def score(*drift):
        values = {OFFSET: torch.tensor(drift, dtype=DOUBLE)}
        evidence = collapsed_evidence(model, batch, values, method="extended").sum()
        return (evidence + dist.Normal(0.0, 1.0).log_prob(values[OFFSET]).sum()).item()

    middle = score(0, 0)
    slope = np.array([score(1, 0) - score(-1, 0), score(0, 1) - score(0, -1)]) / 2
    first = score(1, 0) + score(-1, 0) - 2 * middle
    second = score(0, 1) + score(0, -1) - 2 * middle
    mixed = (score(1, 1) + score(-1, -1) - score(1, -1) - score(-1, 1)) / 4
    covariance = np.linalg.inv(-np.array([[first, mixed], [mixed, second]]))
    mean = covariance @ slope
    evidence = middle + 0.5 * slope @ mean + 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    return mean, covariance, evidence


def test_laplace_is_exact_for_a_normal_posterior(exact):
    mean, covariance, evidence = exact
    model, batch = drifting(), windows()
    for method in ("iterated", "extended"):
        found = laplace(model, batch, method=method)
        assert found.names == (OFFSET,)
        spread = np.sqrt(np.diag(covariance))
        # The search ends within 0.02 standard deviations.
        assert (np.abs(found.loc.numpy() - mean) < 0.02 * spread).all()
        given = (found.scale_tril @ found.scale_tril.T).numpy()
        np.testing.assert_allclose(given, covariance, rtol=1e-6, atol=1e-9)
        assert found.log_evidence == pytest.approx(evidence, abs=1e-3)


def test_laplace_knows_no_units():
    """The same swarm told in thousandths: a posterior that is a thousand times as wide."""
    many, batch = 1000.0, windows()
    transition = LinearTransition(
        2, 0.9 * torch.eye(2), 0.2 * many * torch.eye(2), offset=dist.Normal(torch.zeros(2), many)
    )
    initial = InitialStates(torch.zeros(2), many * torch.ones(2))
    model = StateSpaceModel(initial, transition, PositionEmission(2, 0.3 * many)).double()
    plain = laplace(drifting(), batch)
    found = laplace(model, replace(batch, observations=many * batch.observations))
    # Each search ends within 0.02 standard deviations.
    spread = many * plain.scale_tril.square().sum(-1).sqrt()
    assert ((found.loc - many * plain.loc).abs() < 0.04 * spread).all()
    torch.testing.assert_close(found.scale_tril, many * plain.scale_tril, rtol=1e-5, atol=1e-6)


def test_it_fills_the_guide(exact):
    model = drifting()
    with quiet_pyro():
        guide = GlobalGuide(model, "multivariate").double()
        found = laplace(model, windows())
        found.fill(guide)
        posterior = guide.auto.get_posterior()
    torch.testing.assert_close(posterior.mean, found.loc)
    torch.testing.assert_close(posterior.scale_tril, found.scale_tril)
    with quiet_pyro(), pytest.raises(ValueError, match="kind 'multivariate'"):
        found.fill(GlobalGuide(model, "normal"))


def test_svi_finds_the_same(exact):
    mean, covariance, evidence = exact
    pyro.set_rng_seed(0)
    model, batch = drifting(), windows()
    with quiet_pyro():
        # The model is linear, so that it does not matter where the points are.
        target = collapsed(model, points=linearization_points(model, batch, {OFFSET: zero()}))
        guide = AutoNormal(target, init_scale=0.1)
        svi = SVI(target, guide, ClippedAdam({"lr": 0.03, "lrd": 0.985}), Trace_ELBO())
        for _ in range(200):
            svi.step(batch)
        found = guide.median(batch)[OFFSET].detach().numpy()
        losses = [svi.evaluate_loss(batch) for _ in range(20)]
    # The axes are independent here, so that a normal without correlation can be exact.
    assert (np.abs(found - mean) < 0.5 * np.sqrt(np.diag(covariance))).all()
    assert -evidence - 0.05 < np.mean(losses) < -evidence + 0.3


def test_nuts_draws_from_it():
    pyro.set_rng_seed(0)
    model, batch = drifting(), windows(2, 4)
    points = linearization_points(model, batch, {OFFSET: zero()})
    kernel = NUTS(collapsed(model, points=points))
    sampler = MCMC(kernel, num_samples=60, warmup_steps=40, disable_progbar=True)
    sampler.run(batch)
    draws = sampler.get_samples()[OFFSET]
    found = laplace(drifting(), batch)
    spread = found.scale_tril.diagonal()
    # As if one draw in three counted.
    assert ((draws.mean(0) - found.loc).abs() < 6 * spread / math.sqrt(20)).all()
    assert ((draws.std(0) / spread - 1).abs() < 6 / math.sqrt(40)).all()


def test_mini_batches_count_as_what_they_are_a_sample_of():
    model, batch = drifting(), windows()
    target = collapsed(model, method="extended")
    values = {OFFSET: torch.tensor([0.1, 0.2], dtype=DOUBLE)}
    whole = target.evidence(batch, values)
    halves = [batch.select(torch.tensor(rows)) for rows in ([0, 1], [2, 3])]
    parts = [target.evidence(half, values) for half in halves]
    assert sum(parts).item() / 2 == pytest.approx(whole.item(), rel=1e-12)
    heavy = replace(batch, window_weight=2 * batch.window_weight)
    assert target.evidence(heavy, values).item() == pytest.approx(2 * whole.item(), rel=1e-12)


def test_learned_parameters_are_left_at_the_maximum():
    model, batch = drifting(), windows()
    assign(model.emission, "noise", torch.nn.Parameter(torch.tensor(0.1, dtype=DOUBLE)))
    found = laplace(model, batch)
    (parameter,) = model.emission.parameters()
    evidence = collapsed_evidence(model, batch, found.values).sum()
    (slope,) = torch.autograd.grad(evidence, parameter)
    assert abs(parameter.item() - math.log(0.1)) > 0.1
    assert abs(slope.item()) < 0.1


@pytest.mark.parametrize("kind", ["laplace", "multivariate", "normal"])
def test_fits_say_how_it_went(exact, kind):
    mean, covariance, _ = exact
    model, batch = drifting(), windows()
    told = []
    with quiet_pyro():
        guide = LinearizedGuide(model, globals=kind)
        rows = fit_collapsed(
            model,
            guide,
            batch,
            validation=batch,
            steps=120,
            lr=0.03,
            callback=lambda step, total, loss: told.append((step, total, loss)),
        )
        middle = guide.parameters_guide.median()[OFFSET].numpy()
    assert (np.abs(middle - mean) < 0.6 * np.sqrt(np.diag(covariance))).all()
    assert rows[-1]["loss"] < rows[0]["loss"]
    assert math.isfinite(rows[-1]["validation_loss"])
    assert all(math.isnan(row["validation_loss"]) for row in rows[:-1])
    assert told[-1][0] == rows[-1]["step"]
    assert told[-1][1] == 120


def test_what_cannot_be_fitted_is_refused():
    batch = windows()
    with pytest.raises(InputError, match="no parameter with a prior"):
        laplace(drifting(offset=torch.zeros(2)), batch)
    hidden = drifting()
    hidden.emission = ExactEmission()
    with pytest.raises(InputError, match="nothing to sum out"):
        laplace(hidden, batch)
    with pytest.raises(InputError, match="choose 'parameters'"):
        LinearizedGuide(hidden)
    with pytest.raises(InputError, match="globals: choose laplace"):
        LinearizedGuide(drifting(), globals="map")
    with pytest.raises(InputError, match="layout: choose auto"):
        LinearizedGuide(drifting(), layout="wide")


@pytest.fixture(scope="module")
def flocks():
    """Boids with known gains whose positions are seen with noise, on the true graph."""
    truth = {
        "cohesion_gain": 0.6,
        "separation_gain": 0.15,
        "alignment_gain": 0.8,
        "relaxation_gain": 0.5,
        "process_noise": 0.15,
    }
    limits = {"wall_gain": 0.0, "min_speed": 0.0, "max_speed": math.inf, "noise": "additive"}
    tracks = simulate_boids(6, 80, 3, radius=2.0, observation_noise=0.03, **limits, **truth)
    position = tracks["position"].transpose("trial", "time", "individual", "space").to_numpy()
    position = torch.from_numpy(np.ascontiguousarray(position))
    graph = torch.from_numpy(tracks["adjacency"].to_numpy()).to(DOUBLE)
    batch = SwarmBatch.of(position, torch.ones(position.shape[:3], dtype=torch.bool), graph)
    return truth | {"noise": 0.03}, batch


def test_boids_gains_are_recovered_from_positions_alone(flocks):
    """Three flocks of six, 80 frames; each within 4 standard deviations."""
    truth, batch = flocks
    priors = {k: dist.LogNormal(math.log(v), 0.7) for k, v in truth.items()}
    noise = priors.pop("noise")
    model = StateSpaceModel(
        InitialStates(torch.zeros(4), torch.tensor([4.0, 4.0, 1.0, 1.0])),
        BoidsTransition(2, 0.1, preferred_speed=1.0, **priors),
        PositionEmission(2, noise),
    ).double()
    found = laplace(model, batch)
    spread = found.scale_tril.square().sum(-1).sqrt()
    for index, name in enumerate(found.names):
        off = found.loc[index] - math.log(truth[name.split(".")[1]])
        assert off.abs() < 4 * spread[index], name
        assert spread[index] < 0.6, name
