"""The two commands: their options, and the sizes that a template leaves open."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swarmssm.cli.calibrating.output import Output
from swarmssm.cli.calibrating.template import SimulationTemplate, template_of
from swarmssm.cli.console import print_json, print_rows, say
from swarmssm.cli.options import (
    Format,
    Overwrite,
    Seed,
    TableFormat,
    TrustCode,
    named_texts,
    named_values,
)
from swarmssm.cli.progress import counting_progress
from swarmssm.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from swarmssm.analysis.diagnostics.recovery import Design, Recovery
    from swarmssm.analysis.diagnostics.sbc import Calibration

__all__ = ["recovery", "sbc"]

INDIVIDUALS, FRAMES, TRIALS, NOISE = 8, 80, 2, 0.03
#: Sizes of a data set; in a recovery these may be varied.
SIZES = ("individuals", "frames", "trials", "noise")
DESIGN = (*SIZES, "radius", "density")
#: Settings of the study itself; all others are of the fit.
SBC = (*SIZES, "graph", "draws", "path_draws", "spread")
RECOVERY = (*DESIGN, "graph", "grid", "tolerance", "values")

Out = Annotated[Path, typer.Option(help="NetCDF file to write; finished data sets go to .jsonl.")]
Template = Annotated[
    Path | None,
    typer.Argument(help="Tracks whose size, scales and tracking noise the simulated data take."),
]
RunFolder = Annotated[
    Path | None,
    typer.Option("--run", help="Run folder whose model, guide, priors and scales are used."),
]
Model = Annotated[
    str | None,
    typer.Option("--model", help="Name of a model, or module:attribute. Default: boids."),
]
Processes = Annotated[int, typer.Option(help="Data sets at once.")]
Figure = Annotated[
    Path | None, typer.Option(help="Figure to write, .png, .svg or .pdf. Default: OUT.png.")
]
Resume = Annotated[bool, typer.Option("--resume", help="Continue an interrupted study.")]
SET_HELP = (
    "or any setting of a fit; nested with a dot, such as priors.damping=LogNormal(-1,0.5) or "
    "model_options.walls=false; repeatable."
)


def sbc(
    out: Out,
    file: Template = None,
    run: RunFolder = None,
    model: Model = None,
    datasets: Annotated[int, typer.Option(help="Number of simulated data sets.")] = 200,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help=f"One of {', '.join(SBC)}, {SET_HELP}"),
    ] = None,
    seed: Seed = 0,
    processes: Processes = 1,
    figure: Figure = None,
    format: Format = TableFormat.text,
    resume: Resume = False,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Simulation-based calibration: whether posterior intervals cover as often as they claim."""
    output = Output.of(out, figure, resume, overwrite)
    template = template_of(file, run, trust_code)
    name, study, fitting = _settings(settings, model, template, run, SBC)
    if (spread := study.get("spread", 0.0)) is not None and not _is_number(spread, least=0.0):
        raise InputError(f"--set spread: it must be a number from 0, not {spread!r}.")
    if "spread" in study:
        study["spread"] = study["spread"] or None
    from swarmssm.analysis.diagnostics.sbc.simulated import standard_scales
    from swarmssm.analysis.diagnostics.sbc.study import sbc as run_sbc
    from swarmssm.analysis.plots.calibration import plot_calibration

    scales = template.scales
    individuals = study.pop("individuals", scales.individuals if scales else INDIVIDUALS)
    noise = study.pop("noise", None)
    for size, value in (("individuals", individuals), ("noise", noise)):
        if value is not None and not _is_number(value, least=0.0):
            raise InputError(f"--set {size}: it must be a number above 0, not {value!r}.")
    if scales is None:
        scales = standard_scales(max(int(individuals), 1), noise=noise or NOISE)
    options = {
        "frames": template.frames or FRAMES,
        "trials": template.trials or TRIALS,
        "graph": template.graph or "complete",
        "scales": replace(scales, individuals=individuals, noise=noise or scales.noise),
        **study,
        **fitting,
    }
    with output.resumable(), counting_progress(f"calibration of {name}", "data sets") as show:
        found = run_sbc(
            name,
            datasets=datasets,
            individuals=individuals,
            seed=seed,
            processes=processes,
            out=output.rows,
            resume=resume,
            progress=show,
            **options,
        )
    drawn = plot_calibration(found.data)[0]
    output.write(found.data, drawn)
    _print(found, {"calibration": found.summary()}, format)
    if format is TableFormat.text:
        output.tell(drawn)


