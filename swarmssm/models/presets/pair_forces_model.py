"""A model of pair forces of one's own, with everything else as in the other models."""

from collections.abc import Callable, Mapping
from typing import Any

from swarmssm.models.presets.self_terms import Observed, self_term_priors, state_space_model
from swarmssm.models.scales import Scales
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.force import Noise
from swarmssm.models.transitions.pair_force import PairForceTransition
from swarmssm.models.transitions.protocols import Form, PairKernel

__all__ = ["pair_forces"]


def pair_forces(
    scales: Scales,
    strengths: Mapping[str, Callable[..., Any]],
    parameters: Mapping[str, Any],
    *,
    kinds: Mapping[str, PairKernel] | None = None,
    form: Form = "acceleration",
    noise: Noise = "additive",
    walls: bool = False,
    limits: bool = False,
    relaxation: bool = False,
    edges: str | None = None,
    observed: Observed = "positions",
    priors: Mapping[str, Any] | None = None,
) -> StateSpaceModel:
    """Return a model of pair forces that are functions of the distance.

    Parameters
    ----------
    scales
        Of the training tracks.
    strengths, parameters, kinds
        See :class:`~swarmssm.models.transitions.PairForceTransition`; give the parameters priors in
        the unit of the tracks by means of the scales.
    form, noise
        See :class:`~swarmssm.models.transitions.ForceTransition`.
    walls, limits, relaxation, edges, observed, priors
        See :func:`swarmssm.models.presets.boids`, where the priors of walls, limits of speed, speed
        regulation and noise are written.
    """
    transition = PairForceTransition(
        scales.space,
        scales.dt,
        strengths,
        parameters,
        kinds=kinds,
        form=form,
        noise=noise,
        **self_term_priors(
            scales,
            form=form,
            noise=noise,
            walls=walls,
            limits=limits,
            relaxation=relaxation,
            observed=observed,
        ),
    )
    return state_space_model(scales, transition, observed=observed, edges=edges, priors=priors)
