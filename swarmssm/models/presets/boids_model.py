"""Boids with unknown gains, seen with noise: ``swarmssm fit FILE --model boids``."""

import math
from collections.abc import Mapping
from typing import Any, Literal, get_args

import pyro.distributions as dist
import torch

from swarmssm.models.presets.self_terms import (
    WIDE,
    Observed,
    check_choice,
    lognormal,
    positive,
    self_term_priors,
    state_space_model,
    true_speed,
    view_priors,
)
from swarmssm.models.scales import Scales
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.boids import BoidsTransition
from swarmssm.models.transitions.force import Noise
from swarmssm.models.transitions.hierarchy import Hierarchical
from swarmssm.models.transitions.protocols import Form

__all__ = ["boids"]

Gains = Literal["global", "individual", "hierarchical"]
#: Slower than this share of the typical speed somebody rests: in proportion to that speed there
#: would be no noise, and no way to start again.
RESTS = 0.25


def boids(
    scales: Scales,
    *,
    form: Form = "acceleration",
    gains: Gains = "global",
    noise: Noise | None = None,
    walls: bool = True,
    limits: bool = True,
    relaxation: bool = False,
    radius: float | Literal["infer"] | None = None,
    edges: str | None = None,
    observed: Observed = "positions",
    priors: Mapping[str, Any] | None = None,
) -> StateSpaceModel:
    r"""Return the boids law with weakly informative priors in the units of the tracks.

    Let L be the standard deviation of positions, U the typical speed (tracking noise taken off),
    l the distance to the nearest neighbour. A force that matters turns an individual within such
    a length, which says of what order the gains are; the priors are 1.5 wide in the logarithm,
    that is a factor of 20 to both sides with 95 %. ``LogNormal`` is written with its median:

    =====================================  =================================================
    ``transition.cohesion_gain``           LogNormal((U/L)^2, 1.5): pulled over L, it turns
    ``transition.separation_gain``         LogNormal(U^2, 1.5): so pushed at any distance
    ``transition.alignment_gain``          LogNormal(U/L, 1.5): turns to the others within L
    ``transition.wall_gain``               LogNormal((U/L)^2, 1.5), as cohesion
    ``transition.half_width``              each axis, LogNormal(0.85 of half the extent, 0.25):
                                           soft walls are left by a part of the depth
    ``transition.center``                  each axis, Normal(middle of the extent, a tenth of it)
    ``transition.relaxation_gain``         LogNormal(U/L, 1.5)
    ``transition.preferred_speed``         LogNormal(U, 0.5)
    ``transition.min_speed``               LogNormal(U/2, 1)
    ``transition.max_speed``               LogNormal(1.5 U, 0.5)
    ``transition.process_noise``           LogNormal: in the time L/U it changes the velocity by
                                           0.3 U; 1.5 wide
    ``transition.radius``                  LogNormal(3 l, 0.5)
    ``emission.noise``                     LogNormal(estimated tracking noise, 0.5); if none could
                                           be told, a tenth of the step from frame to frame, and
                                           1.5 wide
    =====================================  =================================================

    In the velocity form forces add to a velocity at once, so that a gain is of the order of what
    is above times L/U; the alignment gain is LogNormal(1, 0.5).

    Parameters
    ----------
    scales
        Of the training tracks.
    form, noise
        See :class:`~swarmssm.models.transitions.BoidsTransition`; unless it is given, ``noise`` is
        additive for velocities, and for accelerations where somebody rests (the 2nd percentile of
        speed is below a quarter of the typical speed), else multiplicative.
    gains
        Of cohesion, separation and alignment: ``"global"``, one for all; ``"individual"``, each
        its own, with the prior above; ``"hierarchical"``, each its own, from a population whose
        median has the prior above and whose spread (of the logarithm) is HalfNormal(0.5).
    walls
        Whether there are soft walls, whose place is inferred.
    limits
        Whether speed is limited. Hidden limits are inferred. With ``observed="states"`` they are
        the 2nd and the 98th percentile of speed, and speeds beyond count as known to be beyond;
        that is right whether or not there are limits, and gives the limits where many speeds are
        at them.
    relaxation
        Whether there is speed regulation, as animals without hard limits have.
    radius
        ``None``: whom an individual sees is as the graph says. A number: of those, the ones within
        it. ``"infer"``: within a radius to be inferred, at which the view fades out over a
        quarter of l; then the graph is complete unless ``edges`` is given.
    edges
        ``"observed"``: the graph that comes with the data. A rule such as ``"radius:2.5"``: the
        graph of the hidden states.
    observed
        ``"positions"`` with noise, or ``"states"``, exactly.
    priors
        In place of those above: name, with or without ``transition.``, to a distribution, its text
        such as ``"LogNormal(0, 1)"``, or a fixed number or list
        (:func:`swarmssm.models.priors.with_priors`).

    Raises
    ------
    InputError
        If an option is none of the above, or there is no parameter of that name.
    """
    check_choice("gains", gains, get_args(Gains))
    check_choice("observed", observed, get_args(Observed))
    view = view_priors(scales, radius)
    if noise is None:
        noise = "multiplicative" if form == "acceleration" and not _rests(scales) else "additive"
    length, speed = positive(scales.length), true_speed(scales)
    rate = speed / length
    # What a force is, a change of velocity in unit time or the velocity itself.
    per = rate if form == "acceleration" else 1.0

    def social(median: float, spread: float = WIDE) -> Any:
        if gains == "global":
            return lognormal(median, spread)
        if gains == "individual":
            own = lognormal(median, spread).expand(torch.Size([scales.individuals]))
            return own.to_event(1)
        population = dist.HalfNormal(torch.tensor(0.5))
        return Hierarchical(lognormal(median, spread), population, scales.individuals)

    transition = BoidsTransition(
        scales.space,
        scales.dt,
        form=form,
        noise=noise,
        cohesion_gain=social(per * rate),
        separation_gain=social(per * speed * length if form == "velocity" else speed**2),
        alignment_gain=social(per) if form == "acceleration" else social(1.0, 0.5),
        **view,
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
    return state_space_model(
        scales,
        transition,
        observed=observed,
        edges=edges,
        infer_radius=radius == "infer",
        priors=priors,
    )


def _rests(scales: Scales) -> bool:
    """Return whether somebody rests, as far as tracking noise lets it be seen."""
    slow = RESTS * scales.speed
    return scales.slow < slow and math.sqrt(2.0) * scales.noise / scales.dt < slow
