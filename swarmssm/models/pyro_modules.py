"""The one door to what Pyro keeps of a module for itself, and the base of models' parts.

A :class:`~pyro.nn.PyroModule` holds its priors, constrained parameters, full name and the cache of
a call in attributes without a public interface. All of this package that needs them asks here.
"""

import contextlib
from collections import OrderedDict
from collections.abc import Iterator, MutableMapping
from typing import Any

import pyro
from pyro.nn import PyroModule
from torch import nn

__all__ = [
    "LocalPyroModule",
    "adopt",
    "call_context",
    "constrained_in",
    "keep_own_parameters",
    "make_pyro_module",
    "own_parameters",
    "priors_in",
]


def priors_in(module: nn.Module) -> MutableMapping[str, Any]:
    """Return the priors of a module's own parameters by name, which may be changed; none, if it is
    no module of Pyro's.

    A prior is a distribution, or a function of the module that returns one.
    """
    found: MutableMapping[str, Any] = vars(module).get("_pyro_samples", {})
    return found


def constrained_in(module: nn.Module) -> MutableMapping[str, Any]:
    """Return constraint and event dimension of a module's own learned parameters by name."""
    found: MutableMapping[str, Any] = vars(module).get("_pyro_params", {})
    return found


def call_context(model: PyroModule) -> Any:
    """Return what a model remembers while it is called: ``cache`` and ``set(name, value)``.

    It is a context manager, within which each parameter is sampled once.
    """
    return model._pyro_context


def adopt(model: PyroModule) -> None:
    """Let all parts of a model know their full names and sample within its calls.

    Pyro does so for parts that are attributes of parts. One in a :class:`torch.nn.ModuleList` or
    inside another plain module would otherwise draw anew at each reading, unknown to any guide.
    """
    for place, module in model.named_modules():
        if isinstance(module, PyroModule):
            module._pyro_name = place
            module._pyro_context = model._pyro_context


def make_pyro_module(module: nn.Module, model: PyroModule) -> None:
    """Make a plain module one of Pyro's, in place, which belongs to a model."""
    module.__class__ = PyroModule[type(module)]
    vars(module).update(
        _pyro_name="",
        _pyro_context=model._pyro_context,
        _pyro_params=OrderedDict(),
        _pyro_samples=OrderedDict(),
    )


def keep_own_parameters(module: nn.Module) -> None:
    """Let a module be able to keep its parameters itself, also if it was built to use Pyro's store.

    Parameters may live in the modules, as in a fit, or in Pyro's store: a module that was built
    under the one setting must not fail under the other.
    """
    context = vars(module).get("_pyro_context")
    if context is not None and not hasattr(context, "param_state"):
        # As Pyro makes it where a module is born under the setting.
        context.param_state = {"params": {}, "constraints": {}}


@contextlib.contextmanager
def own_parameters(*modules: nn.Module) -> Iterator[None]:
    """Let modules have their own parameters for a while, and not those of Pyro's store.

    Unless told otherwise Pyro keeps parameters by name in one store for the whole process, which
    it believes rather than the module: of two fitted models, the second would have those of the
    first. Training loops of a user's own may rest on the store, so that it is not put off for good.

    Parameters
    ----------
    modules
        Whole models and guides, those that are Pyro's and any others.
    """
    for module in modules:
        keep_own_parameters(module)
    with pyro.settings.context(module_local_params=True):
        yield


class LocalPyroModule(PyroModule):  # type: ignore[misc]
    """A Pyro module that makes no statement when a network in it is read.

    Where Pyro keeps parameters in a store of its own, reading an ordinary module out of a
    :class:`~pyro.nn.PyroModule` states each of its weights to Pyro; in a step of inference that
    takes as long as the network itself. With ``module_local_params``, as everywhere in this
    package, optimisers find weights in the modules, and nobody needs the statements.
    """

    def __getattr__(self, name: str) -> Any:
        modules = self.__dict__.get("_modules", {})
        if name in modules and pyro.settings.get("module_local_params"):
            part = modules[name]
            if not isinstance(part, PyroModule):
                return part
        return super().__getattr__(name)
