"""The censored velocity against numerical integration, hand-worked numbers and its own draws."""

import math

import mpmath
import numpy as np
import pyro.distributions as dist
import pytest
import torch
from scipy import stats

from swarmssm.models.distributions.speed_limits import SpeedLimited, limit_speed, limited_moments

DOUBLE = torch.float64
LOW, HIGH = 0.6, 1.2


def tensor(*values):
    return torch.tensor(values, dtype=DOUBLE)


def limited(loc, scale, low=LOW, high=HIGH):
    return SpeedLimited(
        torch.as_tensor(loc, dtype=DOUBLE), torch.tensor(scale, dtype=DOUBLE), low, high
    )


def directions(space, number=400):
    """Unit vectors and their weights on circle or sphere, exact for smooth functions."""
    if space == 2:
        angle = torch.arange(number, dtype=DOUBLE) * (2 * math.pi / number)
        weight = torch.full((number,), 2 * math.pi / number, dtype=DOUBLE)
        return torch.stack([angle.cos(), angle.sin()], -1), weight
    node, weight = (torch.from_numpy(part) for part in np.polynomial.legendre.leggauss(64))
    around, share = directions(2, 64)
    flat = (1 - node**2).sqrt()
    vectors = torch.cat(
        [
            flat[:, None, None] * around,
            node[:, None, None].expand(-1, len(around), 1),
        ],
        -1,
    )
    return vectors.reshape(-1, 3), (weight[:, None] * share).reshape(-1)


def masses(distribution, low, high):
    """Return probability on the lower limit, between, and on the upper one, by quadrature."""
    space = distribution.event_shape[0]
    unit, weight = directions(space)
    at_low = distribution.log_prob(low * unit).exp() @ weight * low ** (space - 1)
    at_high = distribution.log_prob(high * unit).exp() @ weight * high ** (space - 1)
    node, share = (torch.from_numpy(part) for part in np.polynomial.legendre.leggauss(50))
    # The ends are at the limits to within the tolerance: keep off them.
    radius = 0.5 * (low + high) + 0.5 * (high - low) * node
    density = distribution.log_prob(radius[:, None, None] * unit).exp() @ weight
    between = (density * radius ** (space - 1)) @ share * 0.5 * (high - low)
    return torch.stack([at_low, between, at_high])


@pytest.mark.parametrize(
    ("loc", "scale"),
    [
        ([1.0, 0.3], 0.1),
        ([0.55, 0.0], 0.08),
        ([1.3, -0.4], 0.2),
        ([0.2, 0.1], 0.3),
        ([0.0, 0.0], 0.7),
        ([0.5, 2.0], 0.3),
        ([0.9, 0.1, -0.2], 0.15),
        ([0.3, 0.3, 0.3], 0.2),
        ([0.0, 0.0, 0.0], 0.5),
        ([1.0, 1.0, 0.4], 0.3),
    ],
)
def test_the_density_integrates_to_one_over_area_and_arcs(loc, scale):
    """Also each part is the probability of a normal vector to be that long (noncentral chi2)."""
    found = masses(limited(loc, scale), LOW, HIGH)
    chi2 = stats.ncx2(len(loc), (np.linalg.norm(loc) / scale) ** 2 + 1e-300)
    below, above = chi2.cdf((LOW / scale) ** 2), chi2.sf((HIGH / scale) ** 2)
    expected = tensor(below, 1 - below - above, above)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)
    torch.testing.assert_close(found.sum().item(), 1.0, rtol=0, atol=1e-10)