def recovery(
    out: Out,
    file: Template = None,
    run: Annotated[
        Path | None,
        typer.Option(
            "--run", help="Run folder whose model, guide and posterior medians are simulated."
        ),
    ] = None,
    model: Model = None,
    factor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=V,V,...]",
            help=f"What is varied, one of {', '.join(DESIGN)}, for instance frames=100,200,400; "
            "repeatable.",
        ),
    ] = None,
    datasets: Annotated[int, typer.Option(help="Simulated data sets of each design.")] = 5,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help=f"One of {', '.join(RECOVERY)} (true values, such as values.damping=0.5), "
            + SET_HELP,
        ),
    ] = None,
    seed: Seed = 0,
    processes: Processes = 1,
    figure: Figure = None,
    format: Format = TableFormat.text,
    resume: Resume = False,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Recovery study: how much data it takes to estimate known parameters."""
    output = Output.of(out, figure, resume, overwrite)
    template = template_of(file, run, trust_code)
    name, study, fitting = _settings(settings, model, template, run, RECOVERY)
    values = study.pop("values", {})
    if not isinstance(values, dict) or any(not _is_number(v) for v in values.values()):
        raise InputError("--set values: each must be a number, such as values.damping=0.5.")
    from swarmssm.analysis.diagnostics.recovery.study import recovery as run_recovery
    from swarmssm.analysis.plots.recovery import plot_recovery, varied_factors

    graph = study.pop("graph", template.graph)
    base = _base(template, graph)
    base = base.changed(**{size: study.pop(size) for size in DESIGN if size in study})
    with output.resumable(), counting_progress(f"recovery with {name}", "data sets") as show:
        found = run_recovery(
            name,
            base=base,
            factors=_factors(factor),
            datasets=datasets,
            values={**template.values, **values},
            scales=template.scales,
            graph=None if base.radius is not None else graph,
            seed=seed,
            processes=processes,
            out=output.rows,
            resume=resume,
            progress=show,
            **study,
            **fitting,
        )
    drawn = plot_recovery(found.data)[0] if varied_factors(found.data) else None
    output.write(found.data, drawn)
    _print(found, {"errors": found.summary(), "within tolerance at": found.sufficient()}, format)
    if format is TableFormat.text:
        output.tell(drawn)


def _settings(
    pairs: list[str] | None,
    model: str | None,
    template: SimulationTemplate,
    run: Path | None,
    own: tuple[str, ...],
) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Return the model, the settings of the study and those of the fit."""
    given: dict[str, Any] = {}
    for name, value in named_values(pairs or [], "--set").items():
        group, dot, key = name.partition(".")
        if not dot:
            given[name] = value
        elif isinstance(given.setdefault(group, {}), dict):
            given[group][key] = value
    fitting = {name: value for name, value in given.items() if name not in own}
    if run is not None and (model or fitting):
        option = "--model" if model else f"--set {next(iter(fitting))}"
        raise InputError(f"{option}: the run determines it; remove it.")
    fitting = {**template.settings, **fitting}
    name = model or fitting.pop("model", "boids")
    return name, {n: value for n, value in given.items() if n in own}, fitting


def _base(template: SimulationTemplate, graph: str | None) -> "Design":
    """Return the base design; without a radius if the neighbourhood rule is known."""
    from swarmssm.analysis.diagnostics.recovery.designs import Design

    base = Design()
    if template.scales is None:
        return base if graph is None else replace(base, radius=None)
    return replace(
        base,
        individuals=template.scales.individuals,
        radius=None,
        frames=template.frames or base.frames,
        trials=template.trials or base.trials,
        noise=template.noise or base.noise,
        density=template.density or base.density,
    )


def _factors(texts: list[str] | None) -> dict[str, list[float]] | list[str] | None:
    """Read names of factors, all with values or all without."""
    if not texts:
        return None
    named = [text for text in texts if "=" not in text]
    if named and len(named) < len(texts):
        raise InputError("--factor: give values for all factors, or for none.")
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


def _is_number(value: Any, least: float = float("-inf")) -> bool:
    """Return whether a value of an option is a number, or a list of numbers."""
    if isinstance(value, list):
        return all(_is_number(item, least) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool) and value >= least


def _print(
    found: "Calibration | Recovery", tables: Mapping[str, "pd.DataFrame"], format: TableFormat
) -> None:
    """Print the verdict, the tables and the failures."""
    failures = str(found.data.attrs["failures"])
    rows: dict[str, list[dict[str, object]]] = {
        title: [
            {str(k): v for k, v in row.items()} for row in table.reset_index().to_dict("records")
        ]
        for title, table in tables.items()
    }
    if format is TableFormat.json:
        print_json({"verdict": found.verdict(), **rows, "failures": failures})
        return
    say(found.verdict())
    for title, records in rows.items():
        if records:
            print_rows(title, records)
    if failures:
        say(f"Failed: {failures}")
