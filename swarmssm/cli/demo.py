"""``swarmssm demo``: the main job on bundled data, to a report."""

import gc
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swarmssm.cli.console import print_evaluation, say
from swarmssm.cli.options import Overwrite, Seed
from swarmssm.cli.progress import stages, training_progress
from swarmssm.errors import InputError
from swarmssm.files import write_beside

if TYPE_CHECKING:
    import xarray as xr

    from swarmssm.analysis import Evaluation
    from swarmssm.analysis.report import Section, Table
    from swarmssm.inference import Fit

__all__ = ["demo"]

FISH, FLOCK = "sunbleak", "boids"
NUM_FISH, NUM_GROUPS = 8, 4
NUM_BOIDS, NUM_FRAMES, NUM_TRIALS = 10, 600, 5
TITLES = {FISH: "Sunbleak, a real shoal", FLOCK: "Boids, a simulated flock"}
#: The fish are asked about their own future, the flock, as a rule stays a rule, about new flights.
SPLIT = {FISH: "time", FLOCK: "trial"}
THESIS = "graph-vae"
MODELS = {FISH: ("boids", "graph-ssm"), FLOCK: ("boids",)}
#: Fewer steps and epochs than by default: enough to see what each is worth. Fish have no hard
#: limits of speed, and in five seconds these meet no wall from which its place could be learned;
#: what was simulated without tracking noise is known exactly.
SETTINGS: dict[tuple[str, str], dict[str, Any]] = {
    (FISH, "graph-ssm"): {"steps": 100},
    (FISH, THESIS): {"epochs": 100},
    (FLOCK, THESIS): {"epochs": 100},
    (FISH, "boids"): {"model_options": {"walls": False, "limits": False, "relaxation": True}},
    (FLOCK, "boids"): {"model_options": {"observed": "states"}, "steps": 500, "lr": 0.02},
}
#: Fitted until convergence, whatever the number of epochs.
CONVERGES = (FISH, "boids")
#: Frames of each trial to forecast from: four of the shoal's trials are held out, one of the flock.
ORIGINS = {FISH: 4, FLOCK: 16}
#: Sampled futures of each, and swarms that are simulated to check a model.
FUTURES, CHECKS = 40, 50
#: Free runs: starts in each trial, runs from each, and steps. Of the shoal thirty frames are held
#: out in each trial: runs that are much longer have nothing to be compared with.
STARTS, RUNS = 2, 5
STEPS = {FISH: 60, FLOCK: 200}
#: Of which the kernels are drawn into a picture by itself, with so many pixels per inch.
PICTURED, DPI = (FISH, "boids"), 80
CHAPTER = (
    "graph-vae is the graph variational autoencoder of the thesis that this package began with. It "
    "predicts the next state and the next graph of a group from a latent state for each individual "
    "and frame, drawn anew in each frame. It can be fitted to any tracks in seconds, and redoes "
    "the thesis's tables, here with a third of its epochs. It cannot tell which forces act, and "
    "nothing links its latent states in time, so that its forecasts soon fall behind those of the "
    "models above. The printed numbers are of other recordings."
)