def test_a_velocity_around_zero_has_hand_worked_densities():
    """In the plane the length is Rayleigh's, in space Maxwell's, and all directions are alike."""
    s = 0.5
    plane, space = limited([0.0, 0.0], s), limited([0.0, 0.0, 0.0], s)
    at_high = math.exp(-(HIGH**2) / (2 * s**2)) / (2 * math.pi * HIGH)
    at_low = (1 - math.exp(-(LOW**2) / (2 * s**2))) / (2 * math.pi * LOW)
    found = plane.log_prob(tensor([HIGH, 0.0], [0.0, -LOW], [0.0, 0.9])).exp()
    inside = math.exp(-0.81 / (2 * s**2)) / (2 * math.pi * s**2)
    torch.testing.assert_close(found, tensor(at_high, at_low, inside), rtol=1e-12, atol=0)
    maxwell = stats.maxwell(scale=s)
    found = space.log_prob(tensor([HIGH, 0.0, 0.0], [0.0, 0.0, LOW])).exp()
    expected = tensor(
        maxwell.sf(HIGH) / (4 * math.pi * HIGH**2), maxwell.cdf(LOW) / (4 * math.pi * LOW**2)
    )
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)


def exact_log_density(loc, scale, unit, low, high):
    """The defining integral with 50 digits; low is None on the upper circle, high on the lower."""
    with mpmath.workdps(50):
        space = len(loc)
        along = mpmath.fsum(mpmath.mpf(a) * b for a, b in zip(loc, unit, strict=True))
        across = mpmath.fsum(
            (mpmath.mpf(a) - along * b) ** 2 for a, b in zip(loc, unit, strict=True)
        )
        s = mpmath.mpf(scale)
        start = mpmath.mpf(0 if low is None else low)
        limit = mpmath.mpf(high if low is None else low)
        # Steps from the greatest point of the integrand in units of how fast it falls there.
        top = max(along, start) if low is not None else min(max(along, start), limit)
        width = s / max(1, abs(top - along) / s)
        steps = (0.5, 1, 2, 4, 8, 16, 32, 64)
        points = sorted([top, *(top + sign * width * k for k in steps for sign in (-1, 1))])
        if low is None:
            ends = [start, *(p for p in points if start < p < limit), limit]
        else:
            ends = [start, *(p for p in points if p > start), top + width * 400]
        integral = mpmath.quad(
            lambda r: (r / limit) ** (space - 1) * mpmath.exp(-((r - along) ** 2) / (2 * s**2)),
            ends,
        )
        return float(
            mpmath.log(integral)
            - across / (2 * s**2)
            - mpmath.mpf(space) / 2 * mpmath.log(2 * mpmath.pi * s**2)
        )


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize(
    ("along", "scale"),
    [(1.0, 0.02), (-1.0, 0.02), (0.0, 0.02), (0.6, 0.02), (30.0, 0.02), (0.3, 3.0), (-5.0, 0.3)],
)
def test_far_in_the_tails_the_density_is_that_of_the_integral(space, along, scale):
    """Up to 1500 standard deviations off, where probabilities are below exp(-1e6)."""
    loc = [along, 0.1, 0.0][:space]
    unit = [1.0, 0.0, 0.0][:space]
    distribution = limited(loc, scale)
    found = distribution.log_prob(tensor(*unit) * tensor(LOW, HIGH)[:, None])
    expected = tensor(
        exact_log_density(loc, scale, unit, None, LOW),
        exact_log_density(loc, scale, unit, HIGH, None),
    )
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("space", [2, 3])
def test_gradients_are_finite_and_right_wherever_a_velocity_is(space):
    unit = tensor(1.0, 0.0, 0.0)[:space]
    values = torch.stack([LOW * unit, 0.9 * unit, HIGH * unit, -HIGH * unit, 0.0 * unit])
    for speed in (-3.0, 0.0, 0.61, 1.0, 25.0):
        loc = (speed * unit + 0.05).requires_grad_(True)
        for scale in (0.02, 0.4):
            s = torch.tensor(scale, dtype=DOUBLE, requires_grad=True)
            low, high = tensor(LOW, HIGH).requires_grad_(True).unbind()

            def density(loc, s, low, high):
                score = SpeedLimited(loc, s, low, high, tolerance=1e-3).log_prob(values)
                return score.sum() / 1e3

            gradient = torch.autograd.grad(density(loc, s, low, high), (loc, s, low, high))
            assert all(part.isfinite().all() for part in gradient)
            if abs(speed) < 2:
                torch.autograd.gradcheck(density, (loc, s, low, high), rtol=1e-5, atol=1e-5)


