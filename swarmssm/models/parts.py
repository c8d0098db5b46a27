"""The base of the parts of models and of guides."""

import contextlib
from collections.abc import Iterator
from typing import Any

import pyro
from pyro.nn import PyroModule
from torch import nn

__all__ = ["LocalPyroModule", "own_parameters"]


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
        context = getattr(module, "_pyro_context", None)
        if context is not None and not hasattr(context, "param_state"):
            # As Pyro makes it where a module is born under the setting.
            context.param_state = {"params": {}, "constraints": {}}
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
