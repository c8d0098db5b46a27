"""Whether a guide draws what its model needs, said before training and in plain words."""

import contextlib
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pyro
import torch
from pyro.poutine import Trace

from swarmssm.errors import InputError
from swarmssm.inference.guides import SwarmGuide
from swarmssm.models import SwarmBatch, SwarmModel

__all__ = ["check_agreement", "evaluating"]


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
    """Run model and guide once, with all arguments checked, on two windows.

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
        If the guide misses a site or draws one that the model does not have, a shape is wrong
        (naming both), or model or guide fail on the windows.
    """
    rows = torch.arange(2, device=windows.mask.device) % len(windows)
    window = replace(windows.select(rows), population=max(windows.population, 2))
    with (
        torch.random.fork_rng(),
        torch.no_grad(),
        evaluating(model, guide),
        pyro.validation_enabled(True),
    ):
        drawn = _run("guide", guide, window)
        # Swarms of the prior may fly apart beyond all numbers where those of the posterior do not:
        # of the free run only the sites and their shapes are asked.
        with pyro.validation_enabled(False):
            free = _run("model", model, window)
        needed = _latent(free)
        _check_sites(_latent(drawn), needed)
        both = _run("model", pyro.poutine.replay(model, trace=drawn), window)
        if not scored:
            return
        for what, trace in (("guide", drawn), ("model", both)):
            try:
                trace.compute_log_prob()
                for site in trace.nodes.values():
                    if site["type"] == "sample":
                        pyro.util.check_site_shape(site, math.inf)
            except Exception as error:  # distributions may be the user's own
                raise InputError(f"{what}: {_reason(error)}") from error


def _run(what: str, module: Any, window: SwarmBatch) -> Trace:
    """Trace a module on a window."""
    try:
        trace: Trace = pyro.poutine.trace(module).get_trace(window)
    except InputError as error:
        raise InputError(_reason(error)) from error
    except Exception as error:  # it may be the user's own
        raise InputError(f"{what}: it fails on windows of the tracks: {_reason(error)}") from error
    return trace


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
