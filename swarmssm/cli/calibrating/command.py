"""The command: its options, whether they go together, and what may be written where."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from swarmssm.cli.calibrating.likeness import likeness_of
from swarmssm.cli.calibrating.results import print_study, write_study
from swarmssm.cli.calibrating.studies import Study, run_calibration, run_recovery
from swarmssm.cli.console import say
from swarmssm.cli.options import (
    ConstructorOptions,
    FitSettings,
    Format,
    Overwrite,
    Priors,
    Seed,
    TableFormat,
    TrustCode,
    fit_settings,
    named_texts,
    named_values,
)
from swarmssm.errors import InputError, WorkError
from swarmssm.files import check_output

__all__ = ["calibrate"]

FIGURES = (".png", ".svg", ".pdf")
TOLERANCE, SPREAD, DRAWS = 0.1, 0.5, 199
#: How settings of a fit are named here that have an option of their own.
OPTIONS = {
    "model": "--model",
    "guide": "--guide",
    "model_options": "--model-option",
    "guide_options": "--guide-option",
    "priors": "--prior",
}


def calibrate(
    out: Annotated[Path, typer.Option(help="NetCDF file to write.")],
    file: Annotated[
        Path | None,
        typer.Argument(
            help="Tracks that the simulated ones are to be like: in numbers, length, scales and "
            "tracking noise."
        ),
    ] = None,
    study: Annotated[
        Study,
        typer.Option(
            help="calibration: are intervals as sure as they may be; recovery: how much data do "
            "parameters take."
        ),
    ] = Study.calibration,
    run: Annotated[
        Path | None,
        typer.Option(
            help="Run folder: simulate and fit with its model, guide and scales, in a recovery at "
            "the parameters it found."
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="Name of a model, or module:attribute of your own. Default: boids."),
    ] = None,
    guide: Annotated[
        str | None,
        typer.Option(help="Name of a guide, or module:attribute. Default: the model's usual one."),
    ] = None,
    prior: Priors = None,
    datasets: Annotated[
        int | None,
        typer.Option(help="Simulated data sets: 200, or in a recovery 5 for each setting."),
    ] = None,
    individuals: Annotated[
        int | None, typer.Option(help="In each trial. Default: as in FILE, else 8.")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(help="Of each trial. Default: as in FILE, else 80 or 100.")
    ] = None,
    trials: Annotated[
        int | None, typer.Option(help="In each data set. Default: as in FILE, else 2.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(help="Tracking noise in units of length. Default: as in FILE, else 0.03."),
    ] = None,
    radius: Annotated[
        float | None, typer.Option(help="Recovery: how far an individual sees. Default: 2.")
    ] = None,
    density: Annotated[
        float | None,
        typer.Option(help="Recovery: individuals in a unit of area at the start."),
    ] = None,
    graph: Annotated[
        str | None,
        typer.Option(help="Who sees whom: complete, radius:2.5, k-nearest:6 and so on."),
    ] = None,
    factor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=V,V,...]",
            help="Recovery: what is varied, individuals, density, radius, noise, frames or "
            "trials, for instance frames=100,200,400; repeatable.",
        ),
    ] = None,
    grid: Annotated[
        bool, typer.Option("--grid", help="Recovery: all combinations of the factors.")
    ] = False,
    value: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=NUMBER", help="Recovery: true value of a parameter; repeatable."
        ),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(help="Recovery: relative error that is asked for.")
    ] = TOLERANCE,
    spread: Annotated[
        float,
        typer.Option(
            help="Calibration: the model's LogNormal priors are made this wide where they are "
            "wider, so that groups hold together; 0 leaves them."
        ),
    ] = SPREAD,
    draws: Annotated[int, typer.Option(help="Calibration: draws from each posterior.")] = DRAWS,
    path_draws: Annotated[
        int, typer.Option(help="Calibration: draws of the states, for ranks of these too.")
    ] = 0,
    seed: Seed = 0,
    processes: Annotated[int, typer.Option(help="Data sets at once.")] = 1,
    model_option: ConstructorOptions = None,
    guide_option: ConstructorOptions = None,
    settings: FitSettings = None,
    figure: Annotated[
        Path | None, typer.Option(help="Picture to write, .png, .svg or .pdf. Default: OUT.png.")
    ] = None,
    format: Format = TableFormat.text,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what is finished, in OUT.jsonl.")
    ] = False,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Simulate data, fit them, and compare with the truth: calibration, or recovery."""
    _only(
        Study.recovery,
        study,
        {
            "--radius": radius is not None,
            "--density": density is not None,
            "--factor": bool(factor),
            "--grid": grid,
            "--value": bool(value),
            "--tolerance": tolerance != TOLERANCE,
        },
    )
    _only(
        Study.calibration,
        study,
        {
            "--spread": spread != SPREAD,
            "--draws": draws != DRAWS,
            "--path-draws": path_draws != 0,
        },
    )
    if spread < 0:
        raise InputError(f"--spread: it must not be negative, and it is {spread:g}.")
    rows, picture = _outputs(out, figure, resume, overwrite)
    like = likeness_of(file, run, trust_code)
    own: dict[str, Any] = {
        "model": model,
        "guide": guide,
        **fit_settings(prior, model_option, guide_option, settings),
    }
    own = {name: setting for name, setting in own.items() if setting}
    if run is not None and own:
        first = next(iter(own))
        option = OPTIONS.get(first, f"--set {first}")
        raise InputError(f"{option}: it is that of the run; leave it.")
    fitting = {**like.settings, **own}
    name = fitting.pop("model", "boids")
    kept = {"seed": seed, "processes": processes, "out": rows, "resume": resume}
    sizes = {"individuals": individuals, "frames": frames, "trials": trials, "noise": noise}
    with _to_go_on_with(rows, overwrite and not resume):
        if study is Study.calibration:
            found = run_calibration(
                name,
                like,
                datasets=datasets,
                sizes=sizes,
                graph=graph,
                options={
                    **kept,
                    **fitting,
                    "draws": draws,
                    "path_draws": path_draws,
                    "spread": spread or None,
                },
            )
        else:
            found = run_recovery(
                name,
                like,
                datasets=datasets,
                sizes={**sizes, "radius": radius, "density": density},
                graph=graph,
                options={
                    **kept,
                    **fitting,
                    "factors": _factors(factor),
                    "grid": grid,
                    "tolerance": tolerance,
                    "values": {**like.values, **_numbers(value)},
                },
            )
    drawn = write_study(found, study, out, picture)
    print_study(found, study, format)
    if format is TableFormat.text:
        written = f"{out}, {picture}: written." if drawn else f"{out}: written, without a picture."
        say(f"{written} What is finished stands in {rows}.")


