"""Positions, or positions and velocities, with tracking noise."""

from typing import Any, ClassVar

import torch

from swarmssm.models.emissions.base import Observes
from swarmssm.models.emissions.noisy import NoisyEmission, Tails
from swarmssm.models.layers import check_sizes
from swarmssm.models.units import Dimension

__all__ = ["PositionEmission", "StateEmission"]


class PositionEmission(NoisyEmission):
    r"""Positions with independent noise, :math:`x_i \sim N(p_i, \sigma^2)` on each axis.

    Parameters
    ----------
    space
        Number of spatial dimensions.
    noise
        :math:`\sigma`, in the unit of length: a number or one for each axis ``(space,)``; a
        prior; or a parameter.
    tails, excess_degrees
        See :class:`swarmssm.models.emissions.NoisyEmission`.
    """

    observes: Observes = "positions"
    is_linear: ClassVar[bool] = True
    #: See :mod:`swarmssm.models.units`.
    dimensions: ClassVar[dict[str, Dimension]] = {"noise": (1, 0), "excess_degrees": (0, 0)}

    def __init__(
        self, space: int, noise: Any, *, tails: Tails = "gaussian", excess_degrees: Any = 2.0
    ) -> None:
        check_sizes(space=space)
        super().__init__(noise, space, tails, excess_degrees)
        self.space = space

    def location(self, states: torch.Tensor) -> torch.Tensor:
        """Return the positions."""
        return states[..., : self.space]

    def jacobian(self, states: torch.Tensor) -> torch.Tensor:
        """Return the identity of the positions."""
        eye = torch.eye(self.space, states.shape[-1], dtype=states.dtype, device=states.device)
        return eye.expand(*states.shape[:-1], *eye.shape)


class StateEmission(NoisyEmission):
    r"""Positions and velocities with independent noise.

    Parameters
    ----------
    space
        Number of spatial dimensions.
    noise
        :math:`\sigma` of positions, as in :class:`PositionEmission`.
    velocity_noise
        :math:`\sigma` of velocities, likewise.
    tails, excess_degrees
        See :class:`swarmssm.models.emissions.NoisyEmission`.
    """

    observes: Observes = "states"
    is_linear: ClassVar[bool] = True
    dimensions: ClassVar[dict[str, Dimension]] = {
        **PositionEmission.dimensions,
        "velocity_noise": (1, -1),
    }

    def __init__(
        self,
        space: int,
        noise: Any,
        velocity_noise: Any,
        *,
        tails: Tails = "gaussian",
        excess_degrees: Any = 2.0,
    ) -> None:
        check_sizes(space=space)
        super().__init__(noise, space, tails, excess_degrees)
        self.space = space
        self._assign_noise("velocity_noise", velocity_noise, space)

    def location(self, states: torch.Tensor) -> torch.Tensor:
        """Return the positions and velocities."""
        return states[..., : 2 * self.space]

    def scale(self, location: torch.Tensor) -> torch.Tensor:
        """Return the scale of each observed feature."""
        half = location[..., : self.space].shape
        return torch.cat([self.noise.expand(half), self.velocity_noise.expand(half)], dim=-1)

    def jacobian(self, states: torch.Tensor) -> torch.Tensor:
        """Return the identity."""
        seen = 2 * self.space
        eye = torch.eye(seen, states.shape[-1], dtype=states.dtype, device=states.device)
        return eye.expand(*states.shape[:-1], *eye.shape)
