"""Laws of their own for types of edges."""

import pyro.distributions as dist
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.models import StepInputs
from swarmssm.models.distributions.moments import location_of
from swarmssm.models.distributions.speed_limits import SpeedLimited
from swarmssm.models.emissions.student import DiagonalStudentT
from swarmssm.models.transitions import (
    BoidsTransition,
    LinearForceTransition,
    LinearTransition,
    TypedKinematicTransition,
    TypedTransition,
    typed,
)
from swarmssm.models.transitions.typed_forces import displaced

DOUBLE = torch.float64


def states(seed=0):
    return torch.randn(3, 5, 4, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def types(number, seed=1):
    drawn = torch.randint(number, (3, 5, 5), generator=torch.Generator().manual_seed(seed))
    hot = torch.nn.functional.one_hot(drawn, number).to(DOUBLE)
    return hot * (1.0 - torch.eye(5, dtype=DOUBLE)).unsqueeze(-1)


def flock(separation, **own):
    gains = {"cohesion_gain": 0.0, "separation_gain": separation, "alignment_gain": 0.0}
    return BoidsTransition(2, 0.1, **gains, process_noise=0.1, **own)


def test_each_type_pushes_with_its_own_strength():
    # Pushes add up over the neighbours: two laws of one form are one law of a weighted graph.
    own = {"wall_gain": 1.0, "half_width": 0.5, "max_speed": 1.0}
    both = TypedKinematicTransition([flock(1.0, **own), flock(3.0)])
    chosen = types(3)
    found = both(states(), StepInputs(edge_types=chosen))
    weighted = chosen @ torch.tensor([0.0, 1.0, 3.0], dtype=DOUBLE)
    expected = flock(1.0, **own)(states(), StepInputs(weighted))
    assert torch.allclose(found.velocity.loc, expected.velocity.loc)
    assert torch.allclose(found.mean, expected.mean)
    assert torch.allclose(found.log_prob(found.mean), expected.log_prob(found.mean))


def test_without_a_type_that_is_none_all_act():
    both = TypedKinematicTransition([flock(1.0), flock(3.0)], no_edge=False)
    chosen = types(2)
    weighted = chosen @ torch.tensor([1.0, 3.0], dtype=DOUBLE)
    expected = flock(1.0)(states(), StepInputs(weighted))
    assert torch.allclose(both(states(), StepInputs(edge_types=chosen)).mean, expected.mean)
    # Without types, all edges are of the first.
    plain = both(states(), StepInputs(weighted))
    assert torch.equal(plain.mean, expected.mean)


def test_what_neighbours_do_is_the_difference_that_edges_make():
    graph = types(2)[..., 1]
    laws = [
        flock(1.0, wall_gain=1.0, half_width=0.5, relaxation_gain=1.0, preferred_speed=1.0),
        LinearForceTransition(
            2,
            0.1,
            cohesion_gain=1.0,
            alignment_gain=2.0,
            damping=0.5,
            process_noise=0.1,
            homing_gain=0.3,
        ),
        LinearTransition(4, 0.9, 0.1, coupling=0.2, offset=0.3),
    ]
    for law in laws:
        law.double()
        whole = location_of(law(states(), StepInputs(graph)))
        alone = location_of(law(states(), StepInputs(torch.zeros_like(graph))))
        assert torch.allclose(law.pairwise(states(), StepInputs(graph)), whole - alone)
        assert whole.shape[-1] == law.noise_dim


def test_laws_of_states_that_are_all_free():
    two = typed(LinearTransition(4, 0.9, 0.1, coupling=0.2), 2).double()
    assert isinstance(two, TypedTransition)
    assert not isinstance(two, TypedKinematicTransition)
    chosen = types(3)
    graphs = chosen.unbind(-1)
    found = two(states(), StepInputs(edge_types=chosen))
    one = two.first
    expected = one(states(), StepInputs(graphs[1])).mean
    expected = expected + two.laws[1].pairwise(states(), StepInputs(graphs[2]))
    assert torch.allclose(found.mean, expected)
    assert torch.equal(
        found.covariance_matrix, one(states(), StepInputs(graphs[1])).covariance_matrix
    )


def test_the_linearisation_is_that_of_the_sum():
    both = TypedKinematicTransition([flock(1.0), flock(3.0)]).double()
    chosen = types(3)
    weighted = chosen @ torch.tensor([0.0, 1.0, 3.0], dtype=DOUBLE)
    found = both.linearize(states(), StepInputs(weighted, edge_types=chosen))
    expected = flock(1.0).double().linearize(states(), StepInputs(weighted))
    for name in ("mean", "jacobian", "noise"):
        assert torch.allclose(getattr(found, name), getattr(expected, name), atol=1e-10)


def test_distributions_are_moved():
    at, scale = torch.zeros(5, 2), torch.ones(5, 2)
    laws = [
        dist.Normal(at, scale).to_event(1),
        dist.MultivariateNormal(at, scale_tril=torch.eye(2)),
        DiagonalStudentT(torch.tensor(5.0), at, scale),
    ]
    for law in laws:
        moved = displaced(law, torch.full((5, 2), 2.0))
        assert torch.equal(moved.mean, torch.full((5, 2), 2.0))
        assert torch.equal(moved.variance, law.variance)
    limited = displaced(SpeedLimited(at, scale[:, 0], 0.0, 1.0), torch.full((5, 2), 2.0))
    assert torch.equal(limited.loc, torch.full((5, 2), 2.0))
    with pytest.raises(InputError, match="laws=common"):
        displaced(dist.Laplace(at, scale).to_event(1), at)


def test_laws_that_do_not_go_together_are_refused():
    with pytest.raises(InputError, match="same kind"):
        TypedKinematicTransition([flock(1.0), LinearTransition(4, 0.9, 0.1)])
    with pytest.raises(ValueError, match="2 laws, and 3 types"):
        TypedKinematicTransition([flock(1.0), flock(1.0)])(
            states(), StepInputs(edge_types=types(4))
        )
