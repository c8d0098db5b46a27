"""``swarmssm models``: which models and guides there are, and what their options and priors are."""

from pathlib import Path
from typing import Annotated

import typer

from swarmssm.cli.console import print_table, say

__all__ = ["models"]


def models(
    name: Annotated[
        str | None,
        typer.Argument(help="A model, a guide, or your own module:attribute. Default: all."),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "--for",
            metavar="FILE",
            help="Tracks in whose units priors are written. Default: units in which the swarm's "
            "typical length, speed and spacing are 1.",
        ),
    ] = None,
) -> None:
    """List models and guides, or the options and priors of one."""
    from swarmssm.inference.guides import GUIDES, describe_guide
    from swarmssm.models import MODELS, describe_model

    if name is None:
        for title, entries in (("model", MODELS), ("guide", GUIDES)):
            print_table("", (title, "what it is"), [(n, e.title) for n, e in entries.items()])
        say("Of one of them: swarmssm models NAME. The default model is boids.")
        return
    scales = None
    if file is not None:
        from swarmssm import io
        from swarmssm.inference.data import rule_for
        from swarmssm.models import scales_of

        tracks = io.read(file)
        scales = scales_of(tracks, rule_for(tracks, "auto"))
    found = describe_guide(name) if name in GUIDES else describe_model(name, scales)
    say(f"{found.name}: {found.title}. {found.description}")
    kind = "guide-option" if name in GUIDES else "model-option"
    options = found.options.reset_index().to_numpy().tolist()
    print_table("", (f"--{kind}", "default", "values", "what it is"), options)
    if len(found.priors):
        columns = [found.priors.index.name or "parameter", *found.priors.columns]
        print_table("", columns, found.priors.reset_index().to_numpy().tolist())
