r"""Normal velocities whose length is brought between two limits.

Who would be too fast goes on in the same direction at the highest speed, who would be too slow at
the lowest. The noise is *censored*: many velocities lie exactly on the two circles (in three
dimensions, spheres) of extreme speed, and a model that takes them for normal ones underrates every
force by a fifth where a quarter of all velocities lie there.
"""

import math
from typing import Any, ClassVar, NamedTuple

import torch
from pyro.distributions import TorchDistribution
from torch import Tensor
from torch.distributions import constraints

__all__ = ["TOLERANCE", "LimitedMoments", "SpeedLimited", "limit_speed", "limited_moments"]

#: A speed within this part of a limit is at the limit: eight roundings of a float32.
TOLERANCE = 1e-6
#: Beyond so many standard deviations nothing of a normal distribution is left.
FAR = 40.0
#: Part of the variance of a speed that is left where limits take all of it, so that matrices stay
#: definite and well conditioned.
LEAST_RESIDUAL = 1e-3
#: Where the moments of the tail go over to their asymptotic series.
SERIES_FROM = 30.0
SERIES_TERMS = 7


def limit_speed(velocities: Tensor, low: Tensor | float, high: Tensor | float) -> Tensor:
    """Bring the length of velocities between two limits.

    Parameters
    ----------
    velocities
        ``(..., space)``.
    low, high
        Limits, which broadcast against ``(...)``.

    Returns
    -------
    ``(..., space)``. A velocity of 0, which has no direction, stays 0.
    """
    squared = velocities.square().sum(-1)
    moving = squared > 0
    speed = torch.where(moving, squared, 1.0).sqrt()
    allowed = torch.minimum(torch.maximum(speed, _as(low, speed)), _as(high, speed))
    factor = torch.where(allowed == speed, 1.0, allowed / speed)
    return velocities * factor.unsqueeze(-1)


