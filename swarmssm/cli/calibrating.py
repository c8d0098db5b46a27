"""``swarmssm calibrate``: how far a fit can be trusted, told by data whose truth is known."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import rich.console
import rich.progress
import typer

from swarmssm.cli.console import (
    LINE_EVERY,
    Overwrite,
    Seed,
    TableFormat,
    TrustCode,
    named_texts,
    named_values,
    print_json,
    print_rows,
    say,
    short,
)
from swarmssm.errors import InputError
from swarmssm.files import check_output

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from swarmssm.analysis.calibration.many_runs import Counted
    from swarmssm.models import Scales

__all__ = ["calibrate"]

FIGURES = (".png", ".svg", ".pdf")


class Study(StrEnum):
    """What is asked of the simulated data."""

    calibration = "calibration"
    recovery = "recovery"


Options = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=VALUE", help="An argument of its constructor; repeatable."),
]


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
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=DIST(ARGS)",
            help="Prior of a named parameter, for instance cohesion_gain=LogNormal(-1,0.5); "
            "repeatable.",
        ),
    ] = None,
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
    ] = 0.1,
    spread: Annotated[
        float,
        typer.Option(
            help="Calibration: the model's LogNormal priors are made this wide where they are "
            "wider, so that groups hold together; 0 leaves them."
        ),
    ] = 0.5,
    draws: Annotated[int, typer.Option(help="Calibration: draws from each posterior.")] = 199,
    path_draws: Annotated[
        int, typer.Option(help="Calibration: draws of the states, for ranks of these too.")
    ] = 0,
    seed: Seed = 0,
    processes: Annotated[int, typer.Option(help="Data sets at once.")] = 1,
    model_option: Options = None,
    guide_option: Options = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="Any setting of fit, for instance --set window=50."
        ),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Picture to write, .png, .svg or .pdf. Default: OUT.png.")
    ] = None,
    format: Annotated[
        TableFormat, typer.Option("--format", help="Print text or JSON.")
    ] = TableFormat.text,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what is finished, in OUT.jsonl.")
    ] = False,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Simulate data, fit them, and compare with the truth: calibration, or recovery."""
    only = {
        Study.recovery: {
            "--radius": radius is not None,
            "--density": density is not None,
            "--factor": bool(factor),
            "--grid": grid,
            "--value": bool(value),
            "--tolerance": tolerance != 0.1,
        },
        Study.calibration: {
            "--spread": spread != 0.5,
            "--draws": draws != 199,
            "--path-draws": path_draws != 0,
        },
    }
    for name, given in only[_other(study)].items():
        if given:
            raise InputError(f"{name}: it belongs to --study {_other(study).value} only.")
    if spread < 0:
        raise InputError(f"--spread: it must not be negative, and it is {spread:g}.")
    rows, picture = _outputs(out, figure, resume, overwrite)
    like = _like(file, run, trust_code)
    own_settings: dict[str, Any] = {
        "model": model,
        "guide": guide,
        "model_options": named_values(model_option or [], "--model-option"),
        "guide_options": named_values(guide_option or [], "--guide-option"),
        "priors": named_texts(prior or [], "--prior"),
        **named_values(settings or [], "--set"),
    }
    if run is not None:
        for name, setting in own_settings.items():
            if setting:
                raise InputError(f"--{name.replace('_', '-')}: it is that of the run; leave it.")
    wanted = like.settings or {k: v for k, v in own_settings.items() if v}
    name = wanted.pop("model", "boids")
    common: dict[str, Any] = {
        "seed": seed,
        "processes": processes,
        "out": rows,
        "resume": resume,
        **wanted,
    }
    try:
        with _set_aside(rows, overwrite and not resume):
            if study is Study.calibration:
                common |= {"draws": draws, "path_draws": path_draws, "spread": spread or None}
                found = _calibrated(
                    name,
                    like,
                    (individuals, frames, trials, noise),
                    graph,
                    200 if datasets is None else datasets,
                    common,
                )
            else:
                sizes = {
                    "individuals": individuals,
                    "frames": frames,
                    "trials": trials,
                    "noise": noise,
                    "radius": radius,
                    "density": density,
                }
                common |= {"factors": _factors(factor), "grid": grid, "tolerance": tolerance}
                common["values"] = {**like.values, **_numbers(value)}
                found = _recovered(
                    name, like, sizes, graph, 5 if datasets is None else datasets, common
                )
    except KeyboardInterrupt:
        kept = f"What is finished stands in {rows}. Go on with --resume."
        typer.echo(f"Stopped. {kept if rows.exists() else 'Nothing was finished.'}", err=True)
        raise typer.Exit(1) from None
    drawn = _write(found, study, out, picture)
    _print(found, study, format)
    if format is TableFormat.text:
        written = f"{out}, {picture}: written." if drawn else f"{out}: written, without a picture."
        say(f"{written} What is finished stands in {rows}.")


