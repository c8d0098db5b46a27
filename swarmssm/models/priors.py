"""Priors by name: from text, and on any parameter of a model that stands already."""

import ast
import inspect
import math
import warnings
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, NamedTuple

import pyro.distributions as dist
import torch
from pyro.nn import PyroModule, PyroSample
from torch import nn
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.models.parameters import Declaration, adopt, check_prior, declaration
from swarmssm.models.simulation import seeded
from swarmssm.models.supports import describe, usual_constraint

__all__ = ["PRIORS", "parameters_of", "parse_distribution", "with_priors"]

#: Distributions that may be written as text: continuous ones whose parameters are numbers.
PRIORS = (
    "Beta",
    "Cauchy",
    "Chi2",
    "Dirichlet",
    "Exponential",
    "Gamma",
    "Gumbel",
    "HalfCauchy",
    "HalfNormal",
    "InverseGamma",
    "Kumaraswamy",
    "Laplace",
    "LogNormal",
    "Logistic",
    "MultivariateNormal",
    "Normal",
    "Pareto",
    "SoftLaplace",
    "StudentT",
    "Uniform",
    "VonMises",
    "Weibull",
)
#: An example for each kind of mistake.
EXAMPLE = "Write for instance LogNormal(-1, 0.5) or Normal(loc=[0, 0], scale=2)."


def parse_distribution(text: str) -> Any:
    """Read a distribution as it is written in Python; nothing is run.

    Parameters
    ----------
    text
        Name and arguments of one of :data:`PRIORS` as in :mod:`pyro.distributions`:
        ``"LogNormal(-1, 0.5)"``, ``"Normal(loc=[0, 0], scale=2)"``. Arguments are numbers, or
        lists of them for distributions over vectors.

    Returns
    -------
    A distribution of Pyro's, of one vector where arguments are lists.

    Raises
    ------
    InputError
        If the text is something else or a value is out of range: names text, place and mend.
    """
    text = text.strip()
    try:
        with warnings.catch_warnings(action="ignore"):
            call = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        column = getattr(error, "offset", None)
        place = f" at character {column}" if column else ""
        raise InputError(
            f"prior: {text[:100]!r} cannot be read{place} as a name with arguments in brackets. "
            f"{EXAMPLE}"
        ) from None
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
        raise InputError(f"prior: {text!r} is no name with arguments in brackets. {EXAMPLE}")
    name = call.func.id
    if name not in PRIORS:
        raise InputError(
            f"prior: in {text!r}, {name} is no known distribution. Choose one of "
            f"{', '.join(PRIORS)}."
        )
    build = getattr(dist, name)
    wanted = _arguments(build)
    given: dict[str, torch.Tensor] = {}
    names = list(wanted)
    for index, item in enumerate(call.args):
        if index >= len(names):
            raise InputError(
                f"prior: {text!r} has {len(call.args)} arguments, and {name} takes at most "
                f"{len(names)}: {', '.join(names)}."
            )
        given[names[index]] = _tensor(item, text, f"argument {index + 1}")
    for keyword in call.keywords:
        key = keyword.arg
        if key is None or key not in wanted or key in given:
            what = "given twice" if key in given else f"not one of {', '.join(wanted)}"
            raise InputError(f"prior: in {text!r}, {key or '**'} is {what}.")
        given[key] = _tensor(keyword.value, text, key)
    missing = [key for key, needed in wanted.items() if needed and key not in given]
    if missing:
        raise InputError(f"prior: {text!r} lacks {', '.join(missing)}.")
    try:
        made = build(**given, validate_args=True)
    except (TypeError, ValueError, RuntimeError, IndexError):
        raise InputError(f"prior: {text!r} is not possible: {_reason(given, build)}") from None
    return made.to_event(len(made.batch_shape)) if made.batch_shape else made


def _arguments(build: Any) -> dict[str, bool]:
    """Return the names of a distribution's arguments, and whether each must be given."""
    found = inspect.signature(build.__init__).parameters
    names = [name for name in found if name not in ("self", "validate_args")]
    # Either of several may be given to a multivariate normal; the ones left out stay None.
    return {name: found[name].default is inspect.Parameter.empty for name in names}


