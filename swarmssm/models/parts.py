"""The base of the parts of models and of guides."""

from typing import Any

import pyro
from pyro.nn import PyroModule

__all__ = ["Part"]


class Part(PyroModule):  # type: ignore[misc]
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
