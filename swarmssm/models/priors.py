"""Priors on any parameter of a model that stands already, by name."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import pyro.distributions as dist
import torch
from pyro.nn import PyroModule, PyroSample
from torch import nn
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.models.parameters import (
    Declaration,
    assign,
    check_fixed,
    check_prior,
    declaration,
)
from swarmssm.models.prior_text import EXAMPLE, PRIORS, distribution_text, parse_distribution
from swarmssm.models.pyro_modules import (
    adopt,
    call_context,
    constrained_in,
    make_pyro_module,
    priors_in,
)
from swarmssm.models.simulation import seeded
from swarmssm.models.supports import usual_constraint

__all__ = ["PRIORS", "parameters_of", "parse_distribution", "prior_texts", "with_priors"]


#: Text of a prior that is a function of other parameters.
DEPENDENT = "given others"


class Parameter(NamedTuple):
    """A parameter of a part of a model.

    Attributes
    ----------
    module
        The part.
    attribute
        Its name there.
    """

    module: Any
    attribute: str


def parameters_of(model: nn.Module) -> dict[str, Parameter]:
    """Return every parameter of a model by its full name: fixed, learned, or with a prior."""
    found: dict[str, Parameter] = {}
    for place, module in model.named_modules():
        own = [*vars(module).get("_declarations", {})]
        own += [*priors_in(module), *constrained_in(module)]
        own += [
            name
            for name, value in module._parameters.items()
            if value is not None and not name.endswith("_unconstrained")
        ]
        for name in dict.fromkeys(own):
            found[f"{place}.{name}" if place else name] = Parameter(module, name)
    return found


def prior_texts(model: nn.Module) -> dict[str, str]:
    """Return the prior of each parameter that has one as text, by full name.

    One that is a function of other parameters is :data:`DEPENDENT`.
    """
    samples = {
        full: priors_in(module).get(attribute)
        for full, (module, attribute) in parameters_of(model).items()
    }
    return {
        full: distribution_text(prior) if isinstance(prior, dist.Distribution) else DEPENDENT
        for full, prior in samples.items()
        if prior is not None
    }


def with_priors(model: PyroModule, priors: Mapping[str, Any]) -> PyroModule:
    """Put priors on parameters of a model, or hold them where they are known.

    Parameters
    ----------
    model
        Changed in place, and returned. Make guides afterwards.
    priors
        Name -> distribution of Pyro's or its text (:func:`parse_distribution`); or a number, a
        list, or their text, at which the parameter is held. A name is a full
        one such as ``transition.cohesion_gain``, or as much of its end as no other shares,
        ``cohesion_gain``; weights of a network have the names of their layers,
        ``transition.network.0.weight``. A distribution of one number stands for independent ones
        in the shape of the parameter, one number for as many.

    Raises
    ------
    InputError
        If a name is unknown or shared, a text cannot be read, a shape does not fit, or a prior
        gives values that the parameter cannot have. The model is then as it was.
    """
    if not isinstance(priors, Mapping):
        raise InputError(
            "priors: they must be a dictionary of names and distributions, not "
            f"{type(priors).__name__}."
        )
    known = parameters_of(model)
    ready: dict[str, Any] = {}
    held: dict[str, torch.Tensor] = {}
    for name, given in priors.items():
        full = _full_name(name, known)
        if full in ready or full in held:
            raise InputError(f"prior: {full} is given twice, the second time as {name}.")
        module, attribute = known[full]
        try:
            given = _number(given)
            if isinstance(given, int | float | list | torch.Tensor):
                held[full] = _held(full, given, module, attribute, model)
                continue
            prior = parse_distribution(given) if isinstance(given, str) else given
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
        if not isinstance(prior, dist.Distribution):
            raise InputError(
                f"prior: that of {full} must be a distribution from pyro.distributions or its "
                f"text, not {type(given).__name__}. {EXAMPLE}"
            )
        ready[full] = _fitted(full, prior, module, attribute, model)
    for full in (*ready, *held):
        _join_pyro(model, full)
    adopt(model)
    for full, value in held.items():
        module, attribute = known[full]
        assign(module, attribute, value)
    for full, prior in ready.items():
        module, attribute = known[full]
        for table in (module._parameters, module._buffers):
            table.pop(attribute, None)
        setattr(module, attribute, PyroSample(prior))
    return model


def _join_pyro(model: PyroModule, full: str) -> None:
    """Make plain modules on the way to a parameter, and what is in them, modules of Pyro's.

    :func:`pyro.nn.module.to_pyro_module_` does so too, but registers parts anew, which it refuses
    to do once the model has run.
    """
    place: Any = model
    for name in full.split(".")[:-1]:
        place = place._modules[name]
        if isinstance(place, PyroModule):
            continue
        # All of them: Pyro asks a module of its own for its weights when these are read, and a
        # plain one when that itself is read, which a container does not do.
        for part in list(place.modules()):
            if not isinstance(part, PyroModule):
                make_pyro_module(part, model)


def _full_name(name: str, known: Mapping[str, Parameter]) -> str:
    """Return the full name that is meant."""
    if name in known:
        return name
    ends = [full for full in known if full.endswith(f".{name}")] if name else []
    if len(ends) == 1:
        return ends[0]
    if ends:
        raise InputError(f"prior: {name} may be any of {', '.join(ends)}. Give the full name.")
    there = ", ".join(known) if known else "none"
    raise InputError(f"prior: the model has no parameter {name!r}. Those there are: {there}.")


def _number(given: Any) -> Any:
    """Return the number or the list that a text is, and everything else as it stands."""
    if not isinstance(given, str):
        return given
    try:
        value = json.loads(given)
    except json.JSONDecodeError:
        return given
    return value if isinstance(value, int | float | list) else given


def _held(full: str, given: Any, module: Any, attribute: str, model: PyroModule) -> torch.Tensor:
    """Return the value at which a parameter is held, or refuse it."""
    own = declaration(module, attribute)
    shape, present = _present(module, attribute, model)
    if own.constraint is constraints.real:
        own = own._replace(constraint=present)
    if own.shapes is None and shape:
        own = Declaration(own.constraint, (tuple(shape),))
    try:
        value = check_fixed(full, given, Declaration(own.constraint))
        value = value.expand(shape).clone() if not value.dim() else value
        return check_fixed(full, value, own)
    except TypeError as error:
        raise InputError(f"prior: {error}") from error


def _fitted(
    full: str, prior: Any, module: Any, attribute: str, model: PyroModule
) -> dist.TorchDistribution:
    """Return a prior in the shape of its parameter, or refuse it."""
    own = declaration(module, attribute)
    shape, present = _present(module, attribute, model)
    if own.constraint is constraints.real:
        own = own._replace(constraint=present)
    scalar = not prior.batch_shape and not prior.event_shape
    if scalar and shape:
        prior = prior.expand(shape)
    prior = prior.to_event(len(prior.batch_shape)) if prior.batch_shape else prior
    # A parameter that is one number for all may get one for each, unless its part says otherwise.
    widened = not shape and own.shapes is None
    if own.shapes is None and not widened:
        own = Declaration(own.constraint, (tuple(shape),))
    checked: dist.TorchDistribution = check_prior(f"prior: {full}", prior, own)
    return checked


def _present(module: Any, attribute: str, model: PyroModule) -> tuple[torch.Size, Any]:
    """Return the shape that a parameter has now, and what values it may have."""
    if attribute in priors_in(module):
        prior = priors_in(module)[attribute]
        if not isinstance(prior, dist.Distribution):
            with seeded(0), call_context(model):
                prior = prior(module)
                if isinstance(prior, torch.Tensor):
                    return prior.shape, constraints.real
        return prior.batch_shape + prior.event_shape, usual_constraint(prior.support)
    if attribute in constrained_in(module):
        value = getattr(module, f"{attribute}_unconstrained")
        constraint = constrained_in(module)[attribute][0]
        return torch.distributions.transform_to(constraint)(value).shape, constraint
    value = module._parameters.get(attribute)
    value = module._buffers[attribute] if value is None else value
    return value.shape, constraints.real
