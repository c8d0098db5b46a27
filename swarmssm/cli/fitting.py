"""``swarmssm fit``: from tracks to a run folder."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swarmssm.cli.console import print_table, say
from swarmssm.cli.options import (
    ConstructorOptions,
    File,
    FitSettings,
    Overwrite,
    Priors,
    Seed,
    fit_settings,
)
from swarmssm.cli.progress import training_progress
from swarmssm.errors import InputError, WorkError

if TYPE_CHECKING:
    import xarray as xr

    from swarmssm.inference import Fit

__all__ = ["fit"]

#: Panels of the help.
OPTIMISER, EDGES, DATA = "Optimiser", "Inferred edges", "How data are prepared"
#: Edges that are inferred.
RELATIONAL = ("relational", "dynamic-relational")


def fit(
    context: typer.Context,
    file: File,
    out: Annotated[Path, typer.Option(help="Run folder to write.")],
    model: Annotated[
        str, typer.Option(help="Name of a model, or module:attribute of your own.")
    ] = "boids",
    guide: Annotated[
        str,
        typer.Option(
            help="Name of a guide, or module:attribute of your own. Default: the model's own."
        ),
    ] = "auto",
    prior: Priors = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="TOML file of settings, by their names in Python; options given here override it.",
        ),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Steps of the optimiser; the last epoch may be partial.")
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(help="Passes over the training part. Default: the model's own.")
    ] = None,
    seed: Seed = 0,
    lr: Annotated[
        float, typer.Option(rich_help_panel=OPTIMISER, help="Learning rate of Adam.")
    ] = 0.005,
    schedule: Annotated[
        str, typer.Option(rich_help_panel=OPTIMISER, help="Learning rate: cosine or constant.")
    ] = "cosine",
    window: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=OPTIMISER,
            help="Frames in a window; 0 for whole trials. Default: the guide's own.",
        ),
    ] = None,
    batch_windows: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=OPTIMISER, help="Windows in a mini-batch; 0 for all. Default: a tenth."
        ),
    ] = None,
    graph: Annotated[
        str,
        typer.Option(
            help="auto, data, or radius:2.5, k-nearest:6, visual:body_length=1, complete."
        ),
    ] = "auto",
    edges: Annotated[
        str,
        typer.Option(
            rich_help_panel=EDGES,
            help="auto (the model's own), relational, dynamic-relational, observed, or a rule.",
        ),
    ] = "auto",
    edge_types: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=EDGES,
            help="Types of relational edges, the first being none.  [default: 2]",
            min=1,
        ),
    ] = None,
    edge_option: Annotated[
        list[str] | None,
        typer.Option(
            rich_help_panel=EDGES,
            metavar="NAME=VALUE",
            help="Of relational edges, for instance sparsity=0.8; repeatable.",
        ),
    ] = None,
    transition_from: Annotated[
        Path | None,
        typer.Option(
            rich_help_panel=EDGES,
            metavar="RUN",
            help="Fix the transition at what this run of the same model found, and learn the "
            "edges alone; goes with relational --edges.",
        ),
    ] = None,
    velocity: Annotated[
        str, typer.Option(rich_help_panel=DATA, help="auto, difference or kalman.")
    ] = "auto",
    scaler: Annotated[
        str,
        typer.Option(
            rich_help_panel=DATA, help="auto (the model's own), minmax, isotropic or none."
        ),
    ] = "auto",
    split_by: Annotated[
        str, typer.Option(rich_help_panel=DATA, help="auto, time or trial.")
    ] = "auto",
    patience: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=OPTIMISER,
            help="Stop after so many rows of the history without a better validation.",
        ),
    ] = None,
    device: Annotated[
        str, typer.Option(rich_help_panel=OPTIMISER, help="cpu, cuda or auto.")
    ] = "cpu",
    model_option: ConstructorOptions = None,
    guide_option: ConstructorOptions = None,
    settings: FitSettings = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted fit in OUT.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Fit a model to tracks by variational inference, into a run folder."""
    from swarmssm import inference, io
    from swarmssm.inference.settings import read_config

    given: dict[str, Any] = {
        "steps": steps,
        "epochs": epochs,
        "seed": seed,
        "lr": lr,
        "schedule": schedule,
        "graph": graph,
        "velocity": velocity,
        "scaler": scaler,
        "split_by": split_by,
        "patience": patience,
        "device": device,
        "edges": edges,
        "edge_types": edge_types,
        **fit_settings(prior, model_option, guide_option, settings, edge_option),
    }
    for name, value in (("window", window), ("batch_windows", batch_windows)):
        if value is not None:
            given[name] = value or None
    if config is not None:
        given = _with_config(read_config(config), given, context)
        model, guide = given.pop("model", model), given.pop("guide", guide)
    if transition_from is not None:
        _hold(transition_from, model, edges, given)
    tracks = io.read(file)
    _warn_of_exact_tracks(file, tracks, model, given.get("model_options") or {})
    try:
        with training_progress(f"{file.name}: {model}") as show:
            fitted = inference.fit(
                model,
                tracks,
                guide=guide,
                source=file,
                out=out,
                resume=resume,
                overwrite=overwrite,
                callbacks=[show],
                **given,
            )
    except KeyboardInterrupt:
        raise WorkError(
            "stopped by hand. The same call with --resume goes on from the last checkpoint, if "
            "there is one."
        ) from None
    _print_fit(fitted)
    say(f"{out}: written. Next: swarmssm evaluate {out} {file}")


