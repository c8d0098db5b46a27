"""``check``: whether a fitted model makes swarms like the one that was seen."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swarmssm.cli.console import print_json, print_rows, say
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
            help="Some of the statistics, with commas, or module:function of your own. "
            "Default: all."
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
    every: Annotated[int, typer.Option(help="Look at every so many frames alone.")] = 1,
    walls: Annotated[
        str | None,
        typer.Option(help="hull: of all positions; none. Default: the file's, else the model's."),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Picture of all statistics in one (png, pdf, svg).")
    ] = None,
    sheet: Annotated[
        Path | None, typer.Option(help="Picture of each statistic beside its replicates.")
    ] = None,
    seed: Seed = 0,
    format: Format = TableFormat.text,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Simulate whole swarms from the fitted model, and compare them with the recording."""
    from swarmssm import inference, io
    from swarmssm.analysis.diagnostics.checks import STATISTICS, Statistic, sentence
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
    io.write_dataset(checked, out, overwrite=overwrite)
    if figure is not None:
        _save(plot_check_overview(checked)[0], figure, overwrite=overwrite)
    if sheet is not None:
        _save(plot_statistics(checked)[0], sheet, overwrite=overwrite)
    rows = [
        {
            "statistic": name,
            "p": float(checked["p_value"].sel(statistic=name)),
            "p, corrected": float(checked["p_adjusted"].sel(statistic=name)),
            "verdict": checked["verdict"].sel(statistic=name).item(),
        }
        for name in map(str, checked["statistic"].values)
    ]
    if format is TableFormat.json:
        words = map(str, checked["words"].values)
        print_json(
            {
                "statistics": [
                    row | {"words": said} for row, said in zip(rows, words, strict=True)
                ],
                "sentence": sentence(checked),
                "notes": checked.attrs["notes"].splitlines(),
                "settings": {k: v for k, v in checked.attrs.items() if k != "notes"},
            }
        )
        return
    print_rows(f"{run} on {file}", rows)
    say(sentence(checked))
    for note in checked.attrs["notes"].splitlines():
        say(note)
    for path in (out, *pictures):
        say(f"{path}: written.")


def _check_picture(path: Path) -> None:
    """Refuse a picture of a kind that cannot be drawn, before the work is done."""
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"{path}: a picture must end in {', '.join(PICTURES)}.")


def _save(drawn: "Figure", path: Path, *, overwrite: bool) -> None:
    with write_beside(path, overwrite=overwrite) as temporary:
        drawn.savefig(temporary, format=path.suffix[1:].lower(), dpi=150)
