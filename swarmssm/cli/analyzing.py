"""``analyze``: what a fitted run says of forces, rules, latents and influence, and how surely."""

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from swarmssm.cli.comparing import Against, load_other_runs
from swarmssm.cli.console import print_json, print_rows, say
from swarmssm.cli.options import (
    File,
    Format,
    Overwrite,
    Run,
    Seed,
    TableFormat,
    TrustCode,
    named_values,
)
from swarmssm.cli.progress import stages
from swarmssm.errors import InputError
from swarmssm.files import check_output, write_beside

__all__ = ["analyze"]


class FigureFormat(StrEnum):
    """Formats of figures for a paper."""

    pdf = "pdf"
    svg = "svg"
    png = "png"


def analyze(
    run: Run,
    file: File,
    out: Annotated[Path, typer.Option(help="NetCDF file to write, a group for each analysis.")],
    report: Annotated[
        Path | None, typer.Option(help="HTML page to write. Default: as OUT, ending in .html.")
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the figures, a csv file of each table, and a Methods paragraph.",
        ),
    ] = None,
    figure_format: Annotated[
        FigureFormat, typer.Option(help="Of the figures in DIR.")
    ] = FigureFormat.pdf,
    width: Annotated[
        str | None, typer.Option(help="Width of the figures in DIR, such as 85mm.")
    ] = None,
    draws: Annotated[int, typer.Option(help="Draws of paths from the posterior.")] = 20,
    part: Annotated[
        str | None,
        typer.Option(
            help="train, validation, test (of the run's own file) or all. Default: frames of the "
            "run's own file that were held out, all of another file."
        ),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            help="Some of forces,kernels,force_maps,latents,influence,delays, with commas."
        ),
    ] = None,
    against: Against = None,
    scores: Annotated[
        bool,
        typer.Option(
            "--scores/--no-scores",
            help="Score forecasts of held-out frames against simple baselines.",
        ),
    ] = True,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="ANALYSIS.OPTION=VALUE, such as force_maps.bins=21. Repeat."),
    ] = None,
    seed: Seed = 0,
    format: Format = TableFormat.text,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Say which forces act, by which rule, what the latents carry, who moves whom; how surely."""
    from swarmssm import inference, io
    from swarmssm.analysis.interpretation.analyze import TITLES
    from swarmssm.analysis.interpretation.analyze import analyze as all_analyses
    from swarmssm.analysis.interpretation.summary import formatted_summary
    from swarmssm.analysis.plots.style import millimetres
    from swarmssm.analysis.report import analysis_page
    from swarmssm.analysis.report.figures import check_folder, write_analysis_files

    page = out.with_suffix(".html") if report is None else report
    check_output(out, overwrite=overwrite)
    check_output(page, overwrite=overwrite)
    if page.resolve() == out.resolve():
        raise InputError(f"{out}: data and report cannot be one file. Name another with --report.")
    if figures is None and width is not None:
        raise InputError("--width: it is that of the figures in a folder. Name one with --figures.")
    if width is not None:
        millimetres(width)
    if figures is not None:
        check_folder(figures, overwrite=overwrite)
    options = _options(settings or [])
    chosen = None if only is None else [name.strip() for name in only.split(",")]
    fitted = inference.Fit.load(run, trust_code=trust_code)
    others = load_other_runs(against, fitted, trust_code)
    tracks = io.read(file)
    with stages() as show:
        found = all_analyses(
            fitted,
            tracks,
            draws=draws,
            part=part,
            seed=seed,
            only=chosen,
            against=others,
            scores=scores,
            options=options,
            progress=lambda name: show(f"analysing {TITLES[name]}"),
        )
    # Both or neither: data without the page would stand in the way of the next call.
    with write_beside(out, overwrite=overwrite) as temporary:
        found.write(temporary, overwrite=True)
        analysis_page(found, fitted, tracks).write(page, overwrite=overwrite)
    if figures is not None:
        write_analysis_files(
            found,
            fitted,
            tracks,
            figures,
            format=figure_format.value,
            width=width,
            overwrite=overwrite,
        )
    if format is TableFormat.json:
        print_json(
            {
                "verdict": found.verdict(),
                "settings": found.settings,
                "summary": found.summary().reset_index().to_dict("records"),
                "notes": list(found.notes),
            }
        )
        return
    say(found.verdict())
    print_rows(f"{run} on {file}", formatted_summary(found.datasets))
    for note in found.notes:
        say(note)
    if figures is not None:
        say(f"{figures}: written, with figures, tables and methods.md.")
    say(f"{out}: written. {page}: written; open it in a browser.")


def _options(pairs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Read options of analyses."""
    options: dict[str, dict[str, Any]] = {}
    for name, value in named_values(pairs, "--set").items():
        which, point, option = name.partition(".")
        if not point or not which or not option:
            raise InputError(f"--set: {name!r} is not of the form ANALYSIS.OPTION=VALUE.")
        options.setdefault(which, {})[option] = value
    return options