@dataclass(frozen=True)
class _Like:
    """What simulated data are to be like."""

    scales: "Scales | None" = None
    frames: int | None = None
    trials: int | None = None
    noise: float | None = None
    density: float | None = None
    graph: str | None = None
    values: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)


def _other(study: Study) -> Study:
    return Study.recovery if study is Study.calibration else Study.calibration


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
def _set_aside(rows: Path, overwrite: bool) -> Iterator[None]:
    """Let a study begin anew; put back what was there if it is refused before it has begun."""
    if not overwrite or not rows.exists():
        yield
        return
    old = rows.with_name(f".{rows.name}.old")
    rows.replace(old)
    try:
        yield
    finally:
        if rows.exists():
            old.unlink(missing_ok=True)
        else:
            old.replace(rows)


def _like(file: Path | None, run: Path | None, trust_code: bool) -> _Like:
    """Read what simulated data are to be like."""
    from swarmssm import inference, io
    from swarmssm.graphs import default_rule, rule_of
    from swarmssm.models import scales_of
    from swarmssm.tracks import with_trials

    like = _Like()
    if run is not None:
        fitted = inference.Fit.load(run, trust_code=trust_code)
        drawn = fitted.parameters(2000)
        values = {str(n): drawn[n].median("draw").to_numpy().tolist() for n in drawn.data_vars}
        given = fitted.settings.model_dump(mode="json")
        kept = ("model", "guide", "model_options", "guide_options", "priors", "steps", "epochs")
        rule = fitted.preparation.rule
        noise = values.get("emission.noise", fitted.scales.noise)
        like = replace(
            like,
            scales=fitted.scales,
            noise=noise if isinstance(noise, float) and noise > 0 else None,
            graph=None if rule is None else str(rule),
            values=values,
            settings={k: given[k] for k in kept if given[k] not in (None, {})},
        )
    if file is not None:
        tracks = with_trials(io.read(file))
        scales = scales_of(tracks)
        like = replace(
            like,
            scales=like.scales or scales,
            frames=tracks.sizes["time"],
            trials=tracks.sizes["trial"],
            noise=like.noise or scales.noise or None,
            graph=like.graph or str(rule_of(tracks) or default_rule(tracks)),
        )
    if like.scales is not None:
        sides = [h - lo for h, lo in zip(like.scales.high, like.scales.low, strict=True)]
        area = 1.0
        for side in sides:
            area *= side
        like = replace(like, density=like.scales.individuals / area if area > 0 else None)
    return like


def _calibrated(
    model: str,
    like: _Like,
    sizes: tuple[int | None, int | None, int | None, float | None],
    graph: str | None,
    datasets: int,
    options: dict[str, Any],
) -> "xr.Dataset":
    """Run a calibration."""
    from swarmssm.analysis.calibration.simulation import simulation_based_calibration
    from swarmssm.analysis.calibration.synthetic import standard_scales

    individuals, frames, trials, noise = sizes
    number = individuals
    if number is None:
        number = 8 if like.scales is None else like.scales.individuals
    scales = like.scales
    if scales is None:
        scales = standard_scales(max(number, 1), noise=0.03 if noise is None else noise)
    scales = replace(scales, individuals=number, noise=scales.noise if noise is None else noise)
    with counting_progress(f"calibration of {model}") as show:
        return simulation_based_calibration(
            model,
            options.pop("guide", "auto"),
            datasets=datasets,
            individuals=number,
            frames=(like.frames or 80) if frames is None else frames,
            trials=(like.trials or 2) if trials is None else trials,
            scales=scales,
            graph=graph or "complete",
            progress=show,
            **options,
        )


