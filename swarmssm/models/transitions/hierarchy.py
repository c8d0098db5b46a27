"""Parameters that differ between individuals, around those of the population."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pyro.distributions as dist
import torch
from pyro.distributions import constraints
from pyro.nn import PyroModule, PyroSample

from swarmssm.models.parameters import assign

__all__ = ["Hierarchical", "assign_hierarchical"]


@dataclass(frozen=True)
class Hierarchical:
    r"""Each individual's own value, drawn from a population that is inferred too.

    Positive values: :math:`\log k_i \sim N(\log m, s^2)`; others: :math:`k_i \sim N(m, s^2)`.
    A parameter ``k`` becomes three: ``k_median`` (m), ``k_spread`` (s) and ``k``, of shape
    ``(individual,)``, whose prior depends on the other two.

    Attributes
    ----------
    median
        m: prior, parameter or number.
    spread
        s, positive, likewise: of the logarithm, for positive values.
    individuals
        Their number.
    positive
        Whether all values are.
    """

    median: Any
    spread: Any
    individuals: int
    positive: bool = True


@dataclass(frozen=True)
class _Population:
    """From a part of a model to the prior of the individuals' values."""

    name: str
    individuals: int
    positive: bool

    def __call__(self, module: PyroModule) -> dist.TorchDistribution:
        median = getattr(module, f"{self.name}_median")
        spread = getattr(module, f"{self.name}_spread")
        shape = torch.Size([self.individuals])
        if self.positive:
            return dist.LogNormal(median.log(), spread).expand(shape).to_event(1)
        return dist.Normal(median, spread).expand(shape).to_event(1)


def assign_hierarchical(
    module: PyroModule,
    name: str,
    value: Any,
    *,
    constraint: Any = None,
    shapes: Sequence[Sequence[int]] | None = None,
) -> None:
    """Give a part of a model a parameter, as :func:`~swarmssm.models.parameters.assign` does.

    Parameters
    ----------
    module, name, constraint, shapes
        As there.
    value
        As there, or a :class:`Hierarchical`.
    """
    if isinstance(value, Hierarchical):
        inner = constraints.positive if value.positive else constraints.real
        # In the order in which they are sampled.
        assign(module, f"{name}_median", value.median, constraint=inner, shapes=[()])
        assign(module, f"{name}_spread", value.spread, constraint=constraints.positive, shapes=[()])
        value = PyroSample(_Population(name, value.individuals, value.positive))
    assign(module, name, value, constraint=constraint, shapes=shapes)