class SpeedLimited(TorchDistribution):  # type: ignore[misc]
    r"""Velocity :math:`x = y\, \mathrm{clamp}(|y|, lo, hi) / |y|` of a normal
    :math:`y \sim N(m, s^2 I)`.

    The density is taken with respect to area between the limits, where it is the normal one, and
    to the length of arc on the two circles (volume, and area of the two spheres). On the upper
    one, with the direction :math:`u = x / |x|`, :math:`a = m \cdot u` and d dimensions,

    .. math::
        f(u) = \frac{e^{-|m - a u|^2 / 2 s^2}}{(2 \pi s^2)^{d/2}}
        \int_{hi}^\infty \Bigl(\frac{r}{hi}\Bigr)^{d-1} e^{-(r - a)^2 / 2 s^2}\, dr

    and on the lower one the same from 0 to lo. Both have closed forms in two and three dimensions,
    which are evaluated in float64 without loss in the tails.

    Parameters
    ----------
    loc
        m, ``(..., space)``, two or three dimensions.
    scale
        s, ``(...)``.
    low, high
        Limits of speed, ``(...)``; 0 and ``math.inf`` where there is none.
    tolerance
        A speed counts as being at a limit if it is beyond it, or short of it by at most this part
        of it. Speeds beyond a limit are thus scored as if they had been brought back to it. That
        makes the density one of speeds *known up to the limits*, right whatever the limits of the
        true law, as long as these do not lie between ``low`` and ``high``.

    Raises
    ------
    ValueError
        If there are not two or three dimensions.
    """

    arg_constraints: ClassVar[dict[str, Any]] = {
        "loc": constraints.independent(constraints.real, 1),  # type: ignore[no-untyped-call]
        "scale": constraints.positive,
        "low": constraints.nonnegative,
        "high": constraints.positive,
    }
    support = constraints.real_vector
    has_rsample = True

    def __init__(
        self,
        loc: Tensor,
        scale: Tensor,
        low: Tensor | float = 0.0,
        high: Tensor | float = math.inf,
        *,
        tolerance: float = TOLERANCE,
        validate_args: bool | None = None,
    ) -> None:
        space = loc.shape[-1]
        if space not in (2, 3):
            raise ValueError(f"loc must have 2 or 3 coordinates, and its shape is {loc.shape}")
        low, high = _as(low, loc), _as(high, loc)
        batch_shape = torch.broadcast_shapes(  # type: ignore[no-untyped-call]
            loc.shape[:-1], scale.shape, low.shape, high.shape
        )
        self.loc = loc.expand(*batch_shape, space)
        self.scale = scale.expand(batch_shape)
        self.high = high.expand(batch_shape)
        # Where a search tries limits that cross, the upper one holds.
        self.low = torch.minimum(low.expand(batch_shape), self.high)
        self.tolerance = tolerance
        super().__init__(batch_shape, torch.Size([space]), validate_args=validate_args)

    def expand(self, batch_shape: Any, _instance: Any = None) -> "SpeedLimited":
        """Return the distribution with another batch shape."""
        batch_shape = torch.Size(batch_shape)
        return SpeedLimited(
            self.loc.expand(*batch_shape, *self.event_shape),
            self.scale.expand(batch_shape),
            self.low.expand(batch_shape),
            self.high.expand(batch_shape),
            tolerance=self.tolerance,
            validate_args=False,
        )

    def rsample(self, sample_shape: Any = torch.Size()) -> Tensor:  # noqa: B008
        """Draw velocities, differentiably."""
        shape = self._extended_shape(torch.Size(sample_shape))
        noise = torch.randn(shape, dtype=self.loc.dtype, device=self.loc.device)
        return limit_speed(self.loc + self.scale.unsqueeze(-1) * noise, self.low, self.high)

    def is_at_limit(self, value: Tensor) -> tuple[Tensor, Tensor]:
        """Return which velocities ``(..., space)`` are at the lower and at the upper limit."""
        speed = torch.linalg.vector_norm(value.detach(), dim=-1)
        at_high = speed >= self.high * (1.0 - self.tolerance)
        at_low = (speed <= self.low * (1.0 + self.tolerance)) & (self.low > 0)
        return at_low & ~at_high, at_high

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the log-density of velocities ``(..., space)``."""
        if self._validate_args:
            self._validate_sample(value)
        dtype = value.dtype
        at_low, at_high = self.is_at_limit(value)
        value, loc, scale = value.double(), self.loc.double(), self.scale.double()
        space = self.event_shape[0]
        constant = -0.5 * space * math.log(2 * math.pi) - space * scale.log()

        squared = value.square().sum(-1)
        moving = squared > 0
        direction = value / torch.where(moving, squared, 1.0).sqrt().unsqueeze(-1)
        along = (loc * direction).sum(-1)
        across = (loc - along.unsqueeze(-1) * direction).square().sum(-1)
        inside = -0.5 * (value - loc).square().sum(-1) / scale**2
        outer = -0.5 * across / scale**2

        # What a branch does not need is put where it is harmless, for the sake of the gradient.
        low = torch.where(at_low, self.low, 1.0).double()
        high = torch.where(at_high, self.high, 1.0).double()
        below = _log_ball(torch.where(at_low, along, 0.0), scale, low, space - 1)
        above = _log_tail(torch.where(at_high, along, 0.0), scale, high, space - 1)
        below = below - (space - 1) * low.log()
        above = above - (space - 1) * high.log()
        score = torch.where(at_high, outer + above, torch.where(at_low, outer + below, inside))
        total: Tensor = (score + constant).to(dtype)
        return total

    @property
    def _moments(self) -> "LimitedMoments":
        eye = torch.eye(self.event_shape[0], dtype=self.loc.dtype, device=self.loc.device)
        covariance = self.scale.square()[..., None, None] * eye
        return limited_moments(self.loc, covariance, self.low, self.high)

    @property
    def mean(self) -> Tensor:
        """Mean, by :func:`limited_moments`, ``(..., space)``."""
        return self._moments.mean

    @property
    def covariance_matrix(self) -> Tensor:
        """Covariance, by :func:`limited_moments`, ``(..., space, space)``."""
        moments = self._moments
        gained = self.scale.square()[..., None, None] * (moments.gain @ moments.gain.mT)
        return gained + moments.residual

    @property
    def variance(self) -> Tensor:
        """Diagonal of the covariance, ``(..., space)``."""
        return self.covariance_matrix.diagonal(dim1=-2, dim2=-1)


class LimitedMoments(NamedTuple):
    r"""A normal velocity y, limited, as an affine function of itself:
    :math:`x \approx \mu + A (y - m) + \epsilon,\; \epsilon \sim N(0, R)`.

    Attributes
    ----------
    mean
        :math:`\mu`, ``(..., space)``.
    gain
        A, ``(..., space, space)``.
    residual
        R, ``(..., space, space)``: what the affine function leaves unexplained.
    """

    mean: Tensor
    gain: Tensor
    residual: Tensor


def limited_moments(
    mean: Tensor, covariance: Tensor, low: Tensor | float, high: Tensor | float
) -> LimitedMoments:
    r"""Linearise the limits statistically: the affine function of y nearest to the limited y.

    The speed :math:`|y|` is taken as normal with mean :math:`\rho`, where
    :math:`\rho^2 = |m|^2 + \mathrm{tr}\, P - \sigma^2`, and the variance :math:`\sigma^2` of y in
    the direction of m; c is that speed, censored at the limits. Then

    .. math::
        \mu = g m, \quad g = E[c] / \rho, \qquad
        A = g I + (P(lo < |y| < hi) - g)\, m m^\top / \rho^2, \qquad
        R = (\mathrm{Var}[c] - P(lo < |y| < hi)^2 \sigma^2)\, u u^\top

    where R is at least a thousandth of :math:`\sigma^2 u u^\top`, so that it can be inverted. Far
    from the limits this is y itself. All three are smooth in everything, the limits included,
    and A is the derivative of :math:`\mu` for a fixed covariance. Good while the standard
    deviations are below the speed.

    Parameters
    ----------
    mean
        m, ``(..., space)``.
    covariance
        P, ``(..., space, space)``, with a positive diagonal.
    low, high
        Limits of speed, which broadcast against ``(...)``; 0 and ``math.inf`` where there is none.
    """
    squared = mean.square().sum(-1)
    trace = covariance.diagonal(dim1=-2, dim2=-1).sum(-1)
    space = mean.shape[-1]
    # A little of the variance keeps the direction smooth where the mean is 0.
    blur = (1e-3 / space) * trace
    length2 = squared + blur
    along = (covariance @ mean.unsqueeze(-1)).squeeze(-1)
    radial = ((along * mean).sum(-1) + blur * trace / space) / length2
    # Rounding may leave a filter's covariance with an eigenvalue below 0.
    radial = torch.maximum(radial, 1e-6 * trace)
    rho2 = squared + trace - radial
    rho, sigma = rho2.sqrt(), radial.sqrt()
    low, high = _as(low, rho), _as(high, rho)
    # Infinity minus the mean would make the gradient NaN.
    upper = torch.where(high.isinf(), FAR, (torch.where(high.isinf(), rho, high) - rho) / sigma)
    lower = torch.where(low > 0, (low - rho) / sigma, -FAR)
    censored = _censored(lower, upper)
    factor = 1.0 + sigma * censored.mean / rho
    left = (censored.variance - censored.inside.square()).clamp(min=LEAST_RESIDUAL) * radial
    outer = mean.unsqueeze(-1) * mean.unsqueeze(-2)
    eye = torch.eye(space, dtype=mean.dtype, device=mean.device)
    pull = ((censored.inside - factor) / rho2)[..., None, None]
    return LimitedMoments(
        factor.unsqueeze(-1) * mean,
        factor[..., None, None] * eye + pull * outer,
        (left / length2)[..., None, None] * outer,
    )


class _Censored(NamedTuple):
    """Moments of a standard normal that is brought between two limits."""

    mean: Tensor
    variance: Tensor
    inside: Tensor


def _censored(low: Tensor, high: Tensor) -> _Censored:
    """Return mean, variance and probability inside of a censored standard normal."""
    low = torch.minimum(low.clamp(min=-FAR), high)
    high = torch.maximum(high.clamp(max=FAR), low)
    below, above = torch.special.ndtr(low), torch.special.ndtr(-high)
    at_low, at_high = _normal_density(low), _normal_density(high)
    inside = (1.0 - below - above).clamp(min=0.0)
    # About the point where most of it is, or large squares would be taken from each other.
    middle = torch.minimum(low.clamp(min=0.0) + high.clamp(max=0.0), high)
    first = (low - middle) * below + (high - middle) * above + at_low - at_high - middle * inside
    second = (
        (low - middle) ** 2 * below
        + (high - middle) ** 2 * above
        + (1.0 + middle**2) * inside
        + (low - 2.0 * middle) * at_low
        - (high - 2.0 * middle) * at_high
    )
    return _Censored(middle + first, (second - first**2).clamp(min=0.0), inside)


def _normal_density(value: Tensor) -> Tensor:
    return torch.exp(-0.5 * value**2) * (1.0 / math.sqrt(2 * math.pi))


def _tail_moments(start: Tensor, order: int) -> tuple[Tensor, list[Tensor]]:
    r"""Return the moments of a normal tail about its beginning, as exp(offset) times numbers.

    :math:`e^{o} M_k = \int_0^\infty y^k e^{-(t + y)^2 / 2}\, dy` for k up to ``order`` <= 2, with
    :math:`o = -t^2/2` for positive t and 0 for others. Every number is positive.
    """
    positive = start > 0
    series = start > SERIES_FROM
    # For positive t: M_0 is Mills' ratio, M_1 = 1 - t M_0, M_2 = M_0 - t M_1.
    near = torch.where(positive & ~series, start, 0.0)
    mills = math.sqrt(math.pi / 2) * torch.special.erfcx(near / math.sqrt(2))
    right = [mills, 1.0 - near * mills]
    right.append(right[0] - near * right[1])
    # For large t these differences lose digits: sum_m (-1/2)^m (k + 2m)! / (m! t^(k + 2m + 1)).
    far = torch.where(series, start, SERIES_FROM)
    inverse = 1.0 / far**2
    # For negative t without the factor exp(t^2/2), which would overflow.
    left_start = torch.where(positive, 0.0, start)
    area = math.sqrt(2 * math.pi) * torch.special.ndtr(-left_start)
    density = torch.exp(-0.5 * left_start**2)
    left = [
        area,
        density - left_start * area,
        (1.0 + left_start**2) * area - left_start * density,
    ]
    moments = []
    for k in range(order + 1):
        summed = torch.zeros_like(far)
        for m in reversed(range(SERIES_TERMS)):
            coefficient = (-0.5) ** m * math.factorial(k + 2 * m) / math.factorial(m)
            summed = summed * inverse + coefficient
        asymptotic = summed / far ** (k + 1)
        moments.append(torch.where(positive, torch.where(series, asymptotic, right[k]), left[k]))
    return -0.5 * torch.where(positive, start, 0.0) ** 2, moments


def _log_tail(along: Tensor, scale: Tensor, limit: Tensor, power: int) -> Tensor:
    r"""Return the logarithm of :math:`\int_{limit}^\infty r^{power} e^{-(r - a)^2/2s^2} dr`."""
    offset, moments = _tail_moments((limit - along) / scale, power)
    return offset + (scale * _about(moments, scale, limit, power)).log()


def _log_ball(along: Tensor, scale: Tensor, limit: Tensor, power: int) -> Tensor:
    r"""Return the logarithm of :math:`\int_0^{limit} r^{power} e^{-(r - a)^2/2s^2} dr`.

    A difference of two tails, on the side of a on which they are small. Its relative error is
    about that of a float64 times ``(scale / limit) ** (power + 1)``.
    """
    tiny = torch.finfo(scale.dtype).tiny
    zero = torch.zeros_like(limit)
    toward = along < limit
    # From the left: all beyond 0 minus all beyond the limit.
    left = torch.where(toward, along, 0.0)
    first, beyond_zero = _tail_moments(-left / scale, power)
    second, beyond_limit = _tail_moments((limit - left) / scale, power)
    rising = _about(beyond_zero, scale, zero, power) - (second - first).exp() * _about(
        beyond_limit, scale, limit, power
    )
    rising_log = first + (scale * rising).clamp(min=tiny).log()
    # From the right: all short of the limit minus all short of 0, where r runs backwards.
    right = torch.where(toward, limit, along)
    first, short_of_limit = _tail_moments((right - limit) / scale, power)
    second, short_of_zero = _tail_moments(right / scale, power)
    falling = _about(short_of_limit, -scale, limit, power) - (second - first).exp() * _about(
        short_of_zero, -scale, zero, power
    )
    falling_log = first + (scale * falling).clamp(min=tiny).log()
    return torch.where(toward, rising_log, falling_log)


def _about(moments: list[Tensor], scale: Tensor, limit: Tensor, power: int) -> Tensor:
    """Return the moment about 0 from those about the limit, which is where the tail begins."""
    if power == 1:
        return limit * moments[0] + scale * moments[1]
    return limit**2 * moments[0] + 2.0 * limit * scale * moments[1] + scale**2 * moments[2]


def _as(value: Tensor | float, like: Tensor) -> Tensor:
    """Return a tensor of the same dtype and device."""
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)
