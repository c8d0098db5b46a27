"""``swarmssm demo``: the main job on bundled data, to a report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from swarmssm.cli.console import print_all_scores, print_evaluation, print_rows, say
from swarmssm.cli.options import Overwrite, Seed
from swarmssm.cli.progress import counting_progress, stages, training_progress
from swarmssm.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from swarmssm.analysis.report import Section
    from swarmssm.inference import Fit

__all__ = ["demo"]

FISH, FLOCK = "sunbleak", "boids"
NUM_FISH, NUM_GROUPS = 8, 4
NUM_BOIDS, NUM_FRAMES, NUM_TRIALS = 10, 600, 5
#: The fish are asked about their own future, the flock, as a rule stays a rule, about new flights.
SPLIT = {FISH: "time", FLOCK: "trial"}
#: The thesis's model first: the others are its rivals.
THESIS = "graph-vae"
MODELS = (THESIS, "graph-ssm", "boids")
#: Fewer steps than by themselves: enough to see what each is worth. Fish have no hard limits of
#: speed, and in five seconds these meet no wall from which its place could be learned; what was
#: simulated without tracking noise is known exactly.
SETTINGS: dict[tuple[str, str], dict[str, Any]] = {
    (FISH, "graph-ssm"): {"steps": 100},
    (FISH, "boids"): {"model_options": {"walls": False, "limits": False, "relaxation": True}},
    (FLOCK, "graph-ssm"): {"steps": 100},
    (FLOCK, "boids"): {"model_options": {"observed": "states"}, "steps": 500, "lr": 0.02},
}
#: Fitted until it stays, whatever the number of epochs.
UNTIL_IT_STAYS = (FISH, "boids")
#: Frames of each trial to forecast from: four of the shoal's trials are held out, one of the flock.
ORIGINS = {FISH: 4, FLOCK: 16}
#: Sampled futures of each, and swarms that are simulated to check a model.
FUTURES, CHECKS = 40, 50
#: Free runs: starts in each trial, runs from each, and steps. Of the shoal thirty frames are held
#: out in each trial: runs that are much longer have nothing to be held against.
STARTS, RUNS = 2, 5
STEPS = {FISH: 60, FLOCK: 200}


def demo(
    out: Annotated[Path, typer.Option(help="Folder to write: tracks, runs, report.")] = Path(
        "demo"
    ),
    epochs: Annotated[
        int | None,
        typer.Option(help="Fewer epochs for a quick look. Default: the thesis's 300, 200 steps."),
    ] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
) -> None:
    """Fit the thesis's model, graph-ssm and boids to a real shoal and a simulated flock; report."""
    from swarmssm import analysis, datasets, graphs, inference, io
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
    # Who sees whom is worked out once, and not for each model and each question anew.
    shoal = graphs.add_adjacency(shoal, graphs.default_rule(shoal))
    swarms = {
        FISH: ("Sunbleak, a real shoal", shoal),
        FLOCK: (
            "Boids, a simulated flock",
            simulate_boids(NUM_BOIDS, NUM_FRAMES, NUM_TRIALS, seed=seed),
        ),
    }
    sections = []
    for name, (title, tracks) in swarms.items():
        file = out / f"{name}.nc"
        io.write(tracks, file, overwrite=True)
        fits = {}
        for model in MODELS:
            settings = dict(SETTINGS.get((name, model), {}))
            if epochs is not None and (name, model) != UNTIL_IT_STAYS:
                settings = {**settings, "steps": None, "epochs": epochs}
            with training_progress(f"{title}: {model}") as show:
                fits[model] = inference.fit(
                    model,
                    tracks,
                    guide="encoder" if model == THESIS else "auto",
                    source=file,
                    out=out / f"{name}-{model}",
                    overwrite=True,
                    callbacks=[show],
                    split_by=SPLIT[name],
                    seed=seed,
                    **settings,
                )
        sections += _sections(name, title, tracks, fits, seed)
    analysis.write_report(sections, marker, title="swarmssm demo", overwrite=True)
    say(f"{marker}: written. Open it in a browser.")


def _sections(
    name: str, title: str, tracks: "xr.Dataset", fits: "dict[str, Fit]", seed: int
) -> "list[Section]":
    """Score the fits of one swarm, print the scores, and return a section on each."""
    from swarmssm import analysis
    from swarmssm.analysis.scoring import score_table

    with counting_progress(f"{title}: forecasting", "batches") as show:
        scores = analysis.score(
            fits, tracks, origins=ORIGINS[name], draws=FUTURES, seed=seed, progress=show
        )
    sections = []
    for model, fitted in fits.items():
        thesis = "auto" if model == THESIS else None
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
        print_evaluation(f"{title}: {model}", result)
        if thesis:
            print_all_scores(result, thesis)
        with stages() as show:
            sections.append(
                analysis.full_section(
                    f"{title}: {model}",
                    fitted,
                    tracks,
                    anchor=f"{name}-{model}",
                    evaluation=result,
                    scores=scores if model == THESIS else None,
                    checks=CHECKS,
                    forces=model != THESIS,
                    thesis=thesis,
                    seed=seed,
                    progress=show,
                )
            )
    crps = score_table(scores, "crps")
    rows = [
        {"model": str(one)}
        | {str(int(k)): float(crps.sel({"model": one, "horizon": k})) for k in crps["horizon"]}
        for one in crps["model"].to_numpy()
    ]
    print_rows(f"{title}: CRPS of a coordinate at so many steps ahead (lower is better)", rows)
    return sections