def _with_config(
    settings: dict[str, Any], given: dict[str, Any], context: typer.Context
) -> dict[str, Any]:
    """Return the settings of a file with those of the command line in their place."""

    def is_said(name: str) -> bool:
        source = context.get_parameter_source(name)
        return source is not None and source.name == "COMMANDLINE"

    merged = dict(settings)
    for name, value in given.items():
        if isinstance(value, dict):
            merged[name] = {**settings.get(name, {}), **value}
        elif name not in settings or is_said(name) or name not in context.params:
            merged[name] = value
    for name in ("model", "guide"):
        if is_said(name):
            merged[name] = context.params[name]
    return merged


def _warn_of_exact_tracks(
    file: Path, tracks: "xr.Dataset", model: str, options: dict[str, Any]
) -> None:
    """Say so if a model looks for tracking noise where it is known that there is none."""
    simulated = json.loads(str(tracks.attrs.get("simulation") or "{}"))
    if simulated.get("observation_noise") != 0 or "observed" in options:
        return
    from swarmssm.models.registry import find_model, options_of

    if "observed" in options_of(find_model(model)):
        say(
            f"{file}: it was simulated without tracking noise, which {model} infers: gains may "
            "come out wrong. Add --model-option observed=states, or simulate with "
            "--observation-noise."
        )


def _print_fit(fitted: "Fit") -> None:
    """Print how the fit went, and the posterior of its named parameters."""
    last = fitted.history.iloc[-1]
    best = fitted.history["validation_loss"].min()
    rows = [
        ("model", f"{fitted.settings.model} with guide {fitted.settings.guide}"),
        ("parameters", f"{fitted.num_parameters} learned"),
        ("steps", f"{last['step']:.0f} in {last['epoch']:.0f} epochs, {last['seconds']:.1f} s"),
        ("loss", f"{last['loss']:.4g} nats per coordinate"),
        ("validation", "no validation part" if best != best else f"{best:.4g} at its best"),
    ]
    if "mse" in last:
        scores = f"MSE {last['mse']:.3g} (4.2), MAE {last['mae']:.3g} (4.3)"
        rows.append(("one step, training part", scores))
    print_table("", ("fit", ""), rows)
    summary = fitted.summary()
    if len(summary):
        columns = ["parameter", "mean", "sd", "5 %", "95 %", "unit", "note"]
        if not summary["note"].any():
            summary, columns = summary.drop(columns="note"), columns[:-1]
        posterior = summary.reset_index().to_numpy().tolist()
        print_table("posterior, with 90 % intervals", columns, posterior)
    say(fitted.convergence.verdict)


def _hold(run: Path, model: str, edges: str, given: dict[str, Any]) -> None:
    """Put the transition of a run into the settings of a fit."""
    from swarmssm.inference import Fit, fixed_transition

    if edges not in RELATIONAL:
        raise InputError(
            "--transition-from: it fixes all but the edges, which are then to be inferred; add "
            f"--edges {' or '.join(RELATIONAL)}."
        )
    found = Fit.load(run)
    if found.settings.model != model:
        raise InputError(
            f"--transition-from: {run} is a run of {found.settings.model}; choose --model "
            f"{found.settings.model}, or a run of {model}."
        )
    given["model_options"] = {**found.settings.model_options, **given["model_options"]}
    own = given["priors"]
    held = {
        full: value
        for full, value in fixed_transition(found).items()
        if not any(full == name or full.endswith(f".{name}") for name in own)
    }
    given["priors"] = {**held, **own}
