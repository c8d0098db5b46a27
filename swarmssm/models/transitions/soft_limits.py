"""Speeds that cannot go beyond bounds which are learned."""

from typing import Any

import torch
from pyro.distributions import constraints
from pyro.nn import PyroModule, PyroParam
from torch import nn
from torch.nn.functional import softplus

from swarmssm.models.parameters import assign

__all__ = ["SoftSpeedLimits"]

#: The strength moves as much faster than other parameters: it has to go from 0 to about 3, they
#: have not.
FAST = 10.0


class SoftSpeedLimits(PyroModule):  # type: ignore[misc]
    r"""Speeds drawn smoothly into an interval, directions kept.

    .. math::
        s \mapsto s + a \bigl(k \log(1 + e^{(l - s)/k}) - k \log(1 + e^{(s - h)/k})\bigr),
        \qquad a = \tanh(10\, \omega)

    With a = 1 this is ``clip(s, l, h)`` with corners rounded over a width k, and with a = 0, where
    it starts, the identity.

    Parameters
    ----------
    low, high
        Where l and h start, in the unit of speed.
    softness
        Where k starts.

    All four of l, h, k and :math:`\omega` are learned: the parameters ``low``, ``high``,
    ``softness`` and ``strength``.
    """

    def __init__(self, low: Any, high: Any, softness: Any) -> None:
        super().__init__()
        for name, value in (("low", low), ("high", high), ("softness", softness)):
            if isinstance(value, float):
                value = PyroParam(torch.tensor(value), constraint=constraints.positive)
            assign(self, name, value, constraint=constraints.positive)
        self.strength = nn.Parameter(torch.tensor(0.0))

    def forward(self, velocities: torch.Tensor) -> torch.Tensor:
        """Return the velocities with limited speed, ``(..., individual, space)``."""
        softness = self.softness.unsqueeze(-1)
        # Away from 0, where direction and gradient of the speed are not defined.
        least = 1e-3 * softness
        speed = (velocities.square().sum(-1, keepdim=True) + least.square()).sqrt()
        up = softplus((self.low.unsqueeze(-1) - speed) / softness)
        down = softplus((speed - self.high.unsqueeze(-1)) / softness)
        change = torch.tanh(FAST * self.strength) * softness * (up - down)
        limited: torch.Tensor = velocities * (1.0 + change / speed)
        return limited
