"""``animate``: tracks in motion, a free run of a fitted model beside them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swarmssm.cli.console import say
from swarmssm.cli.options import File, Overwrite, Seed, TrustCode
from swarmssm.cli.progress import counting_progress
from swarmssm.errors import InputError
from swarmssm.files import check_output

if TYPE_CHECKING:
    from swarmssm.analysis.plots.scenes.scene import Choice

__all__ = ["animate"]


def animate(
    file: File,
    out: Annotated[
        Path,
        typer.Option(help="What to write: .html, a player; .gif; or .mp4, which needs ffmpeg."),
    ],
    run: Annotated[
        Path | None, typer.Option(help="Run folder: show a free run from START beside the tracks.")
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(
            help="Seconds: the first frame. Default: the first of all; with --run, where the run's "
            "test part begins, or half-way through other tracks."
        ),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Steps from there. Default: to the end.", min=1)
    ] = None,
    every: Annotated[int, typer.Option(help="Show each so many-th frame.", min=1)] = 1,
    trial: Annotated[str | None, typer.Option(help="Which trial. Default: the first.")] = None,
    individuals: Annotated[
        str | None, typer.Option(help="Labels of those to show, with commas. Default: all.")
    ] = None,
    edges: Annotated[
        str,
        typer.Option(
            help="auto (the graph of the tracks, or of the run), none, or a rule such as "
            "k-nearest:6, radius:5 or visual."
        ),
    ] = "auto",
    tail: Annotated[int, typer.Option(help="Frames of path behind each individual.", min=0)] = 25,
    fps_out: Annotated[
        float | None,
        typer.Option("--fps-out", help="Frames shown a second. Default: as fast as it was."),
    ] = None,
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Draw the noise of the free run, or not.")
    ] = True,
    seed: Seed = 0,
    trust_code: TrustCode = False,
    overwrite: Overwrite = False,
) -> None:
    """Show tracks in motion: a player to open in a browser, or a film."""
    from swarmssm import inference, io
    from swarmssm.analysis.plots.animation import WRITERS, check_film
    from swarmssm.analysis.plots.scenes import with_free_run

    page = out.suffix.lower() in (".html", ".htm")
    if page:
        check_output(out, overwrite=overwrite)
    elif out.suffix.lower() in WRITERS:
        check_film(out, overwrite=overwrite)
    else:
        raise InputError(f"{out}: its ending says what to write; it must be .html, .gif or .mp4.")
    fitted = None if run is None else inference.Fit.load(run, trust_code=trust_code)
    tracks, predicted = io.read(file), None
    titles = ("observed", "predicted")
    if fitted is not None:
        tracks, predicted = with_free_run(
            fitted, tracks, trial=trial, start=start, steps=steps, noise=noise, seed=seed
        )
        trial, start = None, float(predicted.attrs["free_run_start"])
        titles = ("observed", f"free run of {fitted.settings.model}")
    choice: Choice = {
        "trial": trial,
        "start": start,
        "steps": steps,
        "every": every,
        "edges": {"auto": True, "none": False}.get(edges, edges),
    }
    if individuals is not None:
        choice["individuals"] = [name.strip() for name in individuals.split(",")]
    if page:
        from swarmssm.analysis.report import player_page

        shown = player_page(
            tracks,
            predicted,
            title=f"Tracks of {file.name}",
            titles=(titles[0].capitalize(), titles[1].capitalize()),
            tail=tail,
            fps_out=fps_out,
            **choice,
        )
        shown.write(out, overwrite=overwrite)
    else:
        from swarmssm.analysis.plots import animation as films
        from swarmssm.analysis.report.embed import report_style

        pace = {".gif": films.FASTEST_GIF}.get(out.suffix.lower(), films.FASTEST)
        with report_style(), counting_progress(str(out), "frames") as show:
            film = films.animate(
                tracks,
                predicted,
                titles=titles,
                tail=tail,
                fps_out=fps_out,
                fastest=pace,
                **choice,
            )
            films.write_animation(film, out, overwrite=overwrite, progress=show)
    begins = "" if start is None else f" from {start:.4g} s"
    beside = "" if fitted is None else f", beside them a {titles[1]}"
    say(f"{out}: written. It shows the tracks of {file}{begins}{beside}.")
