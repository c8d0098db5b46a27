"""Data sets drawn from a model: parameters from its priors, then paths and observations."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyro
import pyro.distributions as dist
import torch
import xarray as xr
from pyro.nn import PyroSample

from swarmssm.errors import InputError, WorkError
from swarmssm.inference.guides.registry import default_guide
from swarmssm.models import ObservedEdges, Scales, StateSpaceModel, find_model, with_priors
from swarmssm.models.parameters import priors_of
from swarmssm.models.pyro_modules import priors_in
from swarmssm.tracks import MAX_COORDINATE, Array

__all__ = ["FixedModel", "SimulatedData", "standard_scales"]

#: Side of a square or cube in which positions are uniform, in standard deviations of a coordinate.
UNIFORM_SIDE = math.sqrt(12.0)


def standard_scales(
    individuals: int, *, space: int = 2, dt: float = 0.1, noise: float = 0.03
) -> Scales:
    """Return the scales of a group of unit speed whose positions have a standard deviation of 1.

    Parameters
    ----------
    individuals
        Their number.
    space
        Dimensions.
    dt
        Seconds from one frame to the next.
    noise
        Tracking noise.
    """
    half = 0.5 * UNIFORM_SIDE
    return Scales(
        space=space,
        individuals=individuals,
        dt=dt,
        centre=(0.0,) * space,
        low=(-half,) * space,
        high=(half,) * space,
        length=1.0,
        # As differences of noisy positions have it, which a model allows for.
        speed=math.sqrt(1.0 + 2.0 * space * (noise / dt) ** 2),
        slow=0.5,
        fast=1.5,
        # Of points strewn at random over the square.
        spacing=0.5 * UNIFORM_SIDE / max(individuals, 1) ** (1.0 / space),
        step=0.1,
        noise=noise,
    )


@dataclass(frozen=True)
class FixedModel:
    """Builds a model from scales of its own, whatever tracks it is fitted to.

    With it the prior does not depend on the data, as calibration by simulation asks for. Passed
    as ``model`` to :func:`swarmssm.inference.fit`.

    Attributes
    ----------
    model
        Registered name, ``module:attribute``, or what builds a model from scales and options.
    scales
        The scales.
    options
        Of the model's constructor.
    priors
        Name -> text, in place of the model's own, see :func:`swarmssm.models.with_priors`.
    spread
        A ``LogNormal`` prior that the model comes with is made this wide (standard deviation of
        the logarithm) where it is wider; ``None``: as it is. The default priors allow gains
        a factor of 20 off, with which many a simulated group flies apart.
    """

    model: str | Callable[..., Any]
    scales: Scales
    options: Mapping[str, Any] = field(default_factory=dict)
    priors: Mapping[str, str] = field(default_factory=dict)
    spread: float | None = None

    @property
    def name(self) -> str:
        """Name of the model."""
        if isinstance(self.model, str):
            return self.model
        return str(getattr(self.model, "__qualname__", type(self.model).__qualname__))

    def __call__(self, scales: Scales | None = None) -> StateSpaceModel:
        """Return the model, whatever the scales of the tracks.

        Raises
        ------
        InputError
            If an option or prior does not fit, it is no state-space model, or it has weights to be
            learned that no prior tells how to draw.
        """
        builder = find_model(self.model)
        with pyro.settings.context(module_local_params=True):
            try:
                model = builder(self.scales, **self.options)
            except TypeError as error:
                raise InputError(
                    f"model: {self.name} cannot be built with these options ({error})."
                ) from error
            if not isinstance(model, StateSpaceModel):
                raise InputError(
                    f"model: {self.name} is no state-space model; it has no prior to draw "
                    "truths from. Choose boids, kernel or linear, or one of your own."
                )
            _narrow(model, self.spread)
            if self.priors:
                with_priors(model, self.priors)
        learned = [name for name, weight in model.named_parameters() if weight.requires_grad]
        if learned:
            raise InputError(
                f"model: {self.name} has {len(learned)} weights without a prior, such as "
                f"{learned[0]}, so that there is no truth to draw. Give them priors, or "
                "choose a model without a network."
            )
        return model

    def default_guide(self) -> str:
        """Return the guide that is taken for the model where none is named."""
        return default_guide(self())


@dataclass(frozen=True)
class SimulatedData:
    """Data sets drawn from a model's joint distribution, each told by its number and a seed.

    Attributes
    ----------
    model
        Whose.
    frames, individuals, trials
        Sizes of a data set; all its trials have the same parameters.
    graph
        Rule of who sees whom, for a model whose edges are observed: its tracks carry the graph of
        the true states. ``"complete"`` asks for no rule, and the posterior is then exact in
        principle; what a graph of hidden states says of these, no such model uses.
    """

    model: FixedModel
    frames: int
    individuals: int
    trials: int
    graph: str = "complete"

    def draw(
        self, seed: int, values: Mapping[str, Any] | None = None
    ) -> tuple[xr.Dataset, dict[str, torch.Tensor], torch.Tensor]:
        """Draw a data set.

        Parameters
        ----------
        seed
            Of all draws.
        values
            Parameters that are not to be drawn, by full name.

        Returns
        -------
        Tracks; the parameters by full name; and the true states
        ``(trial, time, individual, state)``.

        Raises
        ------
        InputError
            If a size is not positive, or a value does not fit.
        WorkError
            If the group flies apart.
        """
        model = self.model().double()
        observed = isinstance(model.edges, ObservedEdges)
        drawn = model.simulate(
            self.frames,
            self.individuals,
            num_windows=self.trials,
            values=values,
            graph=self.graph if observed else None,
            seed=seed,
        )
        scales = self.model.scales
        seen: Array = drawn.observations.numpy()
        if not (np.abs(seen) <= MAX_COORDINATE).all():
            raise WorkError("The group flew apart.")
        tracks = drawn.to_tracks(scales.dt, with_graph=observed)
        return tracks, drawn.parameters, drawn.states


def _narrow(model: StateSpaceModel, spread: float | None) -> None:
    """Make wide priors of positive parameters narrower."""
    if spread is None:
        return
    for name in priors_of(model):
        place, _, attribute = name.rpartition(".")
        module: Any = model.get_submodule(place)
        prior = priors_in(module)[attribute]
        base = getattr(prior, "base_dist", prior) if isinstance(prior, dist.Independent) else prior
        if isinstance(base, dist.LogNormal):
            narrow = dist.LogNormal(base.loc, base.scale.clamp(max=spread))
            setattr(module, attribute, PyroSample(narrow.to_event(len(base.batch_shape))))
