"""What a model or guide is: its description, its options, and its default priors."""

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from swarmssm.errors import InputError
from swarmssm.models.base import SwarmModel
from swarmssm.models.priors import prior_texts
from swarmssm.models.registry import MODELS, Entry, find_model, options_of
from swarmssm.models.scales import Scales

__all__ = ["PartDescription", "describe_model", "describe_part"]

#: Scales of a swarm whose typical length, speed and spacing are 1.
UNIT = Scales(
    space=2,
    individuals=10,
    dt=0.1,
    centre=(0.0, 0.0),
    low=(-2.0, -2.0),
    high=(2.0, 2.0),
    length=1.0,
    speed=1.0,
    slow=0.3,
    fast=2.0,
    spacing=1.0,
    step=0.1,
    noise=0.0,
    apart=3.0,
)


@dataclass(frozen=True)
class PartDescription:
    """What a model or guide is.

    Attributes
    ----------
    name, title, description
        As in its :class:`~swarmssm.models.registry.Entry`; of a user's own, from its docstring.
    options
        Index ``option``; columns ``default``, ``values`` and ``description``, all text.
    priors
        Index ``parameter``; column ``prior``: the default prior as ``--prior`` reads it. Empty for
        a guide and for a model without priors.
    """

    name: str
    title: str
    description: str
    options: pd.DataFrame
    priors: pd.DataFrame


def describe_model(
    model: str | Callable[..., Any], scales: Scales | None = None
) -> PartDescription:
    """Return what a model is, with its options and default priors.

    Parameters
    ----------
    model
        A key of :data:`~swarmssm.models.MODELS`, ``module:attribute``, or a builder.
    scales
        Of the tracks in whose units priors are; absent, those of a swarm in the plane whose typical
        length, speed and spacing are 1.

    Raises
    ------
    InputError
        If there is no such model, or it cannot be built without options.
    """
    builder = find_model(model)
    try:
        built: SwarmModel = builder(UNIT if scales is None else scales)
    except InputError:
        raise
    except Exception as error:  # the builder may be the user's own
        raise InputError(
            f"model: {_name(model)} cannot be built without options "
            f"({type(error).__name__}: {error})."
        ) from error
    return describe_part(model, MODELS, builder, prior_texts(built))


def describe_part(
    part: str | Callable[..., Any],
    registered: Mapping[str, Entry],
    builder: Callable[..., Any],
    priors: Mapping[str, str] | None = None,
) -> PartDescription:
    """Return what a part is.

    Parameters
    ----------
    part
        Its name, or what builds it.
    registered
        Parts of this package, which have a title.
    builder
        What its name stands for.
    priors
        Default priors as text, by full name.
    """
    name = _name(part)
    owner = getattr(builder, "__self__", builder)
    documented = inspect.getdoc(owner) or ""
    first = " ".join(documented.split("\n\n")[0].split())
    entry = registered.get(name, Entry(builder, name, _plain(first)))
    documents: dict[str, str] = {}
    # A class may leave to a base what options mean that it takes over.
    for one in (*reversed(inspect.getmro(owner) if inspect.isclass(owner) else ()), builder):
        documents |= _documented(inspect.cleandoc(one.__doc__ or ""))
    rows = {
        option: {
            "default": "required" if one.default is one.empty else _value(one.default),
            "values": _kind(one.annotation),
            "description": documents.get(option, ""),
        }
        for option, one in options_of(builder).items()
    }
    options = pd.DataFrame.from_dict(
        rows, orient="index", columns=["default", "values", "description"]
    )
    table = pd.DataFrame({"prior": dict(priors or {})}, dtype=object)
    return PartDescription(
        name,
        entry.title,
        entry.description,
        options.rename_axis("option"),
        table.rename_axis("parameter"),
    )


def _name(part: str | Callable[..., Any]) -> str:
    """Return the name of a part."""
    return part if isinstance(part, str) else str(getattr(part, "__qualname__", part))


def _value(default: Any) -> str:
    """Write a default value as an option is given."""
    if default is None:
        return "none"
    return str(default).lower() if isinstance(default, bool) else str(default)


def _kind(annotation: Any) -> str:
    """Write which values an option takes."""
    if annotation is inspect.Parameter.empty or annotation is Any:
        return ""
    text = annotation.__name__ if inspect.isclass(annotation) else str(annotation)
    text = re.sub(r"Literal\[(.*?)\]", lambda found: found[1].replace(", ", " | "), text)
    text = re.sub(r"\b(?:typing|collections\.abc)\.", "", text).replace("'", "")
    return text.replace("bool", "true | false").replace("NoneType", "none").replace("None", "none")


def _documented(text: str) -> dict[str, str]:
    """Return the descriptions of parameters in a numpydoc docstring, by name."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w+\n-+\n|\Z)", text, re.M | re.S)
    if section is None:
        return {}
    found: dict[str, str] = {}
    names: list[str] = []
    for line in section[1].splitlines():
        if line and not line.startswith(" "):
            names = [name.strip(" *") for name in line.split(",")]
            if not all(name.isidentifier() for name in names):
                break
        elif line.strip():
            for name in names:
                found[name] = f"{found.get(name, '')} {line.strip()}".strip()
    return {name: _plain(words) for name, words in found.items()}


def _plain(text: str) -> str:
    """Return a docstring's sentence without its markup."""
    text = re.sub(r":\w+:`~[\w.]*?\.?(\w+)`", r"\1", text)
    text = re.sub(r":\w+:`([^`]*)`", r"\1", text)
    return text.replace("``", "")
