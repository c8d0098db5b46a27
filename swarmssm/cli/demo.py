"""``swarmssm demo``: the main job on bundled data, to a report."""

from pathlib import Path
from typing import Annotated

import typer

from swarmssm.cli.console import print_evaluation, say
from swarmssm.cli.options import Overwrite, Seed
from swarmssm.cli.progress import training_progress
from swarmssm.errors import InputError

__all__ = ["demo"]

FISH, FLOCK = "sunbleak", "boids"
NUM_FISH, NUM_GROUPS = 10, 8
NUM_BOIDS, NUM_FRAMES, NUM_TRIALS = 10, 1000, 5
#: The fish are asked about their own future, the flock, as a rule stays a rule, about new flights.
SPLIT = {FISH: "time", FLOCK: "trial"}


def demo(
    out: Annotated[Path, typer.Option(help="Folder to write: tracks, runs, report.")] = Path(
        "demo"
    ),
    epochs: Annotated[
        int | None, typer.Option(help="Fewer epochs for a quick look. Default: the thesis's 300.")
    ] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
) -> None:
    """Fit the thesis's model to a real school of fish and to a simulated flock, and report."""
    from swarmssm import analysis, datasets, inference, io
    from swarmssm.simulate import simulate_boids

    marker = out / "report.html"
    if out.exists() and not overwrite:
        raise InputError(
            f"{out}: exists already and was left as it is. Choose another folder or add "
            "--overwrite."
        )
    if out.exists() and any(out.iterdir()) and not marker.exists() and not (out / FISH).exists():
        raise InputError(f"{out}: it is not a demo's folder, and is not overwritten.")
    out.mkdir(parents=True, exist_ok=True)
    swarms = {
        FISH: ("Sunbleak, a real shoal", datasets.load_sunbleak_groups(NUM_FISH, NUM_GROUPS)),
        FLOCK: (
            "Boids, a simulated flock",
            simulate_boids(NUM_BOIDS, NUM_FRAMES, NUM_TRIALS, seed=seed),
        ),
    }
    sections = []
    for name, (title, tracks) in swarms.items():
        file, run = out / f"{name}.nc", out / name
        io.write(tracks, file, overwrite=True)
        with training_progress(title) as show:
            fitted = inference.fit(
                "graph-vae",
                "encoder",
                tracks,
                source=file,
                out=run,
                overwrite=True,
                callbacks=[show],
                epochs=epochs,
                split_by=SPLIT[name],
                seed=seed,
            )
        result = analysis.evaluate(fitted, tracks, seed=seed)
        print_evaluation(title, result, "auto")
        sections.append((title, fitted, tracks, result))
    analysis.report_many(sections, marker, overwrite=True)
    say(f"{marker}: written. Open it in a browser.")
