"""Names of the models of this package, and a user's own by ``module:attribute``."""

import contextlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from swarmssm.errors import InputError
from swarmssm.models.base import SwarmModel
from swarmssm.models.graph_vae import GraphVAE
from swarmssm.models.presets import boids, graph_ssm, kernel, linear

__all__ = ["MODELS", "Entry", "find_builder", "find_model", "find_part", "options_of"]


@dataclass(frozen=True)
class Entry:
    """A registered model or guide.

    Attributes
    ----------
    build
        The function or class that builds it.
    title
        What papers call it, in a few words.
    description
        What it is, in one or two sentences.
    """

    build: Callable[..., Any]
    title: str
    description: str


MODELS: dict[str, Entry] = {
    "boids": Entry(
        boids,
        "boids with inferred gains",
        "A state-space model of positions and velocities. Each individual is pulled towards those "
        "it sees (cohesion), pushed from them (separation), and turned to their velocities "
        "(alignment), with gains that are inferred, besides walls, speed regulation and noise.",
    ),
    "graph-ssm": Entry(
        graph_ssm,
        "graph state-space model",
        "A state-space model of positions and velocities, whose accelerations a graph network "
        "makes of what each individual sees of the others, alike under rotation, reflection and "
        "translation unless place matters.",
    ),
    "graph-vae": Entry(
        GraphVAE,
        "graph variational autoencoder of the thesis",
        "The thesis's graph variational autoencoder: a latent state for each individual and frame, "
        "drawn from N(0, I), is decoded into its next state, and each pair's into their next edge. "
        "Nothing links one frame's latent states to the next.",
    ),
    "kernel": Entry(
        kernel,
        "interaction kernels of distance",
        "A state-space model of positions and velocities. What a neighbour does to an individual "
        "is a smooth curve of its distance, one for the pull or push and one for alignment, "
        "besides walls, speed regulation and noise.",
    ),
    "linear": Entry(
        linear,
        "linear forces, solved exactly",
        "A state-space model whose next state is a linear function of the present one, plus "
        "noise: what a Kalman filter solves exactly.",
    ),
}


def find_model(model: str | Callable[..., Any]) -> Callable[..., SwarmModel]:
    """Return the function of scales and options that builds a model.

    Parameters
    ----------
    model
        A key of :data:`MODELS`, ``module:attribute``, or the function itself; a class with a
        method ``for_scales`` is built by this method.

    Raises
    ------
    InputError
        As :func:`find_part`.
    """
    return find_builder(model, MODELS, "model", "for_scales")


def find_builder(
    part: str | Callable[..., Any], registered: Mapping[str, Entry], what: str, method: str
) -> Callable[..., Any]:
    """Return what builds a part: what a name stands for, or a method of it if there is one."""
    found: Any = part
    if isinstance(part, str):
        builders = {name: entry.build for name, entry in registered.items()}
        found = find_part(part, builders, what)
    builder: Callable[..., Any] = getattr(found, method, found)
    return builder


def options_of(builder: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the options of a builder by name, without the scales or the model that come first.

    A class method that hands its options on, ``for_scales(cls, scales, **options)``, has those of
    the constructor.
    """
    found = list(inspect.signature(builder).parameters.values())
    named = found[1:]
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in named):
        owner = getattr(builder, "__self__", None)
        if inspect.isclass(owner):
            named += list(inspect.signature(owner).parameters.values())[1:]
    kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return {one.name: one for one in named if one.kind not in kinds}


def find_part(name: str, registered: Mapping[str, Any], what: str) -> Any:
    """Return a registered part, or import the user's own.

    Parameters
    ----------
    name
        A key of ``registered``, or ``module:attribute``. The module is looked for in the current
        folder first, as a file ``module.py``, then among the installed ones, and last as a
        package in the current folder; it may import its neighbours. Importing it runs its code.
    registered
        The parts of this package.
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
