"""``check``: whether swarms simulated from a fitted model match the recording."""

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swarmssm.cli.console import print_json, print_rows, say, short
from swarmssm.cli.options import File, Format, Overwrite, Run, Seed, TableFormat, TrustCode
from swarmssm.cli.progress import counting_progress
from swarmssm.errors import InputError
from swarmssm.files import check_output, write_beside

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["check"]

PICTURES = (".png", ".pdf", ".svg")


def check(
    run: Run,
    file: File,
    out: Annotated[Path, typer.Option(help="NetCDF file to write.")],
    statistics: Annotated[
        str | None,
        typer.Option(
            help="Statistics separated by commas, built-in or "
            "module:function. Default: all built-in."
        ),
    ] = None,
    draws: Annotated[
        int, typer.Option(help="Replicates; no p-value is below 1 / (draws + 1).")
    ] = 100,
    steps: Annotated[
        int | None, typer.Option(help="Frames of a run. Default: a whole trial, at most 200.")
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(
            help="train, validation, test (of the run's own file) or all. Default: test; all of "
            "another file."
        ),
    ] = None,
    every: Annotated[int, typer.Option(help="Use every n-th frame.")] = 1,
    walls: Annotated[
        str | None,
        typer.Option(
            help="hull (of all positions) or none. Default: those of the file, else where the "
            "wall force of the model begins."
        ),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Figure of all statistics in one (png, pdf, svg).")
    ] = None,
    sheet: Annotated[
        Path | None, typer.Option(help="Figure with a panel for each statistic.")
    ] = None,
    seed: Seed = 0,
    format: Format = TableFormat.text,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Posterior predictive check: compare swarms simulated from the fit with the recording."""
    from swarmssm import inference, io
    from swarmssm.analysis.diagnostics.checks import STATISTICS, Statistic
    from swarmssm.analysis.diagnostics.checks import check as compare
    from swarmssm.analysis.plots.checks import plot_check_overview, plot_statistics
    from swarmssm.models.registry import find_part

    pictures = [path for path in (figure, sheet) if path is not None]
    for path in (out, *pictures):
        check_output(path, overwrite=overwrite)
    for picture in pictures:
        _check_picture(picture)
    chosen = None
    if statistics is not None:
        chosen = []
        for name in (piece.strip() for piece in statistics.split(",")):
            found = find_part(name, STATISTICS, "statistics")
            own = name.rpartition(":")[2]
            if not isinstance(found, Statistic):
                found = Statistic(own, own.replace("_", " "), found)
            chosen.append(found)
    fitted = inference.Fit.load(run, trust_code=trust_code)
    tracks = io.read(file)
    with counting_progress("simulating", "swarms") as show:
        checked = compare(
            fitted,
            tracks,
            draws=draws,
            statistics=chosen,
            steps=steps,
            part=part,
            seed=seed,
            progress=show,
            walls=walls,
            every=every,
        )
    io.write_dataset(checked.data, out, overwrite=overwrite)
    if figure is not None:
        _save(plot_check_overview(checked.data)[0], figure, overwrite=overwrite)
    if sheet is not None:
        _save(plot_statistics(checked.data)[0], sheet, overwrite=overwrite)
    attrs = checked.data.attrs
    rows = checked.summary().reset_index().to_dict("records")
    notes = attrs["notes"].splitlines()
    if format is TableFormat.json:
        settings = {name: value for name, value in attrs.items() if name != "notes"}
        print_json(
            {
                "verdict": checked.verdict(),
                "statistics": rows,
                "notes": notes,
                "settings": settings,
            }
        )
        return
    say(checked.verdict())
    print_rows(
        f"{run} on {file}",
        [
            {
                "statistic": row["statistic"],
                "verdict": row["verdict"],
                "observed": row["observed"],
                "90 % of replicates": _interval(row),
                "p": row["p_value"],
                "p, adjusted": row["p_adjusted"],
            }
            for row in rows
        ],
    )
    for line in (*notes, *(f"{path}: written." for path in (out, *pictures))):
        say(line)


def _interval(row: Mapping[Hashable, Any]) -> str:
    """Return the interval of the replicates with its unit; empty for curves and histograms."""
    from swarmssm.analysis.scoring.table import format_unit

    if math.isnan(row["low"]):
        return ""
    unit = format_unit(str(row["unit"]))
    return f"{short(row['low'])} to {short(row['high'])} {unit}".rstrip()


def _check_picture(path: Path) -> None:
    """Check the format of a figure before the work is done."""
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"{path}: a figure must end in {', '.join(PICTURES)}.")


def _save(drawn: "Figure", path: Path, *, overwrite: bool) -> None:
    with write_beside(path, overwrite=overwrite) as temporary:
        drawn.savefig(temporary, format=path.suffix[1:].lower(), dpi=150)