def _recovered(
    model: str,
    like: _Like,
    sizes: dict[str, Any],
    graph: str | None,
    datasets: int,
    options: dict[str, Any],
) -> "xr.Dataset":
    """Run a recovery study."""
    from swarmssm.analysis.recovery.settings import Setting
    from swarmssm.analysis.recovery.study import recovery_study

    base: Setting = Setting()
    if like.scales is not None:
        rule = like.graph if graph is None else graph
        base = replace(
            base,
            individuals=like.scales.individuals,
            radius=None,
            frames=like.frames or base.frames,
            trials=like.trials or base.trials,
            noise=like.noise or base.noise,
            density=like.density or base.density,
        )
        graph = rule
    elif graph is not None:
        base = replace(base, radius=None)
    base = base.changed(**{name: value for name, value in sizes.items() if value is not None})
    with counting_progress(f"recovery with {model}") as show:
        return recovery_study(
            model,
            options.pop("guide", "auto"),
            base=base,
            datasets=datasets,
            scales=like.scales,
            graph=None if base.radius is not None else graph,
            progress=show,
            **options,
        )


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


def _write(found: "xr.Dataset", study: Study, out: Path, picture: Path) -> bool:
    """Write the dataset and the picture; return whether there was anything to draw."""
    from swarmssm import io
    from swarmssm.analysis.plots.calibration import plot_calibration
    from swarmssm.analysis.plots.recovery import plot_recovery, varied_factors
    from swarmssm.files import write_beside

    io.write_dataset(found, out, overwrite=True)
    drawn: Figure
    if study is Study.calibration:
        drawn = plot_calibration(found)
    elif varied_factors(found):
        drawn, _ = plot_recovery(found)
    else:
        return False
    with write_beside(picture, overwrite=True) as temporary:
        drawn.savefig(temporary, format=picture.suffix[1:].lower(), dpi=150)
    return True


def _print(found: "xr.Dataset", study: Study, format: TableFormat) -> None:
    """Print tables and the sentence."""
    from swarmssm.analysis.calibration.ranks import calibration_sentence, calibration_table
    from swarmssm.analysis.recovery.table import (
        recovery_needs,
        recovery_sentence,
        recovery_table,
    )

    failures = str(found.attrs["failures"])
    if study is Study.calibration:
        sentence, tables = calibration_sentence(found), {"": calibration_table(found)}
    else:
        title = f"median error ± half the 90 % interval (! beyond {found.attrs['tolerance']:.0%})"
        sentence = recovery_sentence(found)
        tables = {title: recovery_table(found), "good enough at": recovery_needs(found)}
    if format is TableFormat.json:
        names = ("calibration",) if study is Study.calibration else ("errors", "needs")
        result: dict[str, Any] = dict(zip(names, tables.values(), strict=True))
        print_json({**result, "sentence": sentence, "failures": failures})
        return
    for title, rows in tables.items():
        print_rows(title, rows)
    say(sentence)
    if failures:
        say(f"Failed: {failures}")


@contextmanager
def counting_progress(label: str) -> "Iterator[Callable[[Counted], None]]":
    """Show how many pieces of work are done: a bar on a terminal, plain lines elsewhere."""
    if sys.stderr.isatty():
        columns = (
            rich.progress.TextColumn("{task.description}"),
            rich.progress.BarColumn(),
            rich.progress.MofNCompleteColumn(),
            rich.progress.TimeRemainingColumn(),
            rich.progress.TextColumn("{task.fields[failed]}"),
        )
        console = rich.console.Console(stderr=True)
        with rich.progress.Progress(*columns, console=console) as bar:
            task = bar.add_task(label, total=None, failed="")

            def show(counted: "Counted") -> None:
                failed = f"{counted.failed} failed" if counted.failed else ""
                bar.update(task, completed=counted.done, total=counted.total, failed=failed)

            yield show
        return
    began = last = time.monotonic()
    first: int | None = None

    def line(counted: "Counted") -> None:
        nonlocal last, first
        now = time.monotonic()
        if first is None:
            first = counted.done
        elif counted.done < counted.total and now - last < LINE_EVERY:
            return
        last = now
        text = f"{label}: {counted.done} of {counted.total} data sets"
        if counted.failed:
            text += f", {counted.failed} failed"
        own = counted.done - first
        if own and counted.done < counted.total:
            left = (now - began) / own * (counted.total - counted.done)
            text += f", about {short(left / 60.0)} min left"
        typer.echo(text, err=True)

    yield line
