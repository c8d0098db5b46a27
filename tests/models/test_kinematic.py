"""The next state of a body, against its velocity's distribution."""

import pyro
import pyro.distributions as dist
import pytest
import torch

from swarmssm.models import Kinematic, MarkovChain
from swarmssm.models.transitions import KinematicTransition

DOUBLE = torch.float64
DT = 0.2


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def body(*leading, space=2, seed=0):
    velocity = dist.Normal(rand(*leading, space, seed=seed), 0.3).to_event(1)
    return Kinematic(rand(*leading, space, seed=seed + 1), velocity, DT)


@pytest.mark.parametrize("space", [1, 2, 3])
def test_the_density_is_that_of_the_velocity(space):
    kinematic = body(5, space=space)
    assert kinematic.batch_shape == (5,)
    assert kinematic.event_shape == (2 * space,)
    velocity = rand(7, 5, space, seed=3)
    states = kinematic.complete(velocity)
    torch.testing.assert_close(states[..., :space], kinematic.position + DT * velocity)
    expected = dist.Normal(rand(5, space), 0.3).log_prob(velocity).sum(-1)
    torch.testing.assert_close(kinematic.log_prob(states), expected)


def test_draws_lie_on_the_surface_and_have_its_moments():
    kinematic = body(3)
    pyro.set_rng_seed(0)
    number = 40_000
    drawn = kinematic.rsample((number,))
    assert not kinematic.is_off_surface(drawn).any()
    sd = kinematic.variance.sqrt()
    torch.testing.assert_close(sd[:, :2], torch.full((3, 2), 0.3 * DT, dtype=DOUBLE))
    assert ((drawn.mean(0) - kinematic.mean).abs() < 6 * sd / number**0.5).all()
    covariance = kinematic.covariance_matrix
    # [dt^2 s^2, dt s^2; dt s^2, s^2] on each axis.
    by_hand = 0.09 * torch.kron(
        torch.tensor([[DT**2, DT], [DT, 1.0]], dtype=DOUBLE), torch.eye(2, dtype=DOUBLE)
    )
    torch.testing.assert_close(covariance, by_hand.expand(3, 4, 4))
    spread = (2 / number) ** 0.5 * sd.unsqueeze(-1) * sd.unsqueeze(-2)
    for i in range(3):
        assert ((drawn[:, i].T.cov() - covariance[i]).abs() < 6 * spread[i]).all()


def test_a_velocity_with_correlated_axes():
    matrix = torch.tensor([[0.5, 0.2], [0.2, 0.4]], dtype=DOUBLE)
    velocity = dist.MultivariateNormal(rand(3, 2), matrix)
    covariance = Kinematic(rand(3, 2), velocity, DT).covariance_matrix
    blocks = torch.tensor([[DT**2, DT], [DT, 1.0]], dtype=DOUBLE)
    torch.testing.assert_close(covariance, torch.kron(blocks, matrix).expand(3, 4, 4))


def test_shapes_broadcast_and_expand():
    one = dist.Normal(torch.zeros(2, dtype=DOUBLE), 1.0).to_event(1)
    kinematic = Kinematic(rand(4, 3, 2), one, DT)
    assert kinematic.batch_shape == (4, 3)
    wide = kinematic.expand((5, 4, 3))
    assert wide.batch_shape == (5, 4, 3)
    states = kinematic.complete(rand(5, 4, 3, 2, seed=2))
    torch.testing.assert_close(wide.log_prob(states), kinematic.log_prob(states))
    many = dist.Normal(rand(6, 1, 1, 2), 1.0).to_event(1)
    assert Kinematic(rand(4, 3, 2), many, DT).batch_shape == (6, 4, 3)
    assert wide.rsample((2,)).shape == (2, 5, 4, 3, 4)


def test_a_velocity_that_cannot_be_differentiated_can_be_drawn():
    mixture = dist.MixtureSameFamily(
        dist.Categorical(torch.ones(2)), dist.Normal(rand(2, 2, seed=1), 1.0).to_event(1)
    )
    kinematic = Kinematic(rand(5, 2), mixture, DT)
    assert not kinematic.has_rsample
    assert body(3).has_rsample
    assert kinematic.sample().shape == (5, 4)
    assert kinematic().shape == (5, 4)


def test_gradients_pass_through_draws():
    loc = rand(3, 2).requires_grad_()
    Kinematic(rand(3, 2), dist.Normal(loc, 0.1).to_event(1), DT).rsample().sum().backward()
    # A velocity counts once as itself and dt times in the position.
    torch.testing.assert_close(loc.grad, torch.full((3, 2), 1.0 + DT, dtype=DOUBLE))


def test_what_does_not_fit_is_refused_with_both_shapes():
    with pytest.raises(ValueError, match="positions have 3 coordinates and velocities 2"):
        Kinematic(rand(4, 3), dist.Normal(rand(4, 2), 1.0).to_event(1), DT)
    with pytest.raises(ValueError, match=r"event shape \(space,\), and it is \(\); \.to_event"):
        Kinematic(rand(4, 2), dist.Normal(rand(4, 2), 1.0), DT)


class Walk(KinematicTransition):
    def velocity(self, positions, velocities, inputs):
        return dist.Normal(velocities, 1.0).to_event(1)


def chain(steps, dtype, first):
    initial = dist.Normal(first.to(dtype), 1.0).to_event(1)
    return MarkovChain(initial, Walk(2, DT), steps, 2, validate_args=True)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_summed_paths_are_on_the_surface_wherever_they_lead(dtype):
    """From far away through the origin: the rounding is that of the long way."""
    first = torch.tensor([-1e3, 0.0, 10.0, 0.0])
    steps = 1000
    velocities = torch.tensor([10.0, 0.0]).expand(steps - 1, 2, 2) + 0.01 * rand(steps - 1, 2, 2)
    path = Walk(2, DT).path(first.to(dtype).expand(2, 4), velocities.to(dtype))
    assert path[:, :, 0].min() < -900
    assert path[:, :, 0].abs().min() < 2.0
    assert path.shape == (steps, 2, 4)
    score = chain(steps, dtype, first).log_prob(path)
    expected = dist.Normal(first.to(dtype), 1.0).log_prob(path[0]).sum()
    expected = expected + dist.Normal(path[:-1, :, 2:], 1.0).log_prob(path[1:, :, 2:]).sum()
    torch.testing.assert_close(score, expected)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_a_path_off_the_surface_is_refused(dtype):
    first = torch.zeros(4)
    law = chain(5, dtype, first)
    path = law.sample()
    law.log_prob(path)
    path[3, 1, 0] += 1e-3
    with pytest.raises(ValueError, match=r"must follow from its velocities, p' = p \+ dt v'"):
        law.log_prob(path)
    unchecked = MarkovChain(law.initial, law.transition, 5, 2, validate_args=False)
    assert unchecked.log_prob(path).isfinite()


def test_positions_of_the_absent_are_not_looked_at():
    present = torch.ones(4, 2, dtype=torch.bool)
    present[2:, 1] = False
    law = MarkovChain(
        dist.Normal(torch.zeros(4), 1.0).to_event(1),
        Walk(2, DT),
        4,
        2,
        mask=present,
        validate_args=True,
    )
    path = law.sample()
    assert (path[2:, 1] == 0).all()
    assert law.log_prob(path).isfinite()
