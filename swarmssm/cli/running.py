"""``evaluate``, ``forecast`` and ``rollout``: what a fitted run predicts, and how well."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swarmssm.cli.comparing import Horizons, parse_horizons
from swarmssm.cli.console import print_all_scores, print_evaluation, print_json, say, write_json
from swarmssm.cli.options import File, Format, Overwrite, Run, Seed, TableFormat, TrustCode
from swarmssm.errors import InputError
from swarmssm.files import check_output

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["evaluate", "forecast", "rollout"]

Edges = Annotated[
    str,
    typer.Option(
        help="Graphs of later steps: decoder (the model's own) or rule (from predicted states)."
    ),
]
Until = Annotated[
    float | None,
    typer.Option(help="Seconds: use what lies before this time. Default: all of the tracks."),
]


def evaluate(
    run: Run,
    file: File,
    horizons: Horizons = None,
    part: Annotated[
        str | None,
        typer.Option(
            help="train, validation, test or all. Default: the test part of the run's own file, "
            "and all of another."
        ),
    ] = None,
    all_scores: Annotated[
        bool,
        typer.Option(
            "--all-scores",
            help="Print every score at every horizon, the graph's, and the thesis's tables.",
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="JSON file to write.")] = None,
    format: Format = TableFormat.text,
    seed: Seed = 0,
    edges: Edges = "decoder",
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Compare the forecasts of a run with simple baselines, on tracks it has not seen."""
    from swarmssm import analysis, inference, io

    if out is not None:
        check_output(out, overwrite=overwrite)
    options = parse_horizons(horizons)
    fitted = inference.Fit.load(run, trust_code=trust_code)
    tracks = io.read(file)
    result = analysis.evaluate(fitted, tracks, part=part, seed=seed, edges=edges, **options)
    if out is not None:
        write_json(result.to_dict(), out, overwrite=overwrite)
    if format is TableFormat.json:
        print_json(result.to_dict())
        return
    print_evaluation(str(run), result)
    if all_scores:
        print_all_scores(result, "auto")
    if out is not None:
        say(f"{out}: written.")


def forecast(
    run: Run,
    file: File,
    out: Annotated[Path, typer.Option(help="NetCDF file to write.")],
    horizon: Annotated[int, typer.Option(help="Steps ahead.")] = 50,
    draws: Annotated[int, typer.Option(help="Sampled futures; 0 for the mean path.")] = 100,
    until: Until = None,
    seed: Seed = 0,
    edges: Edges = "decoder",
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Draw what may come after the tracks (or after --until), from the past only."""
    from swarmssm import inference, io

    check_output(out, overwrite=overwrite)
    fitted = inference.Fit.load(run, trust_code=trust_code)
    history = _before(io.read(file), until)
    result = fitted.forecast(history, horizon, draws, seed, edges)
    io.write_dataset(result, out, overwrite=overwrite)
    say(f"{out}: {max(draws, 1)} futures of {horizon} steps.")


def rollout(
    run: Run,
    file: File,
    out: Annotated[Path, typer.Option(help="NetCDF file of tracks to write.")],
    steps: Annotated[int, typer.Option(help="Steps of the free run.")] = 1000,
    draws: Annotated[int, typer.Option(help="Runs from each start; 0 for one without noise.")] = 1,
    until: Annotated[
        float | None,
        typer.Option(help="Seconds: start from the last frame before. Default: the last frame."),
    ] = None,
    seed: Seed = 0,
    edges: Edges = "decoder",
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Let the learned rule run freely from a frame of the tracks; the result is tracks."""
    from swarmssm import inference, io

    check_output(out, overwrite=overwrite)
    fitted = inference.Fit.load(run, trust_code=trust_code)
    initial = _before(io.read(file), until)
    result = fitted.rollout(initial, steps, draws, seed, edges)
    io.write(result, out, overwrite=overwrite)
    say(f"{out}: {result.sizes['trial']} free runs of {steps} steps.")


def _before(tracks: "xr.Dataset", until: float | None) -> "xr.Dataset":
    """Return the tracks up to a time."""
    if until is None:
        return tracks
    keep = tracks["time"].to_numpy() <= until
    if keep.sum() < 2:
        first = float(tracks["time"].values[0])
        last = float(tracks["time"].values[-1])
        raise InputError(
            f"--until: fewer than two frames lie before {until:g} s; the tracks run from "
            f"{first:g} s to {last:g} s."
        )
    return tracks.isel(time=keep)
