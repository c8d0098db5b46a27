"""The next state of a body: a random velocity, and the position that follows from it."""

from typing import Any

import torch
from pyro.distributions import TorchDistribution
from torch.distributions import constraints

__all__ = ["Kinematic"]

#: A position may differ from the kinematic one by so many units of rounding of its size.
ROUNDING = 64.0


class Kinematic(TorchDistribution):  # type: ignore[misc]
    r"""Next states :math:`[p', v']` with :math:`v'` random and :math:`p' = p + dt\, v'`.

    Noise enters through the velocity alone, so that states lie on a surface of half the
    dimensions. The density is that of :math:`v'` on it, and positions are not looked at: a
    :class:`~swarmssm.models.MarkovChain` that checks its arguments refuses paths off the surface
    (:meth:`is_off_surface`).

    Parameters
    ----------
    position
        Positions before the step, ``(..., space)``.
    velocity
        Distribution of the next velocities, event shape ``(space,)``.
    dt
        Seconds.

    Shapes
    ------
    Batch shape that of ``velocity`` broadcast with ``position``; event shape ``(2 * space,)``.
    """

    def __init__(
        self,
        position: torch.Tensor,
        velocity: TorchDistribution,
        dt: float,
        validate_args: bool | None = None,
    ) -> None:
        if len(velocity.event_shape) != 1:
            raise ValueError(
                "velocities must have event shape (space,), and it is "
                f"{tuple(velocity.event_shape)}; .to_event(1) makes features an event"
            )
        (space,) = velocity.event_shape
        if position.shape[-1] != space:
            raise ValueError(
                f"positions have {position.shape[-1]} coordinates and velocities {space}"
            )
        batch_shape = torch.broadcast_shapes(  # type: ignore[no-untyped-call]
            position.shape[:-1], velocity.batch_shape
        )
        self.position = position.expand(*batch_shape, space)
        self.velocity = (
            velocity if velocity.batch_shape == batch_shape else velocity.expand(batch_shape)
        )
        self.dt = dt
        super().__init__(batch_shape, torch.Size([2 * space]), validate_args=validate_args)

    @property
    def has_rsample(self) -> bool:
        """Whether draws are differentiable: where those of the velocity are."""
        return bool(self.velocity.has_rsample)

    @property
    def arg_constraints(self) -> dict[str, Any]:
        """Return no constraints: the velocity checks its own."""
        return {}

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        """Return all real states."""
        return constraints.real_vector

    def expand(self, batch_shape: Any, _instance: Any = None) -> "Kinematic":
        """Return the distribution with another batch shape."""
        batch_shape = torch.Size(batch_shape)
        position = self.position.expand(*batch_shape, self.position.shape[-1])
        return Kinematic(position, self.velocity.expand(batch_shape), self.dt, validate_args=False)

    def complete(self, velocity: torch.Tensor) -> torch.Tensor:
        """Return the states that go with next velocities."""
        return torch.cat([self.position + self.dt * velocity, velocity], dim=-1)

    @property
    def mean(self) -> torch.Tensor:
        """Mean of the next states."""
        return self.complete(self.velocity.mean)

    @property
    def covariance_matrix(self) -> torch.Tensor:
        r"""Covariance ``(..., state, state)``, of rank ``space``."""
        if hasattr(self.velocity, "covariance_matrix"):
            inner = self.velocity.covariance_matrix
        else:
            inner = torch.diag_embed(self.velocity.variance)
        moved = self.dt * inner
        return torch.cat(
            [torch.cat([self.dt * moved, moved], -1), torch.cat([moved, inner], -1)], -2
        )

    @property
    def variance(self) -> torch.Tensor:
        """Variance of each feature."""
        inner = self.velocity.variance
        return torch.cat([self.dt**2 * inner, inner], dim=-1)

    def rsample(self, sample_shape: Any = torch.Size()) -> torch.Tensor:  # noqa: B008
        """Draw next states, differentiably."""
        return self.complete(self.velocity.rsample(sample_shape))

    def sample(self, sample_shape: Any = torch.Size()) -> torch.Tensor:  # noqa: B008
        """Draw next states."""
        with torch.no_grad():
            return self.complete(self.velocity.sample(sample_shape))

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """Return the log-density of the velocities of next states ``(..., state)``."""
        score: torch.Tensor = self.velocity.log_prob(value[..., self.position.shape[-1] :])
        return score

    def is_off_surface(self, value: torch.Tensor, size: torch.Tensor | None = None) -> torch.Tensor:
        """Return which positions do not follow from their velocities, up to rounding.

        Parameters
        ----------
        value
            Next states, ``(..., state)``.
        size
            Of the numbers that were added up on the way to them, broadcasting to ``(...)``; those
            of this step alone if absent.

        Returns
        -------
        ``(...)`` of bool.
        """
        space = self.position.shape[-1]
        own = self.position + self.dt * value[..., space:]
        here = torch.maximum(own.abs(), self.position.abs()).amax(-1)
        size = here if size is None else torch.maximum(here, size)
        worst = (value[..., :space] - own).abs().amax(-1)
        return worst > ROUNDING * torch.finfo(value.dtype).eps * size
