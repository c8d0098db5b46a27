"""What is seen of a state: densities by scipy, exact linearisations, robust weights."""

import math

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import scipy.stats
import torch
from pyro.nn import PyroParam
from torch import nn
from torch.autograd.functional import jacobian

from swarmssm.errors import InputError
from swarmssm.models import (
    Emission,
    NeuralEmission,
    PositionEmission,
    Scales,
    StateEmission,
)
from swarmssm.models.distributions.moments import covariance_of
from swarmssm.models.emissions import DiagonalStudentT

# Said by torch itself, when forward-mode differentiation is first asked for.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.torch.jit.script. is deprecated:DeprecationWarning"
)
DOUBLE = torch.float64
SCALES = Scales(
    space=2,
    individuals=3,
    dt=0.1,
    centre=(5.0, -2.0),
    low=(0.0, -4.0),
    high=(10.0, 0.0),
    length=3.0,
    speed=0.7,
    slow=0.1,
    fast=1.0,
    spacing=1.0,
    step=0.1,
    noise=0.01,
)


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def test_positions_are_seen_with_their_noise_on_each_axis():
    states, seen = rand(5, 3, 4), rand(5, 3, 2, seed=1)
    emission = PositionEmission(2, [0.1, 0.5]).double()
    found = emission(states)
    assert (found.batch_shape, found.event_shape) == ((5, 3), (2,))
    expected = scipy.stats.norm.logpdf(seen, states[..., :2], [0.1, 0.5]).sum(-1)
    np.testing.assert_allclose(found.log_prob(seen), expected, rtol=1e-6)
    assert emission.observes == "positions"


@pytest.mark.parametrize("space", [1, 2, 3])
def test_states_are_seen_with_two_noises(space):
    states, seen = rand(5, 2 * space), rand(5, 2 * space, seed=1)
    emission = StateEmission(space, 0.1, [0.5] * space).double()
    sd = [0.1] * space + [0.5] * space
    expected = scipy.stats.norm.logpdf(seen, states, sd).sum(-1)
    np.testing.assert_allclose(emission(states).log_prob(seen), expected, rtol=1e-6)
    assert emission.observes == "states"


@pytest.mark.parametrize("size", [1, 2, 5])
def test_the_heavy_tailed_density_is_that_of_scipy_and_of_pyro(size):
    loc, scale = rand(size), rand(size, seed=1).exp()
    values = 5 * rand(7, size, seed=2)
    degrees = torch.tensor(3.5, dtype=DOUBLE)
    found = DiagonalStudentT(degrees, loc, scale)
    judge = scipy.stats.multivariate_t(loc.numpy(), np.diag(scale.numpy() ** 2), df=3.5)
    np.testing.assert_allclose(found.log_prob(values), judge.logpdf(values.numpy()), rtol=1e-10)
    twin = dist.MultivariateStudentT(degrees, loc, torch.diag(scale))
    torch.testing.assert_close(found.log_prob(values), twin.log_prob(values))
    torch.testing.assert_close(found.variance, twin.variance)
    torch.testing.assert_close(covariance_of(found), torch.diag(twin.variance))
    torch.testing.assert_close(covariance_of(twin), torch.diag(twin.variance))


def test_heavy_tailed_draws_have_the_quantiles_of_student():
    pyro.set_rng_seed(0)
    number = 40_000
    loc, scale = torch.tensor([1.0, -2.0]), torch.tensor([0.5, 2.0])
    drawn = DiagonalStudentT(torch.tensor(3.0), loc, scale).sample((number,))
    # Each axis is a t of its own, though not independent of the other.
    for axis in range(2):
        standard = ((drawn[:, axis] - loc[axis]) / scale[axis]).numpy()
        for q in (0.01, 0.25, 0.5, 0.9, 0.99):
            below = (standard < scipy.stats.t.ppf(q, 3.0)).mean()
            assert abs(below - q) < 6 * math.sqrt(q * (1 - q) / number)
    # Outliers come on both axes at once: r^2 / 2 is F-distributed with (2, 3) degrees.
    distance = (((drawn - loc) / scale) ** 2).sum(-1).numpy() / 2
    far = (distance > scipy.stats.f.ppf(0.99, 2, 3)).mean()
    assert abs(far - 0.01) < 6 * math.sqrt(0.01 * 0.99 / number)