def _tensor(item: ast.expr, text: str, place: str) -> torch.Tensor:
    """Return a number or a list of lists of numbers that was written out."""
    try:
        return torch.tensor(_numbers(item), dtype=torch.get_default_dtype())
    except (TypeError, ValueError):
        written = ast.get_source_segment(text, item) or "it"
        raise InputError(
            f"prior: in {text!r}, {place} must be a number or a list of numbers, and {written} is "
            f"not. {EXAMPLE}"
        ) from None


def _numbers(item: ast.expr) -> Any:
    """Return a number, or a list of what stands in it."""
    if isinstance(item, ast.List | ast.Tuple):
        if not item.elts:
            raise ValueError
        return [_numbers(part) for part in item.elts]
    sign = 1.0
    while isinstance(item, ast.UnaryOp) and isinstance(item.op, ast.USub | ast.UAdd):
        sign = -sign if isinstance(item.op, ast.USub) else sign
        item = item.operand
    value = item.value if isinstance(item, ast.Constant) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return sign * value


def _reason(given: Mapping[str, torch.Tensor], build: Any) -> str:
    """Say which argument is out of range, or that shapes do not go together."""
    if {"low", "high"} <= given.keys():
        return "high must be greater than low."
    allowed = getattr(build, "arg_constraints", {})
    for name, value in given.items():
        constraint: Any = allowed.get(name, constraints.real)
        try:
            fits = bool(constraint.check(value).all())
        except (RuntimeError, IndexError, ValueError):
            continue
        if not fits:
            return f"{name} must be {describe(constraint)}."
    shapes = ", ".join(f"{name} {tuple(value.shape)}" for name, value in given.items())
    return f"its arguments do not go together (shapes: {shapes})."


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
        own += [*vars(module).get("_pyro_samples", {}), *vars(module).get("_pyro_params", {})]
        own += [
            name
            for name, value in module._parameters.items()
            if value is not None and not name.endswith("_unconstrained")
        ]
        for name in dict.fromkeys(own):
            found[f"{place}.{name}" if place else name] = Parameter(module, name)
    return found


def with_priors(model: PyroModule, priors: Mapping[str, Any]) -> PyroModule:
    """Put priors on parameters of a model.

    Parameters
    ----------
    model
        Changed in place, and returned. Make guides afterwards.
    priors
        Name -> distribution of Pyro's or its text (:func:`parse_distribution`). A name is a full
        one such as ``transition.cohesion_gain``, or as much of its end as no other shares,
        ``cohesion_gain``; weights of a network have the names of their layers,
        ``transition.network.0.weight``. A distribution of one number stands for independent ones
        in the shape of the parameter.

    Raises
    ------
    InputError
        If a name is unknown or shared, a text cannot be read, a shape does not fit, or a prior
        gives values that the parameter cannot have. The model is then as it was.
    """
    known = parameters_of(model)
    ready: dict[str, Any] = {}
    for name, given in priors.items():
        full = _full_name(name, known)
        if full in ready:
            raise InputError(f"prior: {full} is given twice, the second time as {name}.")
        prior = parse_distribution(given) if isinstance(given, str) else given
        if not isinstance(prior, dist.Distribution):
            raise InputError(
                f"prior: that of {full} must be a distribution from pyro.distributions or its "
                f"text, not {type(given).__name__}. {EXAMPLE}"
            )
        module, attribute = known[full]
        ready[full] = _fitted(full, prior, module, attribute, model)
    for full in ready:
        _join_pyro(model, full)
    adopt(model)
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
                part.__class__ = PyroModule[type(part)]
                vars(part).update(
                    _pyro_name="",
                    _pyro_context=model._pyro_context,
                    _pyro_params=OrderedDict(),
                    _pyro_samples=OrderedDict(),
                )


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
    if attribute in vars(module).get("_pyro_samples", {}):
        prior = module._pyro_samples[attribute]
        if not isinstance(prior, dist.Distribution):
            with seeded(0), model._pyro_context:
                prior = prior(module)
                if isinstance(prior, torch.Tensor):
                    return prior.shape, constraints.real
        return prior.batch_shape + prior.event_shape, usual_constraint(prior.support)
    if attribute in vars(module).get("_pyro_params", {}):
        value = getattr(module, f"{attribute}_unconstrained")
        constraint = module._pyro_params[attribute][0]
        return torch.distributions.transform_to(constraint)(value).shape, constraint
    value = module._parameters.get(attribute)
    value = module._buffers[attribute] if value is None else value
    return value.shape, constraints.real