def test_without_limits_it_is_the_normal_density():
    loc, scale = tensor(0.3, -0.1), torch.tensor(0.4, dtype=DOUBLE, requires_grad=True)
    free = SpeedLimited(loc, scale)
    normal = dist.Normal(loc, scale).to_event(1)
    values = tensor([0.0, 0.0], [2.0, -1.0], [0.1, 0.5])
    torch.testing.assert_close(free.log_prob(values), normal.log_prob(values))
    torch.testing.assert_close(free.mean, loc)
    (gradient,) = torch.autograd.grad(free.covariance_matrix.sum(), scale)
    # Of the sum of the diagonal, 2 s^2, up to the thousandth that keeps matrices definite.
    torch.testing.assert_close(gradient.item(), 2 * 2 * 0.4, rtol=1e-3, atol=0)


def test_velocities_rounded_to_float32_are_recognised_at_the_limit():
    generator = torch.Generator().manual_seed(0)
    loc = 0.6 + 0.4 * torch.randn(20_000, 2, dtype=DOUBLE, generator=generator)
    exact = limit_speed(loc, LOW, HIGH)
    distribution = limited(loc, 0.1)
    low, high = distribution.is_at_limit(exact)
    assert 0.05 < low.double().mean() < 0.5
    assert 0.2 < high.double().mean() < 0.9
    rounded = distribution.is_at_limit(exact.float().double())
    assert torch.equal(rounded[0], low)
    assert torch.equal(rounded[1], high)
    single = SpeedLimited(loc.float(), torch.tensor(0.1), LOW, HIGH)
    score = single.log_prob(exact.float())
    assert score.dtype == torch.float32
    # What a rounding of 6e-8 is at up to 40 standard deviations of 0.1.
    torch.testing.assert_close(score.double(), distribution.log_prob(exact), rtol=1e-5, atol=1e-3)


def test_a_speed_beyond_a_limit_counts_as_at_it():
    distribution = limited([0.8, 0.2], 0.3)
    unit = tensor(0.6, 0.8)
    score = distribution.log_prob(tensor(0.1, LOW, HIGH, 5.0)[:, None] * unit)
    torch.testing.assert_close(score[0], score[1], rtol=1e-12, atol=0)
    torch.testing.assert_close(score[2], score[3], rtol=1e-12, atol=0)
    just_inside = distribution.log_prob(tensor(HIGH * (1 - 1e-5)) * unit)
    assert abs(just_inside - score[2]) > 0.1


@pytest.mark.parametrize("space", [2, 3])
def test_draws_are_at_the_limits_as_often_as_the_density_says(space):
    number = 40_000
    torch.manual_seed(3)
    loc = [1.1, 0.1, 0.0][:space]
    distribution = limited(loc, 0.25)
    drawn = distribution.sample((number,))
    low, high = distribution.is_at_limit(drawn)
    counted = torch.stack([low, ~low & ~high, high]).double().mean(-1)
    expected = masses(distribution, LOW, HIGH)
    error = (expected * (1 - expected) / number).sqrt()
    assert ((counted - expected).abs() < 6 * error).all()
    # Of the directions too: the mean of the density's own integral.
    unit, weight = directions(space)
    part = distribution.log_prob(HIGH * unit).exp() * weight * HIGH ** (space - 1)
    mean = (part[:, None] * unit).sum(0) / part.sum()
    on = drawn[high] / HIGH
    assert ((on.mean(0) - mean).abs() < 6 * on.std(0) / len(on) ** 0.5).all()


