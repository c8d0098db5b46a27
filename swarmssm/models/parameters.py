"""Parameters of a model's parts: fixed, learned, or with a prior."""

import contextlib
import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyro.distributions as dist
import torch
from pyro.nn import PyroModule, PyroParam, PyroSample
from torch import nn
from torch.distributions import constraints

from swarmssm.errors import InputError
from swarmssm.models.prior_text import parse_distribution
from swarmssm.models.pyro_modules import call_context, constrained_in, priors_in
from swarmssm.models.supports import covers, describe

__all__ = [
    "Declaration",
    "Value",
    "assign",
    "convert_priors",
    "declaration",
    "fixed",
    "priors_of",
]

#: A fixed number or tensor; a distribution, which is a prior; or a parameter to be learned.
Value = float | str | torch.Tensor | dist.TorchDistribution | nn.Parameter | PyroParam | PyroSample


class Declaration(NamedTuple):
    """What a part of a model says of one of its parameters.

    Attributes
    ----------
    constraint
        The values that it may have.
    shapes
        The shapes that it may have, -1 standing for any number; ``None`` for any shape.
    """

    constraint: Any = constraints.real
    shapes: tuple[tuple[int, ...], ...] | None = None

    def allows(self, shape: Sequence[int]) -> bool:
        """Return whether the parameter may have a shape."""
        return self.shapes is None or any(
            len(shape) == len(own) and all(b in (a, -1) for a, b in zip(shape, own, strict=True))
            for own in self.shapes
        )


def assign(
    module: PyroModule,
    name: str,
    value: Any,
    *,
    constraint: Any = None,
    shapes: Sequence[Sequence[int]] | None = None,
) -> None:
    """Give a part of a model one of its parameters.

    Parameters
    ----------
    module
        The part. Afterwards ``module.<name>`` is a tensor wherever the model runs.
    name
        Name of the parameter, and of its sample site if it has a prior.
    value
        A number, list or tensor: fixed. A tensor of floats keeps its type, all else gets torch's
        default one. A distribution, its text such as ``"LogNormal(-1, 0.5)"``
        (:func:`swarmssm.models.parse_distribution`) or :class:`pyro.nn.PyroSample`: a prior, whose
        batch dimensions count as those of the parameter. A :class:`torch.nn.Parameter` or
        :class:`pyro.nn.PyroParam`: learned as a point, within the constraint.
    constraint
        From ``torch.distributions.constraints``: the values that the parameter may have. Absent,
        what was said the last time, or else all real numbers.
    shapes
        The shapes it may have, -1 standing for any number: ``[(), (2,)]``. Absent, what was said
        the last time, or else any.

    Raises
    ------
    TypeError
        If the value is something else.
    InputError
        If it does not fit the constraint or the shapes, or is NaN.
    """
    own = declaration(module, name)
    if constraint is not None:
        own = own._replace(constraint=constraint)
    if shapes is not None:
        own = own._replace(shapes=tuple(tuple(shape) for shape in shapes))
    ready = _checked(name, value, own)
    if name in priors_in(module) or name in constrained_in(module):
        delattr(module, name)
    for table in (module._parameters, module._buffers):
        table.pop(name, None)
    if isinstance(ready, PyroSample | PyroParam | nn.Parameter):
        setattr(module, name, ready)
    else:
        module.register_buffer(name, ready)
    vars(module).setdefault("_declarations", {})[name] = own


def declaration(module: nn.Module, name: str) -> Declaration:
    """Return what was said of a parameter when it was assigned; no restriction, if nothing was."""
    own: Declaration = vars(module).get("_declarations", {}).get(name, Declaration())
    return own


def _checked(name: str, value: Any, own: Declaration) -> Any:
    """Return what is stored for a value: a tensor, a parameter or a prior."""
    if isinstance(value, str):
        value = parse_distribution(value)
    if isinstance(value, dist.Distribution):
        value = PyroSample(value)
    if isinstance(value, PyroSample):
        prior = value.prior
        if isinstance(prior, dist.Distribution):
            return PyroSample(check_prior(name, prior, own))
        return PyroSample(_DependentPrior(name, prior, own))
    if isinstance(value, nn.Parameter):
        _check_value(name, value.detach(), own)
        bounded = own.constraint is not constraints.real
        return PyroParam(value.detach().clone(), own.constraint) if bounded else value
    if isinstance(value, PyroParam):
        if not covers(own.constraint, value.constraint):
            raise InputError(
                f"{name}: it must be {describe(own.constraint)}, and as a PyroParam it is only "
                f"held to be {describe(value.constraint)}. Give the constraint."
            )
        if isinstance(value.init_value, torch.Tensor):
            _check_value(name, value.init_value.detach(), own)
        return value
    return check_fixed(name, value, own)


def check_fixed(name: str, value: Any, own: Declaration) -> torch.Tensor:
    """Return a number, list, array or tensor as a fixed value of a parameter, or refuse it.

    Raises
    ------
    TypeError
        If it is something else.
    InputError
        If the parameter cannot have the value or the shape.
    """
    tensor = _as_tensor(name, value)
    _check_value(name, tensor, own)
    return tensor


