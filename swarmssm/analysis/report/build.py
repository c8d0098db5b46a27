"""From sections to one self-contained HTML file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import xarray as xr
from markupsafe import Markup

from swarmssm.analysis.diagnostics.checks import check, one_step_pit
from swarmssm.analysis.interpretation.analyze import analyze
from swarmssm.analysis.plots.scenes.free_run import with_free_run
from swarmssm.analysis.report.blocks import Fragment
from swarmssm.analysis.report.page import render, write_page
from swarmssm.analysis.report.player import player_assets, player_fragment
from swarmssm.analysis.report.sections import Section, section_of
from swarmssm.analysis.scoring.evaluation import Evaluation, evaluate
from swarmssm.analysis.scoring.rolling_origin import score
from swarmssm.errors import InputError, SwarmssmError
from swarmssm.files import check_output
from swarmssm.inference import Fit

__all__ = ["build_report", "full_section", "report_run", "write_report"]

#: Swarms that are simulated for the checks.
CHECK_DRAWS = 100
#: Draws of paths behind forces and maps.
FORCE_DRAWS = 5
FORCES = ("forces", "kernels", "force_maps")
#: Frames of a free run that can be played.
PLAYED = 300


def build_report(sections: Sequence[Section], title: str = "swarmssm report") -> str:
    """Return the report as HTML: one page that needs no network.

    Parameters
    ----------
    sections
        One a run, each with an anchor of its own.
    title
        Heading of the page.

    Raises
    ------
    InputError
        If there is no section, or two have one anchor.
    """
    if not sections:
        raise InputError("sections: there is nothing to report.")
    anchors = [section.anchor for section in sections]
    if len(set(anchors)) < len(anchors):
        raise InputError(f"sections: their anchors must differ, and they are {', '.join(anchors)}.")
    blocks = [one for section in sections for chapter in section.chapters for one in chapter.blocks]
    moving = any(isinstance(one, Fragment) for one in blocks)
    # All players share one script and one style, which stand behind the last.
    assets = player_assets() if moving else Markup("")
    return render("page.html", title=title, sections=sections, assets=assets)


def write_report(
    sections: Sequence[Section],
    path: str | Path,
    *,
    title: str = "swarmssm report",
    overwrite: bool = False,
) -> Path:
    """Write the report, beside and renamed.

    Parameters
    ----------
    sections, title
        As for :func:`build_report`.
    path
        The file to write.
    overwrite
        Whether an existing file may be replaced.

    Returns
    -------
    The path.

    Raises
    ------
    InputError
        As :func:`build_report`, or if the file exists and may not be replaced.
    WorkError
        If it cannot be written; what was there before is then unchanged.
    """
    path = check_output(Path(path), overwrite=overwrite)
    return write_page(build_report(sections, title), path, overwrite=overwrite)


def full_section(
    title: str,
    fit: Fit,
    tracks: xr.Dataset,
    *,
    anchor: str = "run",
    evaluation: Evaluation | None = None,
    rivals: Mapping[str, Fit] | None = None,
    scores: xr.Dataset | None = None,
    checks: int = CHECK_DRAWS,
    forces: bool = True,
    player: bool = True,
    thesis: str | None = "auto",
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Section:
    """Ask all that can be asked of a fit, and return the section that tells it.

    Parameters
    ----------
    title, fit, tracks, anchor, thesis
        As for :func:`swarmssm.analysis.report.section_of`.
    evaluation
        What :func:`swarmssm.analysis.scoring.evaluate` returned for them, if it is there already.
    rivals
        Other fits, by name, to be scored on the same held-out frames; absent, none.
    scores
        Of :func:`swarmssm.analysis.score` with them, if they are there already.
    checks
        How many swarms are simulated from the fit to check it by; 0 for no checks, else at least
        10. No p-value is below one in so many.
    forces
        Whether to say which forces act and by which rule, with few draws:
        :func:`swarmssm.analysis.interpretation.analyze` says more.
    player
        Whether the recording and a free run beside it can be played.
    seed
        Of all draws.
    progress
        Called with what is done next, in words.
    **options
        For :func:`swarmssm.analysis.scoring.evaluate`.

    Raises
    ------
    InputError
        As ``evaluate``. What cannot be had of this model or these tracks
        is left out, and a note in the page says why.
    """
    show = progress or (lambda what: None)
    if evaluation is None:
        show("scoring forecasts")
        evaluation = evaluate(fit, tracks, seed=seed, **options)
    part = str(evaluation.settings["part"])
    left_out: list[str] = []
    found: dict[str, Any] = {"scores": scores}

    def ask(name: str, words: str, question: Callable[[], Any]) -> None:
        show(words)
        try:
            found[name] = question()
        except SwarmssmError as error:
            left_out.append(f"Left out: {words}. {error}")

    if checks:
        ask(
            "checked",
            "simulating swarms",
            lambda: check(fit, tracks, draws=checks, part=part, seed=seed).data,
        )
        origins = int(evaluation.settings["origins"])
        ask(
            "pit",
            "how sure one step is",
            lambda: one_step_pit(fit, tracks, part=part, origins=origins, seed=seed).data,
        )
    if forces:
        ask(
            "analysis",
            "forces and kernels",
            lambda: analyze(fit, tracks, draws=FORCE_DRAWS, part=part, seed=seed, only=FORCES),
        )
    if rivals is not None and scores is None:
        ask(
            "scores",
            "comparing with rivals",
            lambda: score({fit.settings.model: fit, **rivals}, tracks, part=part, seed=seed),
        )
    if player:
        ask("player", "a free run to play", lambda: _player(fit, tracks, seed))
    evaluation = replace(evaluation, notes=(*evaluation.notes, *left_out))
    return section_of(title, fit, tracks, evaluation, anchor=anchor, thesis=thesis, **found)


def _player(fit: Fit, tracks: xr.Dataset, seed: int) -> Markup:
    """Return the recording beside a free run, of as many frames as a page can hold."""
    seen, run = with_free_run(fit, tracks, seed=seed)
    # The frames before the run are there for the headings: the recording starts with the run.
    return player_fragment(
        seen,
        run,
        start=float(run.attrs["free_run_start"]),
        steps=PLAYED - 1,
        titles=("Observed", "Free run of the model"),
        label="The recording beside a free run of the model",
        assets=False,
    )


def report_run(
    fit: Fit,
    tracks: xr.Dataset,
    path: str | Path,
    *,
    title: str | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Path:
    """Ask all that can be asked of one fit, and write its report.

    Parameters
    ----------
    fit, tracks
        A fit and the tracks to judge it by.
    path
        The file to write.
    title
        Heading; default names the model and the file.
    overwrite
        Whether an existing file may be replaced.
    **options
        For :func:`full_section`.

    Returns
    -------
    The path.

    Raises
    ------
    InputError, WorkError
        As :func:`full_section` and :func:`write_report`.
    """
    check_output(Path(path), overwrite=overwrite)
    if title is None:
        source = str(tracks.attrs.get("source_file", "")) or "tracks"
        title = f"{fit.settings.model} on {source}"
    section = full_section(title, fit, tracks, **options)
    return write_report([section], path, title=title, overwrite=overwrite)
