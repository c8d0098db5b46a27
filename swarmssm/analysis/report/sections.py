"""One run as a section of a report: data, model, training, forecasts, and what was asked more."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from swarmssm.analysis import plots
from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.plots.model_graph import plot_model
from swarmssm.analysis.plots.presence import plot_presence
from swarmssm.analysis.report import sentences
from swarmssm.analysis.report.analysis_chapters import analysis_chapter
from swarmssm.analysis.report.blocks import Chapter, Facts, Fragment, Notes, Picture, Table
from swarmssm.analysis.report.chapters import check_chapter, comparison_chapter
from swarmssm.analysis.report.embed import report_style
from swarmssm.analysis.report.facts import (
    data_facts,
    model_facts,
    parameter_rows,
    presence_sentence,
    provenance_facts,
    scoring_facts,
)
from swarmssm.analysis.report.panels import as_panels
from swarmssm.analysis.scoring.evaluation import Evaluation
from swarmssm.analysis.scoring.thesis import FOOTNOTE
from swarmssm.analysis.scoring.thesis_scores import edge_table, horizon_table, scores_table
from swarmssm.inference import Fit

__all__ = ["Picture", "Section", "section_of"]

#: Pictures that say something only where the graph is not always the same.
WHO_SEES_WHOM, EDGE_ACCURACY = "Who sees whom, true and predicted", "Accuracy of the next graph"
OF_GRAPHS = {WHO_SEES_WHOM, EDGE_ACCURACY}
#: Size of figures that stand side by side.
SIDE = (4.6, 3.7)
PLAYER = (
    "Left what was seen, right a free run of the model from the first frame shown, with its noise "
    "drawn: what the model takes for possible, not what it expects."
)


@dataclass(frozen=True)
class Section:
    """What the report says of one run.

    Attributes
    ----------
    title, anchor
        Heading, and its place in the page.
    verdict, reasons
        One sentence that sums up, and those that it rests on.
    chapters
        What it rests on in turn: data, model, training, forecasts and so on.
    """

    title: str
    anchor: str
    verdict: str
    reasons: list[str]
    chapters: list[Chapter]


def section_of(
    title: str,
    fit: Fit,
    tracks: xr.Dataset,
    evaluation: Evaluation,
    *,
    anchor: str = "run",
    thesis: str | None = "auto",
    checked: xr.Dataset | None = None,
    pit: xr.Dataset | None = None,
    analysis: Analysis | None = None,
    scores: xr.Dataset | None = None,
    player: Markup | None = None,
) -> Section:
    """Return the section on one run.

    Parameters
    ----------
    title
        Its heading.
    fit, tracks, evaluation
        A fit, the tracks it was evaluated on, and what came out.
    anchor
        Its place in the page, unlike that of any other section: letters, digits and hyphens.
    thesis
        Which of the thesis's tables to print beside, see
        :func:`swarmssm.analysis.scoring.thesis_scores.scores_table`.
    checked, pit
        From :func:`swarmssm.analysis.diagnostics.checks.check` and
        ``one_step_pit``; absent, there is no chapter on checks.
    analysis
        From ``analyze``; absent, there is none on forces and kernels.
    scores
        From :func:`swarmssm.analysis.scoring.score` of this fit and its rivals; absent, there is
        no comparison.
    player
        Tracks that move, at the head of the forecasts, see
        :func:`swarmssm.analysis.report.player.player_fragment`.
    """
    if thesis == "auto":
        thesis = str(evaluation.settings["thesis"])
    anchor = re.sub(r"[^A-Za-z0-9_-]+", "-", anchor) or "run"
    verdict, reasons = sentences.verdict(evaluation)
    with report_style():
        chapters = [
            _data(anchor, fit, tracks, evaluation),
            _model(anchor, fit),
            _training(anchor, evaluation),
            _forecasts(anchor, evaluation, thesis, player),
            check_chapter(anchor, checked, pit),
            analysis_chapter(anchor, analysis),
            comparison_chapter(anchor, scores),
            Chapter(
                "provenance",
                "Provenance",
                [
                    Facts(
                        "Versions, data and digests",
                        provenance_facts(fit) + scoring_facts(evaluation),
                    )
                ],
            ),
        ]
    return Section(title, anchor, verdict, reasons, [own for own in chapters if own.blocks])


def _data(anchor: str, fit: Fit, tracks: xr.Dataset, evaluation: Evaluation) -> Chapter:
    """Return what was recorded, with its gaps."""
    part = str(evaluation.settings["part"])
    return Chapter(
        "data",
        "Data",
        [
            Facts("The recording", data_facts(fit, tracks, part)),
            _picture(
                anchor,
                "presence",
                "Who was tracked when",
                "",
                presence_sentence(tracks),
                lambda: [plot_presence(tracks)[0]],
            ),
        ],
    )


def _model(anchor: str, fit: Fit) -> Chapter:
    """Return the model in words, as a graph, with priors and posteriors."""
    known = "Shaded is what is observed; an arrow leads from what a variable is drawn given."
    return Chapter(
        "model",
        "Model",
        [
            Facts("Model, guide and settings of the fit", model_facts(fit)),
            _picture(
                anchor,
                "model-graph",
                "The model as a graph",
                "",
                known,
                lambda: [plot_model(fit)[0]],
            ),
            Table(
                "Prior and posterior of the named parameters, with the ends of the central 90 % "
                "interval",
                parameter_rows(fit),
                "plain",
            ),
        ],
    )


def _training(anchor: str, evaluation: Evaluation) -> Chapter:
    """Return the course of the loss."""
    history = evaluation.history
    if not history.sizes.get("epoch"):
        return Chapter("training", "Training")
    picture = _picture(
        anchor,
        "training",
        "Training",
        "4.9, 4.10",
        sentences.training_sentence(history),
        lambda: _course_of_training(history),
    )
    return Chapter("training", "Training", [picture])


def _forecasts(
    anchor: str, evaluation: Evaluation, thesis: str | None, player: Markup | None
) -> Chapter:
    """Return scores and pictures of what the model says of frames it has not seen."""
    tables = [
        Table(
            "One step ahead, free runs, and the next graph",
            scores_table(evaluation, thesis),
            footnote=FOOTNOTE if thesis else "",
        ),
        Table(
            "Mean squared error of scaled states at so many steps ahead", horizon_table(evaluation)
        ),
        Table(
            "Log score of positions at so many steps ahead, nats per coordinate (higher is better)",
            horizon_table(evaluation, "log_score"),
        ),
    ]
    notes = list(evaluation.notes)
    if sentences.edges_vary(evaluation):
        graph = Table("The next interaction graph, means over time", edge_table(evaluation))
        tables.append(graph)
    else:
        notes.append("All pairs are linked at all times, or none: no graph is to be predicted.")
    moving = [] if player is None else [Fragment("The swarm in motion", PLAYER, player)]
    return Chapter(
        "forecasts",
        "Forecasts",
        [*tables, Notes(notes), *moving, *_pictures(anchor, evaluation)],
    )


def _picture(
    anchor: str,
    name: str,
    title: str,
    thesis: str,
    sentence: str,
    draw: Callable[[], Sequence[Figure]],
) -> Picture:
    """Draw a figure, or several beside each other."""
    sentence = sentence or "There is not enough data to score here."
    svg = as_panels(draw(), f"{anchor}-{name}", f"{title}. {sentence}")
    return Picture(title, thesis, sentence, svg)


def _course_of_training(history: xr.Dataset) -> list[Figure]:
    """Draw the loss, and the errors of one step where they are known."""
    whole, axes = plots.plot_training(history)
    if len(axes) == 1:
        return [whole]
    figures = [Figure(figsize=SIDE, layout="constrained") for _ in axes]
    plots.plot_training(history, np.array([figure.add_subplot() for figure in figures]))
    return figures


def _errors_ahead(evaluation: Evaluation) -> list[Figure]:
    """Draw MSE and MAE side by side, as the thesis does."""
    figures = [Figure(figsize=SIDE, layout="constrained") for _ in range(2)]
    for figure, score in zip(figures, ("forecast_mse", "forecast_mae"), strict=True):
        plots.plot_horizon_errors(evaluation.scores, figure.add_subplot(), score=score)
    return figures


def _pictures(anchor: str, evaluation: Evaluation) -> list[Picture]:
    """Draw all figures of a run."""
    unit = evaluation.settings["unit"]
    drawn: list[tuple[str, str, str, Callable[[], Sequence[Figure]]]] = [
        (
            "True and imitated paths",
            "4.1, 4.2",
            sentences.imitation_sentence(evaluation),
            lambda: [plots.plot_imitation(evaluation.imitation)[0]],
        ),
        (
            "The group at some times",
            "4.3, 4.4",
            sentences.snapshots_sentence(evaluation),
            lambda: [plots.plot_snapshots(evaluation.imitation)[0]],
        ),
        (
            WHO_SEES_WHOM,
            "4.5",
            sentences.graphs_sentence(evaluation),
            lambda: [plots.plot_graphs(evaluation.graphs)[0]],
        ),
        (
            EDGE_ACCURACY,
            "4.6, 4.13",
            sentences.edge_sentence(evaluation),
            lambda: [plots.plot_edge_accuracy(evaluation.edges)[0]],
        ),
        (
            "Cohesion of free runs",
            "4.7a, 4.8a",
            sentences.collective_sentence(evaluation, "amd"),
            lambda: [plots.plot_collective(evaluation.collective, score="amd", unit=unit)[0]],
        ),
        (
            "Alignment of free runs",
            "4.7b, 4.8b",
            sentences.collective_sentence(evaluation, "avd"),
            lambda: [plots.plot_collective(evaluation.collective, score="avd", unit=unit)[0]],
        ),
        (
            "Error against the number of steps ahead",
            "4.11, 4.12",
            sentences.horizon_sentence(evaluation),
            lambda: _errors_ahead(evaluation),
        ),
        (
            "Free runs from random starts",
            "4.14",
            sentences.random_starts_sentence(evaluation),
            lambda: [plots.plot_random_starts(evaluation.random_starts)[0]],
        ),
    ]
    left_out = set() if sentences.edges_vary(evaluation) else OF_GRAPHS
    return [
        _picture(anchor, f"f{index}", title, thesis, sentence, draw)
        for index, (title, thesis, sentence, draw) in enumerate(drawn)
        if title not in left_out
    ]
