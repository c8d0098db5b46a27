"""Functions of distance as weighted sums of basis functions, with their derivatives."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from swarmssm.errors import InputError

__all__ = ["PowerBasis", "RadialBasis", "RadialValues", "SplineBasis"]


class RadialValues(NamedTuple):
    """Some functions of distance at some distances.

    Attributes
    ----------
    value, slope
        ``(..., function)``: the functions, and their derivatives by distance.
    """

    value: Tensor
    slope: Tensor


class RadialBasis(nn.Module):
    r"""Basis functions :math:`\phi_k` of distance.

    A subclass writes :meth:`forward`.

    Parameters
    ----------
    size
        Number of basis functions.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size

    def forward(self, distance: Tensor, coefficients: Tensor) -> RadialValues:
        r"""Return :math:`\sum_k c_k \phi_k(r)` and its derivative.

        Parameters
        ----------
        distance
            ``(...)``, positive.
        coefficients
            ``(function, size)``, of several functions at once.
        """
        raise TypeError(f"{type(self).__name__} must define forward(distance, coefficients)")

    @property
    def heights(self) -> Tensor | None:
        """Distances at which the basis functions are highest, ``(size,)``, if they are local."""
        return None


class PowerBasis(RadialBasis):
    r"""Powers of distance, :math:`\phi_k(r) = r^{p_k}`.

    With the powers 1, -n and 0 they make the boids law: see
    :class:`~swarmssm.models.transitions.KernelTransition`.

    Parameters
    ----------
    powers
        :math:`p_k`, any numbers.
    """

    powers: Tensor

    def __init__(self, powers: tuple[float, ...]) -> None:
        super().__init__(len(powers))
        self.register_buffer("powers", torch.tensor(powers, dtype=torch.get_default_dtype()))

    def forward(self, distance: Tensor, coefficients: Tensor) -> RadialValues:
        """Return the functions and their derivatives; see :class:`RadialBasis`."""
        powers = self.powers.to(distance.dtype)
        raised = distance.unsqueeze(-1) ** powers
        lowered = powers * distance.unsqueeze(-1) ** (powers - 1.0)
        return RadialValues(raised @ coefficients.mT, lowered @ coefficients.mT)


class SplineBasis(RadialBasis):
    r"""Cubic B-splines that lie closer together at short distances.

    Knots are equally spaced in :math:`\log(1 + r / r_0)`, so that up to about :math:`r_0` they are
    so in distance, and beyond in its logarithm: separation acts within a body length, cohesion over
    many. Beyond the reach functions go on at the value they have there.

    Parameters
    ----------
    reach
        R, where the last knot is.
    near
        :math:`r_0`.
    size
        Number of basis functions, at least 4.

    Raises
    ------
    InputError
        If a length is not positive, or there are too few functions.

    References
    ----------
    P. H. C. Eilers and B. D. Marx (1996), Flexible smoothing with B-splines and penalties,
    Statistical Science 11.
    """

    pieces: Tensor

    def __init__(self, reach: float, near: float, size: int = 12) -> None:
        if not isinstance(size, int) or size < 4:
            raise InputError(f"splines: there must be at least 4 basis functions, not {size!r}.")
        for name, length in (("reach", reach), ("near", near)):
            if not 0.0 < length < math.inf:
                raise InputError(f"{name}: it must be a positive length, not {length!r}.")
        super().__init__(size)
        self.reach, self.near = float(reach), float(near)
        # Row m: what the m-th of the four splines over a piece is, by powers of the place in it.
        cubic = [[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]
        self.register_buffer("pieces", torch.tensor(cubic, dtype=torch.float64) / 6.0)

    @property
    def heights(self) -> Tensor:
        """Distances at which the splines are highest, the outer ones at the ends."""
        place = torch.arange(-1.0, self.size - 1.0, dtype=torch.float64)
        place = place.clamp(0.0, self.size - 3.0) / (self.size - 3.0)
        return self.near * torch.expm1(place * math.log1p(self.reach / self.near))

    def roughness(self) -> Tensor:
        """Return D of the second differences of the coefficients, ``(size - 2, size)``."""
        return torch.from_numpy(np.diff(np.eye(self.size), 2, axis=0))

    def forward(self, distance: Tensor, coefficients: Tensor) -> RadialValues:
        """Return the functions and their derivatives; see :class:`RadialBasis`."""
        count = self.size - 3
        stretch = count / math.log1p(self.reach / self.near)
        place = stretch * torch.log1p(distance / self.near)
        index = place.detach().floor().clamp(0, count - 1)
        part = (place - index).clamp(max=1.0)
        # A cubic a piece: (piece, power, function), all of which a distance looks up at once.
        windows = coefficients.unfold(-1, 4, 1)
        pieces = self.pieces.to(coefficients.dtype)
        cubics = torch.einsum("fpm,mk->pkf", windows, pieces).reshape(count, -1)
        found = cubics.index_select(0, index.reshape(-1).long())
        c0, c1, c2, c3 = found.reshape(*distance.shape, 4, -1).unbind(-2)
        part = part.unsqueeze(-1)
        value = ((c3 * part + c2) * part + c1) * part + c0
        rate = torch.where(distance < self.reach, stretch / (self.near + distance), 0.0)
        slope = ((3.0 * c3 * part + 2.0 * c2) * part + c1) * rate.unsqueeze(-1)
        return RadialValues(value, slope)
