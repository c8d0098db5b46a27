"""Heavy-tailed noise on vectors."""

import math
from typing import Any

import torch
from pyro.distributions import TorchDistribution
from torch.distributions import constraints

__all__ = ["DiagonalStudentT"]


class DiagonalStudentT(TorchDistribution):  # type: ignore[misc]
    r"""Student's t on vectors of d numbers, with a scale for each.

    .. math::
        p(x) = \frac{\Gamma\bigl(\frac{\nu + d}{2}\bigr)}{\Gamma\bigl(\frac{\nu}{2}\bigr)
        (\nu \pi)^{d / 2} \prod_k s_k} \Bigl(1 + \frac{r^2}{\nu}\Bigr)^{-(\nu + d) / 2},
        \qquad r^2 = \sum_k \Bigl(\frac{x_k - m_k}{s_k}\Bigr)^2

    An outlier is one of the whole vector, whatever the axes: a lost or exchanged identity moves
    all coordinates. With one scale for all, the density is the same in every direction, which
    independent t-distributions are not. (:class:`pyro.distributions.MultivariateStudentT` is the
    same with a matrix of scales, and solves a system of equations for each vector.)

    Parameters
    ----------
    degrees
        :math:`\nu`, ``(...)``.
    loc, scale
        :math:`m` and :math:`s`, ``(..., d)``.
    """

    has_rsample = True

    def __init__(
        self,
        degrees: torch.Tensor,
        loc: torch.Tensor,
        scale: torch.Tensor,
        validate_args: bool | None = None,
    ) -> None:
        loc, scale = torch.broadcast_tensors(loc, scale)  # type: ignore[no-untyped-call]
        batch_shape = torch.broadcast_shapes(  # type: ignore[no-untyped-call]
            degrees.shape, loc.shape[:-1]
        )
        size = loc.shape[-1]
        self.degrees = degrees.expand(batch_shape).to(loc.dtype)
        self.loc = loc.expand(*batch_shape, size)
        self.scale = scale.expand(*batch_shape, size)
        super().__init__(batch_shape, torch.Size([size]), validate_args=validate_args)

    @property
    def arg_constraints(self) -> dict[str, Any]:
        """Return what the parameters must be."""
        return {
            "degrees": constraints.positive,
            "loc": constraints.real_vector,
            "scale": constraints.independent(constraints.positive, 1),  # type: ignore[no-untyped-call]
        }

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        """Return all real vectors."""
        return constraints.real_vector

    def expand(self, batch_shape: Any, _instance: Any = None) -> "DiagonalStudentT":
        """Return the distribution with another batch shape."""
        shape = torch.Size(batch_shape)
        return DiagonalStudentT(
            self.degrees.expand(shape),
            self.loc.expand(shape + self.event_shape),
            self.scale.expand(shape + self.event_shape),
            validate_args=False,
        )

    @property
    def mean(self) -> torch.Tensor:
        """The centre; for one degree of freedom or less, NaN."""
        return torch.where(self.degrees.unsqueeze(-1) > 1, self.loc, torch.nan)

    @property
    def variance(self) -> torch.Tensor:
        r""":math:`s^2 \nu / (\nu - 2)`; for two degrees of freedom or less, infinite."""
        degrees = self.degrees.unsqueeze(-1)
        factor = torch.where(degrees > 2, degrees / (degrees - 2).clamp_min(1e-30), torch.inf)
        return self.scale**2 * factor

    def rsample(self, sample_shape: Any = torch.Size()) -> torch.Tensor:  # noqa: B008
        r"""Draw :math:`m + s\, \epsilon / \sqrt{g}, \; g \sim \Gamma(\nu / 2, \nu / 2)`."""
        shape = self._extended_shape(sample_shape)
        half = (0.5 * self.degrees).expand(shape[:-1])
        gamma = torch._standard_gamma(half) / half
        noise = torch.randn(shape, dtype=self.loc.dtype, device=self.loc.device)
        return self.loc + self.scale * noise * gamma.rsqrt().unsqueeze(-1)

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """Return the log-density of vectors ``(..., d)``."""
        if self._validate_args:
            self._validate_sample(value)
        size = self.loc.shape[-1]
        distance = (((value - self.loc) / self.scale) ** 2).sum(-1)
        exponent = 0.5 * (self.degrees + size)
        constant = (
            torch.lgamma(exponent)
            - torch.lgamma(0.5 * self.degrees)
            - 0.5 * size * (self.degrees * math.pi).log()
            - self.scale.log().sum(-1)
        )
        density: torch.Tensor = constant - exponent * torch.log1p(distance / self.degrees)
        return density
