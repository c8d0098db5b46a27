"""Options that several subcommands have, and how pairs of ``NAME=VALUE`` are read."""

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from swarmssm.errors import InputError

__all__ = [
    "ConstructorOptions",
    "File",
    "FitSettings",
    "Format",
    "Overwrite",
    "Priors",
    "Run",
    "Seed",
    "TableFormat",
    "TrustCode",
    "fit_settings",
    "named_texts",
    "named_values",
]


class TableFormat(StrEnum):
    """How a table is printed."""

    text = "text"
    json = "json"


Run = Annotated[Path, typer.Argument(help="Run folder, as fit writes it.")]
File = Annotated[Path, typer.Argument(help="Tracks: NetCDF, or any file import can read.")]
Format = Annotated[TableFormat, typer.Option("--format", help="Print text or JSON.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Seed = Annotated[int, typer.Option(help="Seed of all random draws.", min=0)]
TrustCode = Annotated[
    bool,
    typer.Option("--trust-code", help="Let a run import the module:attribute that it names."),
]
Priors = Annotated[
    list[str] | None,
    typer.Option(
        "--prior",
        metavar="NAME=DIST(ARGS)",
        help="Prior of a named parameter, for instance cohesion_gain=LogNormal(-1,0.5), or the "
        "number at which to hold it; repeatable.",
    ),
]
ConstructorOptions = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=VALUE", help="An argument of its constructor; repeatable."),
]
FitSettings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Any other setting of a fit, for instance --set gap=10; repeatable.",
    ),
]


def fit_settings(
    priors: Sequence[str] | None,
    model_options: Sequence[str] | None,
    guide_options: Sequence[str] | None,
    settings: Sequence[str] | None,
    edge_options: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Read the options with pairs that say how to fit, as settings of a fit.

    Raises
    ------
    InputError
        As :func:`named_texts`.
    """
    return {
        "model_options": named_values(model_options or [], "--model-option"),
        "guide_options": named_values(guide_options or [], "--guide-option"),
        "edge_options": named_values(edge_options or [], "--edge-option"),
        "priors": named_texts(priors or [], "--prior"),
        **named_values(settings or [], "--set"),
    }


def named_values(pairs: Sequence[str], option: str) -> dict[str, Any]:
    """Read ``name=value`` pairs; a value is a number, JSON, or else text.

    Raises
    ------
    InputError
        If one has no ``=``, or a name stands twice.
    """
    values: dict[str, Any] = {}
    for name, text in named_texts(pairs, option).items():
        try:
            values[name] = json.loads(text)
        except ValueError:
            values[name] = text
    return values


def named_texts(pairs: Sequence[str], option: str) -> dict[str, str]:
    """Read ``name=text`` pairs as they are.

    Raises
    ------
    InputError
        If one has no ``=``, or a name stands twice.
    """
    texts: dict[str, str] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise InputError(f"{option}: {pair!r} is not of the form name=value.")
        if name in texts:
            raise InputError(f"{option}: {name} stands there twice.")
        texts[name] = text.strip()
    return texts
