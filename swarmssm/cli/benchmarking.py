"""``benchmark``: every method on the same tracks, in one table."""

import os
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swarmssm.cli.comparing import Horizons, parse_horizons
from swarmssm.cli.console import print_json, print_rows, say
from swarmssm.cli.options import Format, Overwrite, Seed, TableFormat
from swarmssm.cli.progress import counting_progress
from swarmssm.errors import InputError, WorkError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["benchmark"]

#: Where the recordings lie that can be asked for by name, unless told.
FOLDER = "SWARMSSM_SHARED_DATA"
BUDGET = re.compile(r"(\d+(?:\.\d+)?)\s*(s|m|h)?")
SECONDS = {None: 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}


def benchmark(
    file: Annotated[
        Path | None,
        typer.Argument(help="Tracks: NetCDF, or any file import can read. Or --dataset."),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(help="Table to write, .csv; beside it .md, .html and .png of the same name."),
    ] = Path("table.csv"),
    dataset: Annotated[
        str | None, typer.Option(help="Tracks by name; --dataset list tells which there are.")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help=f"Folder of the recordings of --dataset. Default: ${FOLDER}, else ../shared/data."
        ),
    ] = None,
    methods: Annotated[
        str,
        typer.Option(
            help="all, or names with commas, also module:attribute of a baseline of your own; "
            "--methods list tells which there are."
        ),
    ] = "all",
    budget: Annotated[
        str,
        typer.Option(help="Processor time for each method to learn in: 90s, 2m, 1h; or none."),
    ] = "150s",
    jobs: Annotated[
        int | None, typer.Option(help="Methods at a time. Default: one for each core.", min=1)
    ] = None,
    seeds: Annotated[
        int, typer.Option(help="Repetitions with other weights, of methods that draw.", min=1)
    ] = 1,
    graph: Annotated[
        str | None,
        typer.Option(
            help="Who sees whom, for methods that do not find it out, such as radius:2.5. "
            "Default: the true rule of simulated tracks, else complete."
        ),
    ] = None,
    horizons: Horizons = None,
    origins: Annotated[
        int, typer.Option(help="Frames of each trial to forecast from.", min=1)
    ] = 40,
    free_run_steps: Annotated[int, typer.Option(help="Length of the free runs.", min=1)] = 200,
    split_by: Annotated[
        str, typer.Option(help="trial, time, or auto: by trial if there are three or more.")
    ] = "auto",
    seed: Seed = 0,
    format: Format = TableFormat.text,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with what was interrupted, or add more methods."),
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Measure every method on the same frames: errors, densities, free runs, edges, time."""
    from swarmssm.benchmark import (
        METHODS,
        check_outputs,
        collect,
        jobs_of,
        make_task,
        run_jobs,
        write_results,
    )
    from swarmssm.datasets import DATASETS

    if dataset == "list":
        print_rows("", [{"name": d.name, "tracks": d.title} for d in DATASETS.values()])
        return
    if methods == "list":
        print_rows("", [{"method": name} for name in METHODS])
        return
    if out.suffix != ".csv":
        raise InputError(f"--out: {out} must end in .csv.")
    seconds, options = _seconds(budget), parse_horizons(horizons)
    wanted = jobs_of(METHODS if methods == "all" else _names(methods), seeds)
    check_outputs(out, overwrite=overwrite or resume)
    tracks, title = _tracks(file, dataset, data)
    task = make_task(
        tracks,
        title=title,
        graph=graph,
        split_by=split_by,
        origins=origins,
        free_steps=free_run_steps,
        seed=seed,
        **options,
    )
    folder = out.with_suffix(".parts")
    if folder.exists() and not resume:
        if not overwrite:
            raise InputError(
                f"{folder}: measurements of a benchmark are there. --resume goes on with them, "
                "--overwrite begins anew."
            )
        shutil.rmtree(folder)
    with counting_progress("benchmark", "measurements") as show:
        parts = run_jobs(
            task,
            wanted,
            folder,
            seconds=seconds,
            processes=jobs or _cores(),
            progress=show,
        )
    results = collect(task, parts)
    paths = write_results(results, out)
    if format is TableFormat.json:
        print_json([{"method": name, **row} for name, row in results.rows.items()])
    else:
        if verdict := results.verdict():
            say(verdict)
        print_rows(title, results.short_rows())
        for name, row in results.rows.items():
            if row["failed"]:
                say(f"{name}: {row['failed']}")
        say(f"written: {', '.join(map(str, paths))}")
    if not any(part.measured is not None for part in parts.values()):
        raise WorkError("every method failed; the reasons stand in the table.")


def _seconds(text: str) -> float | None:
    """Read a time such as ``90s`` or ``2m``."""
    if text == "none":
        return None
    found = BUDGET.fullmatch(text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise InputError(f"--budget: {text!r} is no time; write 90s, 2m, 1h or none.")
    return float(found[1]) * SECONDS[found[2]]


def _names(text: str) -> list[str]:
    """Read names with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def _tracks(file: Path | None, dataset: str | None, data: Path | None) -> tuple["xr.Dataset", str]:
    """Return the tracks that are asked for, and what to call them."""
    from swarmssm import io
    from swarmssm.datasets import DATASETS, load_dataset

    if (file is None) == (dataset is None):
        raise InputError("give either a FILE of tracks or --dataset NAME.")
    if file is not None:
        return io.read(file), file.name
    assert dataset is not None
    folder = data or Path(os.environ.get(FOLDER, "../shared/data"))
    tracks = load_dataset(dataset, folder)
    return tracks, f"{dataset}: {DATASETS[dataset].title}"


def _cores() -> int:
    """Return how many cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
