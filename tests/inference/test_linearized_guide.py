"""The model's own smoother as a guide: exact for linear swarms, and on the surface of paths."""

import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import Trace_ELBO

from swarmssm.errors import InputError
from swarmssm.inference.filtering import collapsed_evidence
from swarmssm.inference.guides import LinearizedGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    LinearTransition,
    PositionEmission,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.transitions import Transition
from swarmssm.models.transitions.boids import BoidsTransition

DOUBLE = torch.float64


def linear(**options):
    generator = torch.Generator().manual_seed(1)
    matrix = 0.8 * torch.eye(4) + 0.1 * torch.randn(4, 4, generator=generator)
    coupling = 0.1 * torch.eye(4)
    transition = LinearTransition(4, matrix, 0.3 * torch.eye(4), coupling, **options)
    return StateSpaceModel(initial(), transition, PositionEmission(2, 0.2)).double()


def boids(**options):
    transition = BoidsTransition(
        2,
        0.1,
        cohesion_gain=0.6,
        separation_gain=0.15,
        alignment_gain=0.8,
        process_noise=0.15,
        **options,
    )
    return StateSpaceModel(initial(), transition, PositionEmission(2, 0.05)).double()


def initial():
    return InitialStates(torch.zeros(4), torch.tensor([2.0, 2.0, 1.0, 1.0]))


def windows(times=8, individuals=3):
    """Two windows in which one comes late, one leaves early and one is lost for a while."""
    generator = torch.Generator().manual_seed(0)
    shape = (2, times, individuals)
    mask = torch.ones(shape, dtype=torch.bool)
    mask[0, :3, 0] = False
    mask[0, 5:, 1] = False
    mask[1, 3:5, 2] = False
    steps = 0.1 * torch.randn(*shape, 2, dtype=DOUBLE, generator=generator)
    seen = steps.cumsum(1) + torch.randn(2, 1, individuals, 2, dtype=DOUBLE, generator=generator)
    graph = torch.ones(*shape, individuals, dtype=DOUBLE) - torch.eye(individuals, dtype=DOUBLE)
    graph = graph * mask.unsqueeze(-1) * mask.unsqueeze(-2)
    return SwarmBatch.of(torch.where(mask.unsqueeze(-1), seen, 0.0), mask, graph)


def log_weights(model, guide, batch, values):
    states, log_density = guide.path(batch, values)
    with model.fixed(values):
        seen = model.emission(states).mask(batch.mask).to_event(2).log_prob(batch.observations)
    return states, model.chain(batch, values).log_prob(states) + seen - log_density


def test_every_path_of_a_linear_swarm_weighs_the_evidence():
    model, batch = linear(), windows()
    guide = LinearizedGuide(model)
    exact = collapsed_evidence(model, batch)
    for seed in range(3):
        pyro.set_rng_seed(seed)
        _, weights = log_weights(model, guide, batch, {})
        torch.testing.assert_close(weights, exact, rtol=1e-9, atol=0)


def test_its_elbo_is_the_evidence_and_has_its_derivative():
    name = "transition.offset"
    model = linear(offset=dist.Normal(torch.zeros(4), 1.0).to_event(1))
    batch = windows()
    guide = LinearizedGuide(model)
    drift = torch.tensor([0.1, -0.1, 0.2, 0.0], dtype=DOUBLE, requires_grad=True)
    _, weights = log_weights(model, guide, batch, {name: drift})
    exact = collapsed_evidence(model, batch, {name: drift}).sum()
    torch.testing.assert_close(weights.sum(), exact, rtol=1e-9, atol=0)
    found, wanted = (torch.autograd.grad(total, drift)[0] for total in (weights.sum(), exact))
    torch.testing.assert_close(found, wanted, rtol=1e-7, atol=1e-7)
    still = linear()
    with quiet_pyro():
        loss = Trace_ELBO().loss(still, LinearizedGuide(still), batch)
    assert loss == pytest.approx(-collapsed_evidence(still, batch).sum().item(), rel=1e-9)


@pytest.mark.parametrize("layout", ["joint", "blocks"])
def test_paths_keep_to_the_surface_and_to_who_is_there(layout):
    model, batch = boids(), windows()
    guide = LinearizedGuide(model, layout=layout)
    pyro.set_rng_seed(0)
    states, weights = log_weights(model, guide, batch, {})
    assert states.shape == (2, 8, 3, 4)
    assert (states[~batch.present] == 0).all()
    persists = batch.present[:, 1:] & batch.present[:, :-1]
    moved = states[:, :-1, :, :2] + 0.1 * states[:, 1:, :, 2:]
    off = (states[:, 1:, :, :2] - moved).abs()[persists]
    assert off.max() < 1e-12
    # Weighing by the posterior of the linearised model costs little where it is nearly linear.
    evidence = collapsed_evidence(model, batch, layout=layout)
    assert ((weights - evidence).abs() < 5).all()


def test_its_moments_are_those_of_the_smoother():
    model, batch = linear(), windows()
    guide = LinearizedGuide(model)
    pyro.set_rng_seed(0)
    draws = torch.stack([guide.path(batch, {})[0] for _ in range(60)])
    mean = guide.mean_path(batch, {})
    error = draws.std(0) / len(draws) ** 0.5
    assert ((draws.mean(0) - mean).abs() <= 6 * error + 1e-12).all()


def test_transitions_whose_noise_it_cannot_draw_are_refused():
    class Half(Transition):
        @property
        def noise_dim(self):
            return 2

    model = StateSpaceModel(initial(), Half(4), PositionEmission(2, 0.1))
    with pytest.raises(InputError, match="moves all 4 features of a state by noise, and Half"):
        LinearizedGuide(model)


def test_limits_of_speed_are_averaged_over():
    """There are paths and an evidence; the linearised model's speeds hardly pass the limit."""
    model, batch = boids(max_speed=2.0), windows()
    guide = LinearizedGuide(model)
    pyro.set_rng_seed(0)
    states, density = guide.path(batch, {})
    assert density.isfinite().all()
    assert collapsed_evidence(model, batch).isfinite().all()
    assert torch.linalg.vector_norm(states[..., 2:], dim=-1).max() < 2.5
