"""The distribution of first states."""

from typing import Any

import pyro.distributions as dist
import torch
from pyro.nn import PyroModule
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.models.parameters import assign
from swarmssm.models.scales import Scales

__all__ = ["InitialStates"]


class InitialStates(PyroModule):  # type: ignore[misc]
    r"""First states, each individual for itself: :math:`z_1 \sim N(\mu, \mathrm{diag}(s^2))`.

    Parameters
    ----------
    mean, scale
        :math:`\mu` and :math:`s`, ``(state,)`` or ``(individual, state)``: tensor, prior or
        parameter; s positive. Absent from a window's first frame, an individual is drawn from the
        same distribution where it enters.

    Raises
    ------
    InputError
        If one has another shape, or s is not positive.
    """

    def __init__(self, mean: Any, scale: Any) -> None:
        super().__init__()
        shapes = [(-1,), (-1, -1)]
        assign(self, "mean", mean, shapes=shapes)
        assign(self, "scale", scale, constraint=constraints.positive, shapes=shapes)

    @classmethod
    def for_scales(cls, scales: Scales) -> "InitialStates":
        """Return a wide distribution: anywhere in the tracks' own box, at any usual velocity.

        Where nobody moves, the noise of the tracks and in the end the unit of length say what is
        wide.
        """
        extent = max(high - low for low, high in zip(scales.low, scales.high, strict=True))
        extent = extent or scales.noise or 1.0
        speed = scales.speed or extent
        mean = [*scales.centre, *([0.0] * scales.space)]
        scale = [extent] * scales.space + [speed] * scales.space
        return cls(torch.tensor(mean), torch.tensor(scale))

    def forward(self) -> dist.TorchDistribution:
        """Return the distribution of one individual's first state, event shape ``(state,)``."""
        mean, scale = self.mean, self.scale
        if mean.shape[-1] != scale.shape[-1]:
            raise InputError(
                f"initial: mean has {mean.shape[-1]} features and scale {scale.shape[-1]}."
            )
        return dist.Normal(mean, scale).to_event(1)