def _only(belongs: Study, study: Study, given: Mapping[str, bool]) -> None:
    """Refuse options of a study that is not the one asked for."""
    for name, is_given in given.items():
        if is_given and study is not belongs:
            raise InputError(f"{name}: it belongs to --study {belongs.value} only.")


def _outputs(out: Path, figure: Path | None, resume: bool, overwrite: bool) -> tuple[Path, Path]:
    """Check what is to be written; return the file of finished data sets, and the picture."""
    again = overwrite or resume
    check_output(out, overwrite=again)
    picture = out.with_suffix(".png") if figure is None else figure
    if picture.suffix.lower() not in FIGURES:
        raise InputError(f"--figure: {picture} must end in one of {', '.join(FIGURES)}.")
    rows = out.with_suffix(".jsonl")
    if out in (rows, picture):
        raise InputError(f"--out: {out} is to be a NetCDF file; let it end in .nc.")
    check_output(picture, overwrite=again)
    if rows.exists() and not again:
        raise InputError(
            f"{rows}: it holds data sets of a study that was begun. Go on with --resume, begin "
            "anew with --overwrite, or choose another --out."
        )
    check_output(rows, overwrite=again)
    return rows, picture


@contextmanager
def _to_go_on_with(rows: Path, anew: bool) -> Iterator[None]:
    """Keep what is finished if the work is stopped by hand.

    A study that begins anew sets aside what was there. A study that ends before anything is
    finished leaves no file of its own, and what was set aside is put back.
    """
    old = rows.with_name(f".{rows.name}.old") if anew and rows.exists() else None
    if old is not None:
        rows.replace(old)
    begun = rows.exists()
    try:
        yield
    except KeyboardInterrupt:
        left = "Nothing was finished."
        if _finished(rows):
            left = f"What is finished stands in {rows}; go on with --resume."
        raise WorkError(f"stopped by hand. {left}") from None
    finally:
        if not begun and not _finished(rows):
            rows.unlink(missing_ok=True)
        if old is not None:
            if rows.exists():
                old.unlink(missing_ok=True)
            else:
                old.replace(rows)


def _finished(rows: Path) -> int:
    """Return how many data sets stand in a file; the first line says what they were made with."""
    return max(rows.read_bytes().count(b"\n") - 1, 0) if rows.exists() else 0


def _factors(texts: list[str] | None) -> dict[str, list[float]] | list[str] | None:
    """Read names of factors, all with values or all without."""
    if not texts:
        return None
    named = [text for text in texts if "=" not in text]
    if named and len(named) < len(texts):
        raise InputError("--factor: name values for all factors, or for none.")
    if named:
        return [text.strip() for text in texts]
    read = {}
    for name, text in named_texts(texts, "--factor").items():
        try:
            read[name] = [float(part) for part in text.split(",")]
        except ValueError:
            raise InputError(
                f"--factor: {name}={text} is not of the form {name}=100,200."
            ) from None
    return read


def _numbers(pairs: list[str] | None) -> dict[str, Any]:
    """Read true values of parameters."""
    values = named_values(pairs or [], "--value")
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float | list):
            raise InputError(f"--value: {name} must be a number, not {value!r}.")
    return values