def _as_tensor(name: str, value: Any) -> torch.Tensor:
    """Return a number, list, array or tensor as a tensor of floats."""
    if isinstance(value, torch.Tensor) and value.is_floating_point():
        return value.detach()
    plain = (torch.Tensor, np.ndarray, np.number, float, int, list, tuple)
    try:
        if isinstance(value, bool) or not isinstance(value, plain):
            raise TypeError
        return torch.as_tensor(value, dtype=torch.get_default_dtype())
    except (TypeError, ValueError):
        hint = " (take it from pyro.distributions)" if hasattr(value, "log_prob") else ""
        raise TypeError(
            f"{name} must be a number, a distribution or a parameter, not "
            f"{type(value).__name__}{hint}"
        ) from None


def _check_value(name: str, value: torch.Tensor, own: Declaration) -> None:
    """Refuse a fixed value, or where learning starts, that the parameter cannot have."""
    if value.isnan().any():
        raise InputError(f"{name}: it is not a number (NaN).")
    _check_shape(name, tuple(value.shape), own)
    if not bool(own.constraint.check(value).all()):
        shown = ", ".join(f"{number:g}" for number in value.flatten()[:4].tolist())
        shown = f"[{shown}{', ...' if value.numel() > 4 else ''}]" if value.dim() else shown
        raise InputError(f"{name}: it must be {describe(own.constraint)}, and it is {shown}.")


def check_prior(name: str, prior: dist.TorchDistribution, own: Declaration) -> Any:
    """Return a prior as a distribution of one value of the parameter, or refuse it.

    Raises
    ------
    InputError
        If it is discrete, or gives values or a shape that the parameter cannot have.
    """
    prior = prior.to_event(len(prior.batch_shape)) if prior.batch_shape else prior
    _check_shape(name, tuple(prior.event_shape), own)
    if not covers(own.constraint, prior.support):
        raise InputError(
            f"{name}: it must be {describe(own.constraint)}, and the values of the prior may be "
            f"{describe(prior.support)}. Take a prior of such values"
            + (
                ", for instance LogNormal, HalfNormal or Gamma."
                if own.constraint is constraints.positive
                else "."
            )
        )
    return prior


def _check_shape(name: str, shape: tuple[int, ...], own: Declaration) -> None:
    """Refuse a shape that the parameter cannot have."""
    if not own.allows(shape):
        texts = [str(s).replace("-1", "any number") if s else "a number" for s in own.shapes or ()]
        raise InputError(f"{name}: it must be {' or '.join(texts)} in shape, and it is {shape}.")


class _DependentPrior:
    """A prior that is made from other parameters of its part whenever the model runs."""

    def __init__(self, name: str, make: Callable[[Any], Any], own: Declaration) -> None:
        self.name, self.make, self.own = name, make, own

    def __call__(self, module: PyroModule) -> Any:
        """Return the distribution, or the value that follows from other parameters."""
        made = self.make(module)
        return made if isinstance(made, torch.Tensor) else check_prior(self.name, made, self.own)


def priors_of(model: PyroModule) -> list[str]:
    """Return the full names of all parameters with a prior, in the order they are sampled in."""
    names = []
    for place, module in model.named_modules():
        names += [f"{place}.{name}" if place else name for name in priors_in(module)]
    return names


def convert_priors(model: nn.Module, change: Callable[[torch.Tensor], torch.Tensor]) -> None:
    """Apply a change of type or device to the numbers in the priors, as torch does to parameters.

    Parameters
    ----------
    model
        Changed in place.
    change
        From tensor to tensor.
    """
    for module in model.modules():
        priors = priors_in(module)
        for name, prior in priors.items():
            if isinstance(prior, dist.Distribution):
                priors[name] = _converted(prior, change)


def _converted(
    part: Any, change: Callable[[torch.Tensor], torch.Tensor], seen: dict[int, Any] | None = None
) -> Any:
    """Return a distribution or transform with other tensors in it."""
    # A transform and its inverse know each other.
    seen = {} if seen is None else seen
    if id(part) in seen:
        return seen[id(part)]
    if isinstance(part, torch.Tensor):
        return change(part)
    if type(part) in (list, tuple):
        return type(part)(_converted(item, change, seen) for item in part)
    if isinstance(part, torch.distributions.Distribution | torch.distributions.Transform):
        twin = seen[id(part)] = copy.copy(part)
        for key, item in vars(part).items():
            vars(twin)[key] = _converted(item, change, seen)
        return twin
    return part


@contextlib.contextmanager
def fixed(model: PyroModule, values: Mapping[str, torch.Tensor]) -> Iterator[None]:
    """Let parameters with priors have given values for a while, instead of being sampled.

    A :class:`~pyro.nn.PyroModule` samples each of them once in a call of the model and forgets
    it at the end. A path of states is scored after that: with this it meets the same values.

    Parameters
    ----------
    model
        The whole model, in which the names are unique.
    values
        Full name -> value, such as ``{"transition.cohesion_gain": ...}``.
    """
    context = call_context(model)
    with context:
        before = dict(context.cache)
        context.cache.update(values)
        try:
            yield
        finally:
            context.cache.clear()
            context.cache.update(before)
