"""Boids with unknown gains, seen with noise: ``swarmssm fit FILE --model boids``."""

import math
from collections.abc import Mapping
from typing import Any, Literal, get_args

import pyro.distributions as dist
import torch

from swarmssm.errors import InputError
from swarmssm.models.edges import LatentEdges, ObservedEdges
from swarmssm.models.emissions import PositionEmission
from swarmssm.models.initial import InitialStates
from swarmssm.models.parameters import assign
from swarmssm.models.priors import parameters_of, with_priors
from swarmssm.models.scales import Scales
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.boids import BoidsTransition
from swarmssm.models.transitions.hierarchy import Hierarchical
from swarmssm.models.transitions.social import Form, Noise

__all__ = ["boids"]

Gains = Literal["global", "individual", "hierarchical"]
#: Standard deviation of the logarithm of what only the order of magnitude is known of.
WIDE = 1.5
#: Share of its speed by which an individual is thought to be changed by noise in a length's time.
WANDER = 0.3


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
    observed: Literal["positions", "states"] = "positions",
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
        See :class:`~swarmssm.models.transitions.BoidsTransition`; ``noise`` is multiplicative
        for accelerations and additive for velocities unless it is given.
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
    for name, value, allowed in (
        ("gains", gains, get_args(Gains)),
        ("observed", observed, ("positions", "states")),
    ):
        if value not in allowed:
            raise InputError(f"{name}: it must be one of {', '.join(allowed)}, not {value!r}.")
    if isinstance(radius, str) and radius != "infer":
        raise InputError(f"radius: it must be a number or 'infer', not {radius!r}.")
    if noise is None:
        noise = "multiplicative" if form == "acceleration" else "additive"
    infer_radius = radius == "infer"
    length, speed = _positive(scales.length), _speed(scales)
    spacing = _positive(scales.spacing)
    rate = speed / length
    # What a force is, a change of velocity in unit time or the velocity itself.
    per = rate if form == "acceleration" else 1.0

    def social(median: float, spread: float = WIDE) -> Any:
        if gains == "global":
            return _lognormal(median, spread)
        if gains == "individual":
            own = _lognormal(median, spread).expand(torch.Size([scales.individuals]))
            return own.to_event(1)
        population = dist.HalfNormal(torch.tensor(0.5))
        return Hierarchical(_lognormal(median, spread), population, scales.individuals)

    options: dict[str, Any] = {
        "cohesion_gain": social(per * rate),
        "separation_gain": social(per * speed * length if form == "velocity" else speed**2),
        "alignment_gain": social(per) if form == "acceleration" else social(1.0, 0.5),
        "process_noise": _lognormal(_wander(noise, speed, rate, scales.dt), WIDE),
    }
    if walls:
        low, high = torch.tensor(scales.low), torch.tensor(scales.high)
        extent = (high - low).clamp(min=1e-6 * length)
        options["wall_gain"] = _lognormal(per * rate, WIDE)
        options["half_width"] = dist.LogNormal((0.425 * extent).log(), 0.25).to_event(1)
        options["center"] = dist.Normal(0.5 * (low + high), 0.1 * extent).to_event(1)
    if relaxation:
        options["relaxation_gain"] = _lognormal(per, WIDE)
        options["preferred_speed"] = _lognormal(speed, 0.5)
    if limits and observed == "positions":
        options["min_speed"] = _lognormal(0.5 * speed, 1.0)
        options["max_speed"] = _lognormal(1.5 * speed, 0.5)
    elif limits:
        options["min_speed"] = scales.slow
        options["max_speed"] = _positive(scales.fast)
    if radius is not None:
        options["radius"] = _lognormal(3.0 * spacing, 0.5) if infer_radius else radius
        options["radius_width"] = 0.25 * spacing if infer_radius else 0.0
    transition = BoidsTransition(scales.space, scales.dt, form=form, noise=noise, **options)

    emission = None
    if observed == "positions":
        seen = scales.noise > 0
        deviation = scales.noise if seen else 0.1 * speed * scales.dt
        emission = PositionEmission(scales.space, _lognormal(deviation, 0.5 if seen else WIDE))
    rule = ("complete" if infer_radius else "observed") if edges is None else edges
    model = StateSpaceModel(
        InitialStates.for_scales(scales),
        transition,
        emission,
        ObservedEdges() if rule == "observed" else LatentEdges(rule),
    )
    _replace_priors(model, priors or {})
    return model


def _replace_priors(model: StateSpaceModel, priors: Mapping[str, Any]) -> None:
    """Give parameters other priors, or fixed values."""
    known = parameters_of(model)
    others = {}
    for name, value in priors.items():
        if not isinstance(value, int | float | list | torch.Tensor):
            others[name] = value
            continue
        found = [full for full in known if full == name or full.endswith(f".{name}")]
        if len(found) != 1:
            listed = ", ".join(found or known)
            raise InputError(
                f"priors: {name} is the name of {'no' if not found else 'more than one'} "
                f"parameter. {'Choose' if found else 'Those there are'}: {listed}."
            )
        assign(*known[found[0]], value)
    if others:
        with_priors(model, others)


def _speed(scales: Scales) -> float:
    """Return the root mean square of speed without what tracking noise adds to it."""
    added = 2.0 * scales.space * (scales.noise / scales.dt) ** 2
    return _positive(math.sqrt(max(scales.speed**2 - added, (0.1 * scales.speed) ** 2)))


def _wander(noise: Noise, speed: float, rate: float, dt: float) -> float:
    """Return the process noise that changes the velocity by a share of it within L/U."""
    if noise == "multiplicative":
        return WANDER * math.sqrt(dt * rate)
    return WANDER * speed * math.sqrt(rate)


def _positive(value: float) -> float:
    """Return a scale that may be used as one, where tracks stand still."""
    return max(value, 1e-6)


def _lognormal(median: float, spread: float) -> dist.LogNormal:
    return dist.LogNormal(torch.tensor(math.log(median)), torch.tensor(spread))
