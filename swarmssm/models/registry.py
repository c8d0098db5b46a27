"""Names of the ready-made parts, and the user's own by ``module:attribute``."""

import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from swarmssm.errors import InputError
from swarmssm.models.base import SwarmModel
from swarmssm.models.graph_vae import GraphVAE
from swarmssm.models.presets import boids, graph_ssm, kernel, linear

__all__ = ["MODELS", "find_model", "find_part"]

MODELS: dict[str, Callable[..., SwarmModel]] = {
    "boids": boids,
    "graph-ssm": graph_ssm,
    "graph-vae": GraphVAE,
    "kernel": kernel,
    "linear": linear,
}


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
        folder first, as a file ``module.py``, then among the installed ones, and last as a
        package in the current folder; it may import its neighbours. Importing it runs its code.
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


def _import(name: str, what: str) -> ModuleType:
    """Import a module from the current folder or the installed ones."""
    path = Path.cwd() / f"{name.removesuffix('.py')}.py"
    try:
        with _current_folder_last():
            return _import_file(path) if path.is_file() else importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != name.split(".")[0]:
            raise InputError(f"{what}: importing {name} failed: {error}.") from error
        raise InputError(
            f"{what}: there is no module {name}, neither as {path.name} in the current folder nor "
            "installed."
        ) from error
    # A script that was not meant to be imported may leave by sys.exit.
    except (Exception, SystemExit) as error:
        raise InputError(
            f"{what}: importing {name} failed: {type(error).__name__}: {error}."
        ) from error


def _import_file(path: Path) -> ModuleType:
    """Import a file once, whatever other module bears its name."""
    for name in (path.stem, str(path)):
        loaded = sys.modules.get(name)
        if loaded is None:
            break
        if getattr(loaded, "__file__", None) == str(path):
            return loaded
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextlib.contextmanager
def _current_folder_last() -> Iterator[None]:
    """Let an imported file import its neighbours, but hide nothing that is installed."""
    folder = str(Path.cwd())
    sys.path.append(folder)
    importlib.invalidate_caches()
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):
            sys.path.reverse()
            sys.path.remove(folder)
        sys.path.reverse()
