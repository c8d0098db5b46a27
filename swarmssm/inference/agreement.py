"""Whether model and guide run and fit each other, checked before training."""

import contextlib
import math
import sys
import traceback
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pyro
import torch
from pyro.poutine import Trace

from swarmssm.errors import InputError
from swarmssm.inference.guides import SwarmGuide
from swarmssm.models import SwarmBatch, SwarmModel

__all__ = ["check_agreement", "evaluating"]

PACKAGE = Path(__file__).resolve().parents[1]
#: Folders of code that is not the user's: installed packages, and what is not in a file.
LIBRARIES = ("site-packages", "dist-packages", f"python{sys.version_info[0]}.{sys.version_info[1]}")


@contextlib.contextmanager
def evaluating(*modules: torch.nn.Module) -> Iterator[None]:
    """Keep what watches modules from changing them, as layers of normalisation would be."""
    modes = [(part, part.training) for top in modules for part in top.modules()]
    for top in modules:
        top.eval()
    try:
        yield
    finally:
        for part, mode in modes:
            part.training = mode


def check_agreement(
    model: SwarmModel, guide: SwarmGuide, windows: SwarmBatch, *, scored: bool = True
) -> None:
    """Run the model alone, then the guide, then both, on two windows.

    Random states are left as they were. Of two windows one can tell whether each has its own term
    in the ELBO, as the plate of the windows wants it.

    Parameters
    ----------
    model, guide, windows
        Of a fit.
    scored
        Whether the model scores the guide's draws too, as an ELBO does.

    Raises
    ------
    InputError
        If model or guide fail on the windows, naming the part at fault and, where it is a user's
        code, file and line; if the guide misses a site or draws one that the model does not have,
        or a shape is wrong (naming both).
    """
    rows = torch.arange(2, device=windows.mask.device) % len(windows)
    window = replace(windows.select(rows), population=max(windows.population, 2))
    with (
        torch.random.fork_rng(),
        torch.no_grad(),
        evaluating(model, guide),
        pyro.validation_enabled(True),
    ):
        # Swarms of the prior may diverge beyond all numbers where those of the posterior do not:
        # of the free run only the sites and their shapes are asked.
        with pyro.validation_enabled(False):
            free = _run(model, model, window)
        needed = _latent(free)
        drawn = _run(guide, model, window)
        _check_sites(_latent(drawn), needed)
        both = _run(pyro.poutine.replay(model, trace=drawn), model, window)
        if not scored:
            return
        for what, trace in (("guide", drawn), ("model", both)):
            try:
                trace.compute_log_prob()
                for site in trace.nodes.values():
                    if site["type"] == "sample":
                        pyro.util.check_site_shape(site, math.inf)
            except Exception as error:  # distributions may be the user's own
                raise _refusal(what, "", error, model) from error


def _run(module: Any, model: SwarmModel, window: SwarmBatch) -> Trace:
    """Trace the guide, or the model alone or on draws, on a window."""
    try:
        trace: Trace = pyro.poutine.trace(module).get_trace(window)
    except Exception as error:  # it may be the user's own
        what = "guide" if isinstance(module, SwarmGuide) else "model"
        raise _refusal(what, " it fails on windows of the tracks", error, model) from error
    return trace


def _refusal(what: str, fault: str, error: Exception, model: SwarmModel) -> InputError:
    """Return the error that names the part at fault, and where in a user's code it failed.

    A guide may run the model's transition: what fails there is the model's.
    """
    place = _where(error)
    at = ""
    if place is not None:
        at = f" ({place.file}, line {place.line}, in {place.function})"
        if any(place.owner is part for part in model.modules()):
            what = "model"
    first: BaseException = error
    while first.__cause__ is not None and not isinstance(first, InputError):
        first = first.__cause__
    if isinstance(first, InputError):
        return InputError(f"{_reason(first).rstrip('.')}{at}.")
    return InputError(f"{what}{':' if fault else ''}{fault}{at}: {_reason(error)}")


class _Place(NamedTuple):
    """Where in a user's code something failed."""

    file: str
    line: int
    function: str
    owner: Any


def _where(error: BaseException) -> _Place | None:
    """Return the innermost line of a user's code that an error went through, if there is one.

    That is code outside this package and outside the installed libraries.
    """
    place = owner = None
    for frame, line in traceback.walk_tb(error.__traceback__):
        file = Path(frame.f_code.co_filename)
        if file.is_relative_to(PACKAGE) or any(part in LIBRARIES for part in file.parts):
            continue
        # A function that a method calls is the method's.
        owner = frame.f_locals.get("self", owner)
        place = _Place(file.name, line, frame.f_code.co_name, owner)
    return place


def _reason(error: Exception) -> str:
    """Return the words of an error that say what is wrong, on one line."""
    kind = "" if isinstance(error, ValueError | RuntimeError) else f"{type(error).__name__}: "
    lines: list[str] = []
    for line in map(str.strip, str(error).splitlines()):
        # What Pyro and torch append: a table of all shapes, advice, and whole tensors.
        if line.startswith(("Trace Shapes", "Try one of the following")):
            break
        lines += [line.rstrip(":")] if line else []
        if line.endswith("found invalid values:"):
            break
    words = kind + ": ".join(lines) if lines else type(error).__name__
    return words.rstrip(".") + "."


def _latent(trace: Trace) -> dict[str, Any]:
    """Return the sites of a trace that are drawn, by name."""
    return {
        name: site
        for name, site in trace.nodes.items()
        if site["type"] == "sample"
        and not site["is_observed"]
        and type(site["fn"]).__name__ != "_Subsample"
        and not site["infer"].get("is_auxiliary", False)
    }


def _check_sites(drawn: dict[str, Any], needed: dict[str, Any]) -> None:
    """Refuse sites that are missing, or too many, or of another shape."""
    missing = [name for name in needed if name not in drawn]
    if missing:
        raise InputError(
            f"guide: it does not sample {_and(missing)}, which the model does. Sample it in the "
            "guide's forward, under the same name."
        )
    extra = [name for name in drawn if name not in needed]
    if extra:
        raise InputError(
            f"guide: it samples {_and(extra)}, which the model does not know. The model's sites "
            f"are {_and(list(needed))}."
        )
    for name, site in needed.items():
        theirs, own = tuple(drawn[name]["value"].shape), tuple(site["value"].shape)
        if theirs != own:
            raise InputError(f"guide: it draws {name} of shape {theirs}, and the model's is {own}.")


def _and(names: list[str]) -> str:
    """Join names for a sentence."""
    return ", ".join(repr(name) for name in names)
