"""The report of a run: everything is computed once, and handed to the page."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from swarmssm.analysis.diagnostics.checks import check, one_step_pit
from swarmssm.analysis.interpretation.analyze import analyze
from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.interpretation.summary import formatted_summary
from swarmssm.analysis.plots.scenes.free_runs import with_free_run
from swarmssm.analysis.report import metadata
from swarmssm.analysis.report.answer import answer
from swarmssm.analysis.report.contents import glossary, sections
from swarmssm.analysis.report.page import Block, Note, Page, Player, Section, Table, Verdict
from swarmssm.analysis.report.player import player_fragment
from swarmssm.analysis.scoring.evaluation import Evaluation, evaluate
from swarmssm.analysis.scoring.table import format_number
from swarmssm.errors import SwarmssmError
from swarmssm.inference import Fit
from swarmssm.models import StateSpaceModel

__all__ = ["analysis_page", "run_page", "run_section"]

#: Swarms that are simulated for the checks.
CHECK_DRAWS = 100
#: Draws of paths behind forces and maps.
FORCE_DRAWS = 5
FORCES = ("forces", "kernels", "force_maps")
#: Frames of a free run that can be played.
PLAYED = 300
PLAYER = "Left the recording, right a free run of the model from the first frame, with its noise."
SUMMARY = "Main results: medians with 90 % intervals over the draws, and a reference for each"


def run_page(fit: Fit, tracks: xr.Dataset, *, title: str | None = None, **options: Any) -> Page:
    """Return the report of one fit.

    Parameters
    ----------
    fit, tracks
        A fit and the tracks to judge it by.
    title
        Heading; default names the model and the file.
    **options
        For :func:`run_section`.

    Raises
    ------
    InputError
        As :func:`run_section`.
    """
    title = title or f"{fit.settings.model} on {_source(tracks)}"
    section = run_section(title, fit, tracks, **options)
    return Page(title, [*section.blocks, glossary()], _size(tracks))


def run_section(
    title: str,
    fit: Fit,
    tracks: xr.Dataset,
    *,
    evaluation: Evaluation | None = None,
    against: Mapping[str, Fit] | None = None,
    checks: int = CHECK_DRAWS,
    forces: bool = True,
    player: bool = True,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Section:
    """Score, check and interpret a fit, and return its section of a report.

    Parameters
    ----------
    title, fit, tracks
        Heading; a fit, and the tracks to judge it by.
    evaluation
        From :func:`swarmssm.analysis.scoring.evaluate`, if it is known already.
    against
        Other fits, by name, to score on the same held-out frames; without ``evaluation``.
    checks
        Number of swarms to simulate from the fit for the checks; 0 for no checks, else at least
        10. The smallest p-value is one in this number.
    forces
        Whether to infer forces and kernels, with few draws;
        :func:`swarmssm.analysis.interpretation.analyze` takes more.
    player
        Whether to add a player of the recording and a free run.
    seed
        Of all draws.
    progress
        Called with the next step of the work, in words.
    **options
        For :func:`swarmssm.analysis.scoring.evaluate`.

    Raises
    ------
    InputError
        As ``evaluate``. What is not available for this model or these tracks is left out, and a
        note says why.
    """
    show = progress or (lambda what: None)
    if evaluation is None:
        show("scoring forecasts")
        evaluation = evaluate(fit, tracks, beside=against, seed=seed, **options)
    if isinstance(fit.model, StateSpaceModel):
        # The printed tables are those of another kind of model.
        evaluation = replace(evaluation, settings={**evaluation.settings, "thesis": None})
    part = str(evaluation.settings["part"])
    left_out: list[str] = []
    results: dict[str, Any] = {
        "fit": fit,
        "tracks": tracks,
        "evaluation": evaluation,
        "scores": evaluation.forecasts,
        "data": metadata.data_metadata(fit, tracks, part),
        "provenance": metadata.provenance_metadata(fit) + metadata.scoring_metadata(evaluation),
    }

    def ask(name: str, words: str, question: Callable[[], Any]) -> None:
        show(words)
        try:
            results[name] = question()
        except SwarmssmError as error:
            left_out.append(f"Left out: {words}. {error}")

    if checks:
        ask(
            "checks",
            "simulating swarms",
            lambda: check(fit, tracks, draws=checks, part=part, seed=seed).data,
        )
        origins = int(evaluation.settings["origins"])
        ask(
            "pit",
            "calibration of one-step forecasts",
            lambda: one_step_pit(fit, tracks, part=part, origins=origins, seed=seed).data,
        )
    if forces:
        ask(
            "analysis",
            "forces and kernels",
            lambda: analyze(
                fit,
                tracks,
                draws=FORCE_DRAWS,
                part=part,
                seed=seed,
                only=FORCES,
                scores=False,
            ),
        )
    if player:
        ask("player", "a free run to play", lambda: _player(fit, tracks, seed))
    analysis: Analysis | None = results.pop("analysis", None)
    remarks: dict[str, list[Block]] = {"forecasts": [Note(evaluation.notes)]}
    if analysis is not None:
        results |= {name: analysis.datasets[name] for name in FORCES if name in analysis.datasets}
    if (checked := results.get("checks")) is not None:
        remarks["checks"] = [Note([one for one in checked.attrs["notes"].splitlines() if one])]
    found = sections(results | {"remarks": remarks})
    notes = [Note(left_out)] if left_out else []
    return Section(title, [*answer(results), *notes, *found])


def analysis_page(
    analysis: Analysis, fit: Fit, tracks: xr.Dataset, title: str | None = None
) -> Page:
    """Return the page on an analysis.

    Parameters
    ----------
    analysis
        From :func:`swarmssm.analysis.interpretation.analyze`.
    fit, tracks
        The fit and the tracks that were analysed.
    title
        Heading; default names the model and the file.
    """
    settings = {name: value for name, value in analysis.settings.items() if value not in ({}, None)}
    asked = [
        (name, metadata.setting_words(settings[name]))
        for name in ("part", "draws", "seed", "options", "version")
        if name in settings
    ]
    results = {
        **analysis.datasets,
        "fit": fit,
        "tracks": tracks,
        "data": metadata.data_metadata(fit, tracks, str(settings.get("part", "all")), "part"),
        "provenance": asked + metadata.provenance_metadata(fit),
    }
    found = sections(results) if analysis.datasets.keys() - {"parameters"} else []
    rows = formatted_summary(analysis.datasets)
    first = Verdict("Verdict", analysis.verdict())
    blocks: list[Block] = [first, *answer(results), Note(analysis.notes)] if found else []
    if rows:
        blocks.append(Section("Main results", [Table(SUMMARY, pd.DataFrame(rows))], folded=True))
    title = title or f"Analysis: {fit.settings.model} on {_source(tracks)}"
    return Page(title, [*blocks, *found, glossary()] if found else [], _size(tracks))


def _player(fit: Fit, tracks: xr.Dataset, seed: int) -> Player:
    """Return the recording beside a free run, of as many frames as a page can hold."""
    seen, run = with_free_run(fit, tracks, steps=PLAYED - 1, seed=seed)
    # The frames before the run are there for the headings: the recording starts with the run.
    markup = player_fragment(
        seen,
        run,
        start=float(run.attrs["free_run_start"]),
        steps=PLAYED - 1,
        titles=("Recording", "Free run"),
        label="The recording beside a free run of the model",
    )
    return Player("The swarm in motion", PLAYER, markup)


def _source(tracks: xr.Dataset) -> str:
    return Path(str(tracks.attrs.get("source_file", ""))).name or "tracks"


def _size(tracks: xr.Dataset) -> str:
    """Return how much was recorded, in a line."""
    trials = tracks.sizes.get("trial", 1)
    parts = [
        f"{tracks.sizes['individual']} individuals",
        f"{tracks.sizes['time']} frames at {format_number(float(tracks.attrs['fps']))} per second",
        f"{trials} trial{'s' * (trials > 1)}",
        f"lengths in {tracks.attrs['unit']}" if tracks.attrs.get("unit") else "",
    ]
    return ", ".join(filter(None, parts))