def test_the_heavy_tailed_distribution_broadcasts_expands_and_differentiates():
    degrees = torch.tensor([2.5, 4.0, 50.0], dtype=DOUBLE)
    one = DiagonalStudentT(degrees, rand(3, 2), torch.tensor(0.5, dtype=DOUBLE))
    assert (one.batch_shape, one.event_shape) == ((3,), (2,))
    wide = one.expand((4, 3))
    values = rand(4, 3, 2, seed=1)
    torch.testing.assert_close(wide.log_prob(values), one.log_prob(values))
    assert wide.rsample((5,)).shape == (5, 4, 3, 2)
    assert one.mask(torch.tensor([True, False, True])).log_prob(values)[0, 1] == 0
    assert DiagonalStudentT(torch.tensor(1.0), rand(2), torch.tensor(1.0)).mean.isnan().all()
    assert DiagonalStudentT(torch.tensor(2.0), rand(2), torch.tensor(1.0)).variance.isinf().all()
    # Drawn with the same noise, a difference quotient in the degrees of freedom.
    slope = degrees.clone().requires_grad_()
    pyro.set_rng_seed(0)
    draws = DiagonalStudentT(slope, rand(3, 2), torch.tensor(0.5, dtype=DOUBLE)).rsample((2000,))
    draws.square().mean().backward()
    assert slope.grad[1] < 0
    with pytest.raises(ValueError, match="degrees"):
        DiagonalStudentT(torch.tensor(-1.0), rand(2), torch.tensor(1.0), validate_args=True)


EMISSIONS = {
    "positions": lambda **o: PositionEmission(2, [0.1, 0.3], **o),
    "states": lambda **o: StateEmission(2, 0.2, [0.4, 0.5], **o),
    "network": lambda **o: NeuralEmission(
        4, 3, [8], [0.1, 0.2, 0.3], centre=1.0, unit=[2.0, 1.0, 1.0], state_scale=3.0, **o
    ),
}


@pytest.mark.parametrize("kind", EMISSIONS)
@pytest.mark.parametrize("tails", ["gaussian", "student"])
@pytest.mark.parametrize("leading", [(), (5,), (2, 5, 3)])
def test_linearisations_are_the_derivative_and_the_covariance(kind, tails, leading):
    emission = EMISSIONS[kind](tails=tails).double()
    states = rand(*leading, 3, 4)
    line = emission.linearize(states)
    here = emission(states)
    torch.testing.assert_close(line.mean, here.mean)
    torch.testing.assert_close(line.noise, covariance_of(here))
    size = here.event_shape[0]
    assert line.jacobian.shape == (*leading, 3, size, 4)
    flat, own = states.reshape(-1, 4), line.jacobian.reshape(-1, size, 4)
    for state, slope in zip(flat, own, strict=True):
        judge = jacobian(lambda z: emission(z).mean, state)
        torch.testing.assert_close(slope, judge, rtol=1e-10, atol=1e-12)


class Bearing(Emission):
    """An emission of a user's: distance to the origin, with noise that differs between two."""

    def forward(self, states):
        far = states[..., :2].norm(dim=-1, keepdim=True)
        sd = torch.tensor([[0.1], [0.2]], dtype=states.dtype)
        return dist.Normal(far, sd).to_event(1)


def test_the_linearisation_that_comes_for_free():
    states = rand(4, 2, 4)
    line = Bearing().linearize(states)
    positions = states[..., :2]
    expected = torch.cat([positions / positions.norm(dim=-1, keepdim=True), 0 * positions], -1)
    torch.testing.assert_close(line.jacobian, expected.unsqueeze(-2))
    torch.testing.assert_close(line.noise[:, 1], torch.full((4, 1, 1), 0.04, dtype=DOUBLE))
    assert torch.equal(Bearing().weights(rand(4, 2, 1)), torch.ones(4, 2, dtype=DOUBLE))


def test_a_linearisation_can_be_differentiated_again():
    """The slope of the slope, d^2 / dz^2 of |p| summed, against finite differences."""
    states = rand(2, 4)
    at = states.clone().requires_grad_()
    Bearing().linearize(at).jacobian.sum().backward()
    step = 1e-6
    for i in range(2):
        for k in range(2):
            moved = [states.clone(), states.clone()]
            moved[0][i, k] += step
            moved[1][i, k] -= step
            up, down = (Bearing().linearize(m).jacobian.sum() for m in moved)
            assert abs((up - down) / (2 * step) - at.grad[i, k]) < 1e-7


def test_robust_weights_are_those_of_the_likelihood():
    """A Gaussian of noise R / w has the slope of the t-density, whatever the residual."""
    emission = PositionEmission(2, [0.1, 0.3], tails="student", excess_degrees=1.5).double()
    states = torch.zeros(6, 4, dtype=DOUBLE)
    residuals = (torch.logspace(-2, 2, 6, dtype=DOUBLE)[:, None] * rand(6, 2)).requires_grad_()
    emission(states).log_prob(residuals).sum().backward()
    noise = torch.diagonal(emission.linearize(states).noise, dim1=-2, dim2=-1)
    weights = emission.weights(residuals.detach())
    assert weights.shape == (6,)
    torch.testing.assert_close(residuals.grad, -residuals.detach() * weights.unsqueeze(-1) / noise)
    assert torch.equal(PositionEmission(2, 0.1).weights(rand(6, 2)), torch.ones(6, dtype=DOUBLE))


