"""What ready-made models of forces share: what individuals do by themselves, and how they are seen.

Let L be the standard deviation of positions and U the typical speed (tracking noise taken off). A
force that matters turns an individual within such a length, which says of what order gains are;
what only the order of magnitude is known of has a log-normal prior 1.5 wide in the logarithm.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal

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
from swarmssm.models.transitions.base import Transition
from swarmssm.models.transitions.force import Noise
from swarmssm.models.transitions.protocols import Form

__all__ = [
    "WIDE",
    "Observed",
    "check_choice",
    "lognormal",
    "positive",
    "replace_priors",
    "self_term_priors",
    "state_space_model",
    "true_speed",
    "view_priors",
]

Observed = Literal["positions", "states"]
#: Standard deviation of the logarithm of what only the order of magnitude is known of.
WIDE = 1.5
#: Share of its speed by which an individual is thought to be changed by noise in a length's time.
WANDER = 0.3


def check_choice(name: str, value: Any, allowed: tuple[Any, ...]) -> None:
    """Refuse an option that is none of those allowed."""
    if value not in allowed:
        listed = ", ".join(str(choice) for choice in allowed)
        raise InputError(f"{name}: it must be one of {listed}, not {value!r}.")


def self_term_priors(
    scales: Scales,
    *,
    form: Form,
    noise: Noise,
    walls: bool,
    limits: bool,
    relaxation: bool,
    observed: Observed,
) -> dict[str, Any]:
    """Return priors of walls, speed regulation, limits of speed and noise.

    For :meth:`swarmssm.models.transitions.ForceTransition.assign_self_terms`; see
    :func:`swarmssm.models.presets.boids` for what they are.
    """
    length, speed = positive(scales.length), true_speed(scales)
    rate = speed / length
    # What a force is, a change of velocity in unit time or the velocity itself.
    per = rate if form == "acceleration" else 1.0
    options: dict[str, Any] = {
        "process_noise": lognormal(_wander(noise, speed, rate, scales.dt), WIDE)
    }
    if walls:
        low, high = torch.tensor(scales.low), torch.tensor(scales.high)
        extent = (high - low).clamp(min=1e-6 * length)
        options["wall_gain"] = lognormal(per * rate, WIDE)
        options["half_width"] = dist.LogNormal((0.425 * extent).log(), 0.25).to_event(1)
        options["center"] = dist.Normal(0.5 * (low + high), 0.1 * extent).to_event(1)
    if relaxation:
        options["relaxation_gain"] = lognormal(per, WIDE)
        options["preferred_speed"] = lognormal(speed, 0.5)
    if limits and observed == "positions":
        options["min_speed"] = lognormal(0.5 * speed, 1.0)
        options["max_speed"] = lognormal(1.5 * speed, 0.5)
    elif limits:
        options["min_speed"] = scales.slow
        options["max_speed"] = positive(scales.fast)
    return options


def view_priors(scales: Scales, radius: float | Literal["infer"] | None) -> dict[str, Any]:
    """Return radius and width of the view: none, a given radius, or a prior of it.

    Raises
    ------
    InputError
        If the radius is neither a number nor ``"infer"``.
    """
    if isinstance(radius, str) and radius != "infer":
        raise InputError(f"radius: it must be a number or 'infer', not {radius!r}.")
    if radius is None:
        return {}
    spacing = positive(scales.spacing)
    if radius == "infer":
        return {"radius": lognormal(3.0 * spacing, 0.5), "radius_width": 0.25 * spacing}
    return {"radius": radius, "radius_width": 0.0}


def state_space_model(
    scales: Scales,
    transition: Transition,
    *,
    observed: Observed = "positions",
    edges: str | None = None,
    infer_radius: bool = False,
    priors: Mapping[str, Any] | None = None,
) -> StateSpaceModel:
    """Return the model of a transition, with its states observed with noise or exactly.

    Parameters
    ----------
    scales
        Of the training tracks.
    transition
        How the swarm goes from one frame to the next.
    observed, edges, priors
        As in :func:`swarmssm.models.presets.boids`.
    infer_radius
        Whether the radius is inferred, so that the graph is complete unless it is given.
    """
    emission = None
    if observed == "positions":
        seen = scales.noise > 0
        deviation = scales.noise if seen else 0.1 * true_speed(scales) * scales.dt
        emission = PositionEmission(scales.space, lognormal(deviation, 0.5 if seen else WIDE))
    rule = ("complete" if infer_radius else "observed") if edges is None else edges
    model = StateSpaceModel(
        InitialStates.for_scales(scales),
        transition,
        emission,
        ObservedEdges() if rule == "observed" else LatentEdges(rule),
    )
    replace_priors(model, priors or {})
    return model


def replace_priors(model: StateSpaceModel, priors: Mapping[str, Any]) -> None:
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


def true_speed(scales: Scales) -> float:
    """Return the root mean square of speed without what tracking noise adds to it."""
    added = 2.0 * scales.space * (scales.noise / scales.dt) ** 2
    return positive(math.sqrt(max(scales.speed**2 - added, (0.1 * scales.speed) ** 2)))


def _wander(noise: Noise, speed: float, rate: float, dt: float) -> float:
    """Return the process noise that changes the velocity by a share of it within L/U."""
    if noise == "multiplicative":
        return WANDER * math.sqrt(dt * rate)
    return WANDER * speed * math.sqrt(rate)


def positive(value: float) -> float:
    """Return a scale that may be used as one, where tracks stand still."""
    return max(value, 1e-6)


def lognormal(median: float, spread: float) -> dist.LogNormal:
    """Return a log-normal prior by its median and the spread of the logarithm."""
    return dist.LogNormal(torch.tensor(math.log(median)), torch.tensor(spread))