def demo(
    out: Annotated[
        Path, typer.Option(help="Folder to write: tracks, runs, report, picture.")
    ] = Path("demo"),
    epochs: Annotated[
        int | None,
        typer.Option(help="Fewer epochs for a quick look. Default: enough for sensible results."),
    ] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
) -> None:
    """Fit boids, graph-ssm and the thesis's model to a real shoal and a simulated flock; report."""
    from swarmssm import datasets, graphs, io
    from swarmssm.analysis.report import Page, Prose, Section
    from swarmssm.analysis.report.contents import glossary
    from swarmssm.simulate import simulate_boids

    marker = out / "report.html"
    if out.exists() and not overwrite:
        raise InputError(
            f"{out}: exists already and was left as it is. Choose another folder or add "
            "--overwrite."
        )
    if (
        out.exists()
        and any(out.iterdir())
        and not marker.exists()
        and not (out / f"{FISH}.nc").exists()
    ):
        raise InputError(f"{out}: it is not a demo's folder, and is not overwritten.")
    out.mkdir(parents=True, exist_ok=True)
    shoal = datasets.load_sunbleak_groups(NUM_FISH, NUM_GROUPS)
    # The graph is computed once, and not for each model and each question again.
    swarms = {
        FISH: graphs.add_adjacency(shoal, graphs.default_rule(shoal)),
        FLOCK: simulate_boids(NUM_BOIDS, NUM_FRAMES, NUM_TRIALS, seed=seed),
    }
    page = Page(
        "swarmssm demo",
        subtitle="A real shoal, a simulated flock, and the thesis's model",
    )
    tables = []
    for name, tracks in swarms.items():
        file = out / f"{name}.nc"
        io.write(tracks, file, overwrite=True)
        for model in MODELS[name]:
            fitted = _fit(name, model, tracks, file, epochs, seed)
            page.add(_section(name, model, tracks, fitted, seed))
            if (name, model) == PICTURED:
                _picture(fitted, tracks, out / "demo.png", seed)
            gc.collect()
        tables.append(_thesis(name, tracks, _fit(name, THESIS, tracks, file, epochs, seed), seed))
        gc.collect()
    page.add(Section("The thesis's model", [Prose(CHAPTER), *tables]), glossary())
    page.write(marker, overwrite=True)
    say(f"{marker}: written. Open it in a browser.")


def _fit(
    name: str, model: str, tracks: "xr.Dataset", file: Path, epochs: int | None, seed: int
) -> "Fit":
    """Fit a model, and write its run beside the tracks."""
    from swarmssm import inference

    settings = dict(SETTINGS.get((name, model), {}))
    if epochs is not None and (name, model) != CONVERGES:
        settings = {**settings, "steps": None, "epochs": epochs}
    with training_progress(f"{TITLES[name]}: {model}") as show:
        return inference.fit(
            model,
            tracks,
            guide="encoder" if model == THESIS else "auto",
            source=file,
            out=file.parent / f"{name}-{model}",
            overwrite=True,
            callbacks=[show],
            split_by=SPLIT[name],
            seed=seed,
            **settings,
        )


def _evaluate(name: str, tracks: "xr.Dataset", fitted: "Fit", seed: int) -> "Evaluation":
    """Score a fit, and print the scores."""
    from swarmssm import analysis

    result = analysis.evaluate(
        fitted,
        tracks,
        free_run_steps=STEPS[name],
        origins=ORIGINS[name],
        starts=STARTS,
        draws=RUNS,
        futures=FUTURES,
        seed=seed,
    )
    print_evaluation(f"{TITLES[name]}: {fitted.settings.model}", result)
    return result


def _section(name: str, model: str, tracks: "xr.Dataset", fitted: "Fit", seed: int) -> "Section":
    """Return the section on a fit."""
    from swarmssm import analysis

    evaluation = _evaluate(name, tracks, fitted, seed)
    with stages() as show:
        return analysis.run_section(
            f"{TITLES[name]}: {model}",
            fitted,
            tracks,
            evaluation=evaluation,
            checks=CHECKS,
            seed=seed,
            progress=show,
        )


def _picture(fitted: "Fit", tracks: "xr.Dataset", path: Path, seed: int) -> None:
    """Draw the kernels of a fit into a small picture."""
    from swarmssm import analysis
    from swarmssm.analysis.plots.kernels import plot_kernels
    from swarmssm.analysis.report.embed import report_style

    found = analysis.analyze(fitted, tracks, draws=20, seed=seed, only=["kernels"], scores=False)
    with report_style():
        figure, _ = plot_kernels(found.datasets["kernels"])
        with write_beside(path, overwrite=True) as temporary:
            figure.savefig(temporary, format="png", dpi=DPI)


def _thesis(name: str, tracks: "xr.Dataset", fitted: "Fit", seed: int) -> "Table":
    """Return the scores of the thesis's model beside its printed ones."""
    import pandas as pd

    from swarmssm.analysis.report import Table
    from swarmssm.analysis.scoring.thesis import FOOTNOTE
    from swarmssm.analysis.scoring.thesis_scores import scores_table

    rows = scores_table(_evaluate(name, tracks, fitted, seed))
    caption = f"{TITLES[name]}: one step ahead, free runs, and the next graph"
    return Table(caption, pd.DataFrame(rows), FOOTNOTE)