def test_many_degrees_of_freedom_are_gaussian():
    states, seen = rand(5, 4), 0.1 * rand(5, 2, seed=1)
    near = PositionEmission(2, 0.3, tails="student", excess_degrees=1e8).double()
    plain = PositionEmission(2, 0.3).double()
    torch.testing.assert_close(
        near(states).log_prob(seen), plain(states).log_prob(seen), rtol=1e-5, atol=1e-6
    )


def test_degrees_and_noise_may_be_random_or_learned():
    emission = PositionEmission(
        2,
        nn.Parameter(torch.tensor(0.1)),
        tails="student",
        excess_degrees=dist.LogNormal(torch.tensor(0.7), 0.5),
    )
    trace = pyro.poutine.trace(emission).get_trace(torch.zeros(3, 4))
    assert trace.nodes["excess_degrees"]["value"] > 0
    # Held positive by its scale.
    assert [name for name, _ in emission.named_parameters()] == ["noise_unconstrained"]
    own = PyroParam(torch.tensor(0.1), torch.distributions.constraints.greater_than(0.01))
    assert PositionEmission(2, own).noise.item() == pytest.approx(0.1)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("kind", EMISSIONS)
@pytest.mark.parametrize("tails", ["gaussian", "student"])
def test_types_follow_the_states(dtype, kind, tails):
    emission = EMISSIONS[kind](tails=tails).to(dtype)
    states = rand(3, 4).to(dtype)
    found = emission(states)
    assert found.sample().dtype == found.log_prob(found.sample()).dtype == dtype
    line = emission.linearize(states)
    assert {part.dtype for part in line} == {dtype}
    assert emission.weights(found.sample() - found.mean).dtype == dtype


def test_a_network_gives_results_of_the_size_of_the_tracks():
    torch.manual_seed(0)
    emission = NeuralEmission.for_scales(SCALES, 6, [16], 0.1)
    made = emission(torch.randn(500, 6)).mean
    assert made.shape == (500, 2)
    # An untrained network gives at the most a few units about the centre.
    assert ((made - torch.tensor([5.0, -2.0])).abs() < 3 * 3.0).all()
    assert made.std() > 0.05 * 3.0
    with torch.no_grad():
        for weight in emission.network.parameters():
            weight.zero_()
    assert torch.equal(emission(torch.randn(2, 6)).mean, torch.tensor([[5.0, -2.0]]).expand(2, 2))
    both = NeuralEmission.for_scales(SCALES, 6, [16], 0.1, observes="states", tails="student")
    assert both(torch.randn(5, 6)).event_shape == (4,)
    assert both.observes == "states"
    assert emission.observes == "positions"
    assert torch.equal(both.unit, torch.tensor([3.0, 3.0, 0.7, 0.7]))


def test_a_network_learns_what_it_is_shown():
    """Distance and direction of a state in polar form, from observations with noise 0.05."""
    torch.manual_seed(0)
    emission = NeuralEmission(2, 2, [32], nn.Parameter(torch.tensor(1.0)))
    states = 2 * torch.rand(600, 2)
    clean = states[:, :1] * torch.stack([states[:, 1].cos(), states[:, 1].sin()], -1)
    seen = clean + 0.05 * torch.randn_like(clean)
    optimizer = torch.optim.Adam(emission.parameters(), lr=0.02)
    for _ in range(400):
        optimizer.zero_grad()
        (-emission(states).log_prob(seen).mean()).backward()
        optimizer.step()
    assert abs(emission.noise.item() - 0.05) < 0.01


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: PositionEmission(2, -0.1), "noise: it must be positive, and it is -0.1"),
        (lambda: PositionEmission(2, 0.0), "noise: it must be positive, .* ExactEmission"),
        (lambda: PositionEmission(2, [1.0, 1.0, 1.0]), r"number or \(2,\) in shape, and it is \(3"),
        (lambda: PositionEmission(0, 0.1), "space must be a positive whole number, not 0"),
        (lambda: PositionEmission(2, dist.Normal(0.0, 1.0)), "noise: it must be positive"),
        (lambda: PositionEmission(2, 0.1, tails="cauchy"), "tails: it must be .* not 'cauchy'"),
        (
            lambda: PositionEmission(2, 0.1, tails="student", excess_degrees=-1),
            "excess_degrees: it must be positive",
        ),
        (lambda: StateEmission(2, 0.1, 0), "velocity_noise: it must be positive"),
        (lambda: NeuralEmission(4, 2, [0], 0.1), r"widths\[1\] must be a positive whole number"),
        (lambda: NeuralEmission(4, 2.0, [8], 0.1), "observation_dim must be a positive whole"),
        (lambda: NeuralEmission(4, 2, [8], 0.1, observes="x"), "observes: it must be"),
        (
            lambda: NeuralEmission(4, 2, [8], 0.1, unit=[1.0, 1.0, 1.0]),
            r"unit: it must be a number or \(2,\) in shape, and it is \(3,\)",
        ),
    ],
)
def test_what_cannot_be_is_refused(build, message):
    with pytest.raises(ValueError, match=message) as caught:
        build()
    assert isinstance(caught.value, InputError) or "whole" in message
