"""Linear forces between neighbours: a law of motion with few parameters that is solved exactly."""

from typing import Any, ClassVar

import pyro.distributions as dist
import torch
from pyro.distributions import constraints
from torch import Tensor

from swarmssm.models.markov import StepInputs
from swarmssm.models.parameters import assign
from swarmssm.models.transitions.base import KinematicTransition, Linearization
from swarmssm.models.transitions.linear import pull_matrix, pull_to_neighbors
from swarmssm.models.units import Dimension

__all__ = ["LinearForceTransition"]


class LinearForceTransition(KinematicTransition):
    r"""Bodies on springs: drawn to the mean of those they see, and home.

    .. math::
        v'_i = v_i + dt\,\bigl(k_c (\bar p_{\mathcal{N}_i} - p_i)
        + k_a (\bar v_{\mathcal{N}_i} - v_i) - k_d v_i + k_h (h - p_i)\bigr)
        + \sigma \sqrt{dt}\, \epsilon, \qquad p'_i = p_i + dt\, v'_i

    The first two terms are 0 for who sees nobody. On a graph that does not depend on the states all
    is linear and Gaussian, so that Kalman filters and smoothers are exact.

    Parameters
    ----------
    space
        Number of spatial dimensions.
    dt
        Seconds from one frame to the next.
    cohesion_gain, alignment_gain
        :math:`k_c` (per second squared) and :math:`k_a` (per second), of either sign.
    damping
        :math:`k_d`, per second.
    process_noise
        :math:`\sigma`, above 0; as in :class:`~swarmssm.models.transitions.BoidsTransition`.
    homing_gain
        :math:`k_h`, per second squared; 0: nowhere is home.
    home
        h, a number for all axes or ``(space,)``.

    Each is a number or tensor, a prior, or a parameter
    (:func:`swarmssm.models.parameters.assign`); all but the last are one for all or
    ``(individual,)``.
    """

    def __init__(
        self,
        space: int,
        dt: float,
        *,
        cohesion_gain: Any,
        alignment_gain: Any,
        damping: Any,
        process_noise: Any,
        homing_gain: Any = 0.0,
        home: Any = 0.0,
    ) -> None:
        super().__init__(space, dt)
        for name, value in (
            ("cohesion_gain", cohesion_gain),
            ("alignment_gain", alignment_gain),
            ("damping", damping),
            ("homing_gain", homing_gain),
        ):
            assign(self, name, value, shapes=[(), (-1,)])
        positive = constraints.positive
        assign(self, "process_noise", process_noise, constraint=positive, shapes=[(), (-1,)])
        assign(self, "home", home, shapes=[(), (space,)])

    #: Powers of length and time in the units of parameters, see :mod:`swarmssm.models.units`.
    dimensions: ClassVar[dict[str, Dimension]] = {
        "cohesion_gain": (0, -2),
        "alignment_gain": (0, -1),
        "damping": (0, -1),
        "homing_gain": (0, -2),
        "home": (1, 0),
        "process_noise": (1, -1.5),
    }
    #: See :class:`~swarmssm.models.Transition`.
    self_parameter_names: ClassVar[tuple[str, ...]] = (
        "damping",
        "process_noise",
        "homing_gain",
        "home",
    )

    def pairwise(self, states: Tensor, inputs: StepInputs) -> Tensor:
        """Return what the mean of the neighbours adds to the next velocity."""
        assert inputs.adjacency is not None, "neighbours are those of a graph"
        pull = pull_to_neighbors(states, inputs.adjacency)
        force = self.cohesion_gain.unsqueeze(-1) * pull[..., : self.space]
        force = force + self.alignment_gain.unsqueeze(-1) * pull[..., self.space :]
        moved: Tensor = self.dt * force
        return moved

    def velocity(
        self, positions: Tensor, velocities: Tensor, inputs: StepInputs
    ) -> dist.TorchDistribution:
        """Return the distribution of the next velocities."""
        force = self.homing_gain.unsqueeze(-1) * (self.home - positions)
        force = force - self.damping.unsqueeze(-1) * velocities
        if inputs.adjacency is not None:
            pull = pull_to_neighbors(torch.cat([positions, velocities], -1), inputs.adjacency)
            force = force + self.cohesion_gain.unsqueeze(-1) * pull[..., : self.space]
            force = force + self.alignment_gain.unsqueeze(-1) * pull[..., self.space :]
        noise = (self.process_noise * self.dt**0.5).unsqueeze(-1)
        return dist.Normal(velocities + self.dt * force, noise).to_event(1)

    def linearize(
        self, mean: Tensor, inputs: StepInputs, covariance: Tensor | None = None
    ) -> Linearization:
        """Return the transition itself: it is linear."""
        following = self(mean, inputs)
        individuals = mean.shape[-2]
        eye = torch.eye(individuals, dtype=mean.dtype, device=mean.device)
        by_position = -self.homing_gain.unsqueeze(-1) * eye
        by_velocity = -self.damping.unsqueeze(-1) * eye
        if inputs.adjacency is not None:
            pull = pull_matrix(mean, inputs.adjacency)
            by_position = by_position + self.cohesion_gain.unsqueeze(-1) * pull
            by_velocity = by_velocity + self.alignment_gain.unsqueeze(-1) * pull
        pairs = (*mean.shape[:-1], individuals)
        by_position = (self.dt * by_position).expand(pairs)
        by_velocity = (eye + self.dt * by_velocity).expand(pairs)
        # In blocks [i, a, j, b]: axes do not mix.
        axes = torch.eye(self.space, dtype=mean.dtype, device=mean.device)
        still, position, velocity = (
            matrix[..., :, None, :, None] * axes[:, None, :]
            for matrix in (eye.expand(pairs), by_position, by_velocity)
        )
        upper = torch.cat([still + self.dt * position, self.dt * velocity], -1)
        lower = torch.cat([position, velocity], -1)
        noise = following.covariance_matrix.expand(*mean.shape, self.state_dim)
        return Linearization(following.mean, torch.cat([upper, lower], -3), noise)
