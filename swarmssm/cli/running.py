"""``evaluate``, ``forecast``, ``rollout`` and ``report``: what a fitted run is used for."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swarmssm.cli.comparing import Against, Horizons, load_other_runs, parse_horizons
from swarmssm.cli.console import print_all_scores, print_evaluation, print_json, say, write_json
from swarmssm.cli.options import File, Format, Overwrite, Run, Seed, TableFormat, TrustCode
from swarmssm.cli.progress import stages
from swarmssm.errors import InputError
from swarmssm.files import check_output

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["evaluate", "forecast", "report", "rollout"]

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


def report(
    run: Run,
    out: Annotated[Path, typer.Option(help="HTML file to write.")],
    data: Annotated[
        Path | None, typer.Option(help="The tracks of the fit. Default: the file it was fitted on.")
    ] = None,
    against: Against = None,
    checks: Annotated[
        int,
        typer.Option(
            help="Swarms to simulate from the model and compare with the recording; 0 for none."
        ),
    ] = 100,
    forces: Annotated[bool, typer.Option(help="Say which forces act, and by which rule.")] = True,
    player: Annotated[
        bool, typer.Option(help="Let recording and a free run be played side by side.")
    ] = True,
    seed: Seed = 0,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Write one self-contained HTML page: data, model, forecasts, checks, forces, comparison."""
    from swarmssm import analysis, inference, io
    from swarmssm.inference.fitting import tracks_digest

    check_output(out, overwrite=overwrite)
    fitted = inference.Fit.load(run, trust_code=trust_code)
    known = fitted.provenance.get("data", {})
    path = data or Path(known.get("file") or "")
    if data is None and not (known.get("file") and path.exists()):
        raise InputError(
            f"{run}: the tracks it was fitted on are no longer at {path}. Name them with --data."
        )
    tracks = io.read(path)
    if tracks_digest(tracks) != known.get("sha256"):
        raise InputError(
            f"{path}: these are not the tracks that {run} was fitted on. Name them with --data."
        )
    with stages() as show:
        analysis.report_run(
            fitted,
            tracks,
            out,
            title=f"{fitted.settings.model} on {path.name}",
            rivals=load_other_runs(against, fitted, trust_code) or None,
            checks=checks,
            forces=forces,
            player=player,
            overwrite=overwrite,
            seed=seed,
            progress=show,
        )
    say(f"{out}: written.")


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
