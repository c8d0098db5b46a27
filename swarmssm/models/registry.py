"""Names of the ready-made parts, and the user's own by ``module:attribute``."""

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from swarmssm.errors import InputError
from swarmssm.models.base import SwarmModel
from swarmssm.models.graph_vae import GraphVAE

__all__ = ["MODELS", "find_model", "find_part"]

MODELS: dict[str, Callable[..., SwarmModel]] = {"graph-vae": GraphVAE}


def find_model(name: str) -> Callable[..., SwarmModel]:
    """Return the class or function that builds a model, by name or ``module:attribute``."""
    builder: Callable[..., SwarmModel] = find_part(name, MODELS, "model")
    return builder


def find_part(name: str, registered: Mapping[str, Any], what: str) -> Any:
    """Return a registered part, or import the user's own.

    Parameters
    ----------
    name
        A key of ``registered``, or ``module:attribute``. The module is looked for in the current
        folder first, as a file ``module.py``, then among the installed ones. Importing it runs
        its code.
    registered
        The ready-made parts.
    what
        What to call it in an error: ``"model"`` or ``"guide"``.

    Raises
    ------
    InputError
        If there is no such name, module or attribute, or importing the module fails.
    """
    if name in registered:
        return registered[name]
    module_name, colon, attribute = name.partition(":")
    if not colon or not attribute or not module_name:
        raise InputError(
            f"{what}: {name!r} is unknown. Choose one of {', '.join(sorted(registered))}, "
            "or name your own as module:attribute."
        )
    module = _import(module_name, what)
    if not callable(getattr(module, attribute, None)):
        raise InputError(f"{what}: the module {module_name} has no class or function {attribute}.")
    return getattr(module, attribute)


def _import(name: str, what: str) -> Any:
    """Import a module from the current folder or the installed ones."""
    if name in sys.modules:
        return sys.modules[name]
    path = Path.cwd() / f"{name.removesuffix('.py')}.py"
    try:
        if not path.is_file():
            return importlib.import_module(name)
        spec = importlib.util.spec_from_file_location(path.stem, path)
        if spec is None or spec.loader is None:
            raise ImportError(f"{path} cannot be imported")
        module = importlib.util.module_from_spec(spec)
        sys.modules[path.stem] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[path.stem]
            raise
        return module
    except ModuleNotFoundError as error:
        if error.name != name.split(".")[0]:
            raise InputError(f"{what}: importing {name} failed: {error}.") from error
        raise InputError(
            f"{what}: there is no module {name}, neither as {path.name} in the current folder nor "
            "installed."
        ) from error
    except Exception as error:
        raise InputError(
            f"{what}: importing {name} failed: {type(error).__name__}: {error}."
        ) from error