@pytest.mark.parametrize("loc", [[0.9, 0.3], [1.19, 0.1], [1.3, 0.0], [0.5, 0.3], [0.5, 0.2, 0.2]])
def test_moments_are_those_of_draws_while_noise_is_below_the_speed(loc):
    """What is neglected is of fourth order in the ratio of noise to speed, here 1/10 or less."""
    scale = 0.05
    distribution = limited(loc, scale)
    torch.manual_seed(4)
    number = 400_000
    drawn = distribution.sample((number,))
    error = drawn.std(0) / number**0.5
    assert ((drawn.mean(0) - distribution.mean).abs() < 6 * error + 0.1**4).all()
    covariance = torch.cov(drawn.T)
    found = distribution.covariance_matrix
    assert (torch.linalg.eigvalsh(found) > 0).all()
    spread = 6 * (2 / number) ** 0.5 * scale**2
    # Curvature adds half the square of the tangential variance over the squared speed.
    assert ((covariance - found).abs() < spread + 3 * scale**4 / 0.5**2).all()
    torch.testing.assert_close(distribution.variance, found.diagonal(dim1=-2, dim2=-1))


def test_the_gain_is_the_derivative_of_the_mean_and_far_from_limits_the_identity():
    covariance = tensor([0.02, 0.005], [0.005, 0.01])
    for mean in ([0.9, 0.1], [1.2, 0.3], [0.1, 0.4], [3.0, 1.0], [0.0, 0.0]):
        at = tensor(*mean)
        jacobian = torch.autograd.functional.jacobian(
            lambda m: limited_moments(m, covariance, LOW, HIGH).mean, at, vectorize=False
        )
        found = limited_moments(at, covariance, LOW, HIGH)
        if mean == [0.9, 0.1]:
            # Variances along and across the mean, which turns, are part of the derivative.
            assert (found.gain - jacobian).abs().max() < 0.05
        assert found.gain.isfinite().all()
    isotropic = 0.01 * torch.eye(2, dtype=DOUBLE)
    for mean in ([0.9, 0.1], [1.2, 0.3], [0.5, 0.4], [3.0, 1.0]):
        at = tensor(*mean)
        jacobian = torch.autograd.functional.jacobian(
            lambda m: limited_moments(m, isotropic, LOW, HIGH).mean, at
        )
        found = limited_moments(at, isotropic, LOW, HIGH)
        torch.testing.assert_close(found.gain, jacobian, rtol=0, atol=1e-12)
    free = limited_moments(tensor(0.9, 0.1), covariance, 0.0, math.inf)
    torch.testing.assert_close(free.mean, tensor(0.9, 0.1))
    torch.testing.assert_close(free.gain, torch.eye(2, dtype=DOUBLE))
    # A thousandth of the largest variance.
    assert free.residual.abs().max() < 0.023e-3


def test_it_expands_and_crossing_limits_leave_the_upper_one():
    distribution = limited([0.8, 0.2], 0.3).expand((4, 3))
    assert distribution.batch_shape == (4, 3)
    assert distribution.sample((2,)).shape == (2, 4, 3, 2)
    value = tensor(0.7, 0.3)
    torch.testing.assert_close(
        distribution.log_prob(value), limited([0.8, 0.2], 0.3).log_prob(value).expand(4, 3)
    )
    crossed = limited([0.8, 0.2], 0.3, low=2.0, high=1.0).sample((50,))
    torch.testing.assert_close(
        torch.linalg.vector_norm(crossed, dim=-1), torch.ones(50, dtype=DOUBLE)
    )


def test_reparametrised_draws_carry_gradients():
    loc = tensor(1.0, 0.0).requires_grad_(True)
    torch.manual_seed(0)
    drawn = SpeedLimited(loc, torch.tensor(0.1, dtype=DOUBLE), LOW, HIGH).rsample((1000,))
    (gradient,) = torch.autograd.grad(drawn.sum((0, 1)), loc)
    assert gradient.isfinite().all()
    # Across the direction a draw follows its mean; along it only between the limits.
    assert 0.8 * 1000 < gradient[0] < 1000


def test_other_than_two_or_three_dimensions_are_refused():
    with pytest.raises(ValueError, match="2 or 3 coordinates"):
        limited([1.0], 0.1)


def test_who_stands_still_stays():
    assert torch.equal(limit_speed(tensor([0.0, 0.0]), LOW, HIGH), tensor([0.0, 0.0]))
