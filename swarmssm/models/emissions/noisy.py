"""Something of the state, with Gaussian or heavy-tailed noise on each axis."""

from collections.abc import Sequence
from typing import Any, Literal

import pyro.distributions as dist
import torch
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.models.emissions.base import Emission, LinearizedEmission, slopes
from swarmssm.models.emissions.student import DiagonalStudentT
from swarmssm.models.parameters import assign

__all__ = ["NoisyEmission", "Tails"]

#: How the noise falls off.
Tails = Literal["gaussian", "student"]


class NoisyEmission(Emission):
    r"""A function of the state with noise: :math:`x_i = g(z_i) + s\, \epsilon_i`.

    With ``tails="gaussian"``, :math:`\epsilon_i` is standard normal. With ``"student"`` it is
    Student's t of :math:`\nu = 2 + a` degrees of freedom on the whole vector
    (:class:`swarmssm.models.emissions.DiagonalStudentT`), and the noise has variance
    :math:`s^2 \nu / (\nu - 2)`. That is the covariance that :meth:`linearize` tells a Gaussian
    filter: the best linear filter has it. It is not robust; :meth:`weights` are, iterated.

    A subclass writes :meth:`location`, and :meth:`scale` if there is more than one noise.

    Parameters
    ----------
    noise
        :math:`s`, in the unit of what is observed: a number or one for each feature; a prior; or
        a parameter. Positive.
    sizes
        How many features ``noise`` may be given for.
    tails
        ``"gaussian"`` or ``"student"``.
    excess_degrees
        :math:`a`, the degrees of freedom beyond 2, with which noise has a variance: a positive
        number, a prior, or a parameter. Not used by Gaussian tails.

    Raises
    ------
    InputError
        If ``tails`` is something else, or a value is out of range.
    """

    def __init__(
        self,
        noise: Any,
        sizes: int,
        tails: Tails = "gaussian",
        excess_degrees: Any = 2.0,
    ) -> None:
        super().__init__()
        if tails not in ("gaussian", "student"):
            raise InputError(f"tails: it must be 'gaussian' or 'student', not {tails!r}.")
        self.tails = tails
        self._assign_noise("noise", noise, sizes)
        if tails == "student":
            shapes: Sequence[tuple[int, ...]] = [()]
            assign(
                self,
                "excess_degrees",
                excess_degrees,
                constraint=constraints.positive,
                shapes=shapes,
            )

    @property
    def has_heavy_tails(self) -> bool:
        """Whether the noise has Student's t distribution."""
        return self.tails != "gaussian"

    def _assign_noise(self, name: str, value: Any, size: int) -> None:
        """Take a positive parameter with a value for all features, or one for each."""
        if isinstance(value, int | float) and value == 0:
            raise InputError(
                f"{name}: it must be positive, and it is 0. For states that are observed exactly "
                "give the model ExactEmission()."
            )
        assign(self, name, value, constraint=constraints.positive, shapes=[(), (size,)])

    def location(self, states: torch.Tensor) -> torch.Tensor:
        """Return what would be observed without noise, ``(..., individual, observation)``."""
        raise TypeError(f"{type(self).__name__} must define location(states)")

    def scale(self, location: torch.Tensor) -> torch.Tensor:
        """Return the scale of the noise, which broadcasts to the shape of ``location``."""
        noise: torch.Tensor = self.noise
        return noise

    def forward(self, states: torch.Tensor) -> dist.TorchDistribution:
        """Return the distribution of the observations."""
        location = self.location(states)
        scale = self.scale(location)
        if self.tails == "gaussian":
            return dist.Normal(location, scale).to_event(1)
        return DiagonalStudentT(2.0 + self.excess_degrees, location, scale)

    def linearize(self, states: torch.Tensor) -> LinearizedEmission:
        """Linearise at given states; the noise has the variance that it has."""
        mean = self.location(states)
        variance = (self.scale(mean) ** 2).expand(mean.shape)
        if self.tails == "student":
            variance = variance * (1.0 + 2.0 / self.excess_degrees)
        return LinearizedEmission(mean, self.jacobian(states), torch.diag_embed(variance))

    def jacobian(self, states: torch.Tensor) -> torch.Tensor:
        """Return the derivative of :meth:`location`, ``(..., individual, observation, state)``."""
        return slopes(self.location, states)

    def weights(self, residuals: torch.Tensor) -> torch.Tensor:
        r"""Return how much observations weigh in a Gaussian filter that is run again.

        1 with Gaussian tails. With Student's, the noise of :meth:`linearize` divided by them is
        that of an iteratively reweighted filter, :math:`s^2 / w` with

        .. math:: w_i = \frac{\nu + d}{\nu + r_i^2}, \qquad
                  r_i^2 = \sum_k (x_{ik} - g_k(z_i))^2 / s_k^2

        whose fixed point is the most probable path (Lange, Little and Taylor 1989,
        J. Am. Stat. Assoc. 84: 881-896).

        Parameters
        ----------
        residuals
            :math:`x - g(z)`, ``(..., individual, observation)``.

        Returns
        -------
        ``(..., individual)``.
        """
        if self.tails == "gaussian":
            return super().weights(residuals)
        distance = ((residuals / self.scale(residuals)) ** 2).sum(-1)
        degrees = 2.0 + self.excess_degrees
        weights = (degrees + residuals.shape[-1]) / (degrees + distance)
        # In units of the variance, which is larger than the squared scale.
        scaled: torch.Tensor = weights * (1.0 + 2.0 / self.excess_degrees)
        return scaled
