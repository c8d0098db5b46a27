"""Guides of the parameters that have priors."""

from typing import Any

import pyro
import torch
from pyro.infer.autoguide import AutoDelta, AutoGuide, AutoMultivariateNormal, AutoNormal
from pyro.infer.autoguide.initialization import init_to_median
from pyro.nn import PyroModule

from swarmssm.models import StateSpaceModel
from swarmssm.models.parameters import priors_of
from swarmssm.models.pyro_modules import own_parameters

__all__ = ["PARAMETER_GUIDES", "GlobalGuide"]

PARAMETER_GUIDES: dict[str, type[AutoGuide]] = {
    "normal": AutoNormal,
    "multivariate": AutoMultivariateNormal,
    "delta": AutoDelta,
}
#: Standard deviation that a guide starts with, on the unconstrained scale.
INITIAL_SCALE = 0.05


class GlobalGuide(PyroModule):  # type: ignore[misc]
    """Posterior of all parameters of a model that have a prior, by an automatic guide of Pyro's.

    Parameters
    ----------
    model
        A state-space model.
    kind
        ``"multivariate"``: normal on the unconstrained scale, with correlations; ``"normal"``:
        without; ``"delta"``: the most probable values.

    Raises
    ------
    ValueError
        If the kind is unknown.
    """

    def __init__(self, model: StateSpaceModel, kind: str = "multivariate") -> None:
        super().__init__()
        if kind not in PARAMETER_GUIDES:
            raise ValueError(
                f"parameters must be one of {', '.join(PARAMETER_GUIDES)}, not {kind!r}"
            )
        self.kind = kind
        self.names = priors_of(model)
        if self.names:
            options: dict[str, Any] = {"init_loc_fn": init_to_median(num_samples=50)}
            if kind != "delta":
                options["init_scale"] = INITIAL_SCALE
            # Starting points, not draws: what they are must not depend on what ran before.
            with torch.random.fork_rng():
                torch.manual_seed(0)
                self.auto = PARAMETER_GUIDES[kind](model.sample_globals, **options)
                self.auto._setup_prototype()

    def forward(self) -> dict[str, torch.Tensor]:
        """Sample the parameters; return their values by full name."""
        if not self.names:
            return {}
        drawn = self.auto()
        return {name: drawn[name] for name in self.names}

    def median(self) -> dict[str, torch.Tensor]:
        """Return the values in the middle of the posterior, by full name."""
        if not self.names:
            return {}
        with torch.no_grad():
            middle = self.auto.median()
        return {name: middle[name] for name in self.names}

    def unconstrained(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and standard deviation of all parameters on the unconstrained scale.

        Each ``(number,)``; empty for a guide without spread.
        """
        if not self.names or self.kind == "delta":
            return torch.empty(0), torch.empty(0)
        with torch.no_grad():
            if self.kind == "multivariate":
                posterior = self.auto.get_posterior()
                return posterior.mean.clone(), posterior.stddev
            pairs = [self.auto._get_loc_and_scale(name) for name in self.names]
            mean, sd = (
                torch.cat([part.reshape(-1) for part in side]) for side in zip(*pairs, strict=True)
            )
        return mean.clone(), sd

    def draw(self, draws: int) -> dict[str, torch.Tensor]:
        """Draw values, ``(draw, ...)`` each, by full name."""
        if not self.names:
            return {}
        with own_parameters(self), torch.no_grad(), pyro.plate("draws", draws, dim=-1):
            drawn = self.auto()
        return {name: drawn[name] for name in self.names}
