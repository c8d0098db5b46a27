"""A distribution written out as text, as a command line or a settings file has it."""

import ast
import inspect
import math
import warnings
from collections.abc import Mapping
from typing import Any

import pyro.distributions as dist
import torch
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.models.supports import describe

__all__ = ["EXAMPLE", "PRIORS", "distribution_text", "exact_text", "parse_distribution"]

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
#: Numbers of one argument that are written out.
WRITTEN = 4
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
    if not isinstance(text, str):
        raise InputError(f"prior: it must be a text, not {type(text).__name__}. {EXAMPLE}")
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


def distribution_text(distribution: Any) -> str:
    """Write a distribution as :func:`parse_distribution` reads it, as far as that is possible.

    Parameters
    ----------
    distribution
        Of Pyro's or torch's; independence over an event is not written. An argument of one value
        throughout is written as one number, one of more than four different numbers as how many
        they are. What has no arguments that are numbers is its name alone.
    """
    distribution = _inner(distribution)
    written = [_written(value) for value in _given(distribution).values()]
    return (
        f"{type(distribution).__name__}({', '.join(written)})"
        if written
        else (type(distribution).__name__)
    )


def exact_text(distribution: Any) -> str:
    """Write a distribution so that :func:`parse_distribution` makes the same one of it.

    Parameters
    ----------
    distribution
        Of Pyro's or torch's.

    Raises
    ------
    InputError
        If it is none that can be written as text (:data:`PRIORS`).
    """
    inner = _inner(distribution)
    name = type(inner).__name__
    if name not in PRIORS or isinstance(inner, dist.MaskedDistribution):
        raise InputError(
            f"prior: a {name} cannot be written as text, which a run folder stores. Choose one of "
            f"{', '.join(PRIORS)}, or put the prior into a model of your own."
        )
    shape = distribution.batch_shape + distribution.event_shape
    given = {
        argument: value.expand(shape) if not value.dim() and not inner.event_shape else value
        for argument, value in _given(inner).items()
    }
    return f"{name}({', '.join(f'{key}={value.tolist()}' for key, value in given.items())})"


def _inner(distribution: Any) -> Any:
    """Return a distribution without what only tells the shape of its values."""
    while isinstance(
        distribution,
        torch.distributions.Independent | dist.ExpandedDistribution | dist.MaskedDistribution,
    ):
        distribution = distribution.base_dist
    return distribution


def _given(distribution: Any) -> dict[str, torch.Tensor]:
    """Return the arguments that a distribution was made with, by name."""
    found = {}
    for name in _arguments(type(distribution)):
        # Of several ways to give one thing only that which was taken is stored; lazy properties
        # would compute the others.
        kind = inspect.getattr_static(type(distribution), name, None)
        stored = name in vars(distribution) or isinstance(kind, property)
        value = getattr(distribution, name, None) if stored else None
        if isinstance(value, torch.Tensor):
            found[name] = value.detach()
    return found


def _written(value: torch.Tensor) -> str:
    """Return a number, a list of few, or how many they are."""
    numbers = value.flatten().tolist()
    if numbers and all(number == numbers[0] for number in numbers):
        return f"{numbers[0]:.4g}"
    if value.dim() < 2 and len(numbers) <= WRITTEN:
        return f"[{', '.join(f'{number:.4g}' for number in numbers)}]"
    return f"{' x '.join(map(str, value.shape))} numbers"


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
