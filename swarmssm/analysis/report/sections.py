"""One run as a section of a report: facts, scores, figures, and a sentence on each."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from swarmssm.analysis import plots
from swarmssm.analysis.evaluation import Evaluation
from swarmssm.analysis.report import sentences
from swarmssm.analysis.report.embed import as_svg, house_style
from swarmssm.analysis.report.facts import (
    data_facts,
    model_facts,
    parameter_rows,
    provenance_facts,
    scoring_facts,
)
from swarmssm.analysis.table import edge_table, horizon_table, scores_table
from swarmssm.analysis.thesis import FOOTNOTE
from swarmssm.inference import Fit

__all__ = ["Picture", "Section", "section_of"]

Rows = list[dict[str, str]]
Facts = list[tuple[str, str]]


@dataclass(frozen=True)
class Picture:
    """A figure with its title, what is to be seen, and the thesis's figures that it redoes."""

    title: str
    thesis: str
    sentence: str
    svg: Markup


@dataclass(frozen=True)
class Section:
    """What the report says of one run.

    Attributes
    ----------
    title, anchor
        Heading, and its place in the page.
    verdict, reasons
        One sentence that sums up, and those that it rests on.
    data, model, provenance
        Facts, label and text.
    parameters
        Posterior of the parameters that have a prior; empty without any.
    scores, horizons, log_scores, edges
        Tables, rows of column title and text.
    footnote
        To the thesis's rows; empty if there are none.
    notes
        What a reader of the scores has to know.
    pictures
        Figures.
    """

    title: str
    anchor: str
    verdict: str
    reasons: list[str]
    data: Facts
    model: Facts
    parameters: Rows
    provenance: Facts
    scores: Rows
    horizons: Rows
    log_scores: Rows
    edges: Rows
    footnote: str
    notes: list[str]
    pictures: list[Picture]


def section_of(
    title: str,
    fit: Fit,
    tracks: xr.Dataset,
    evaluation: Evaluation,
    *,
    anchor: str = "run",
    thesis: str | None = "auto",
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
        :func:`swarmssm.analysis.table.scores_table`.
    """
    if thesis == "auto":
        thesis = str(evaluation.settings["thesis"])
    anchor = re.sub(r"[^A-Za-z0-9_-]+", "-", anchor) or "run"
    verdict, reasons = sentences.verdict(evaluation)
    scores = scores_table(evaluation, thesis)
    return Section(
        title,
        anchor,
        verdict,
        reasons,
        data_facts(fit, tracks, str(evaluation.settings["part"])),
        model_facts(fit),
        parameter_rows(fit),
        provenance_facts(fit) + scoring_facts(evaluation),
        scores,
        horizon_table(evaluation),
        horizon_table(evaluation, "log_score"),
        edge_table(evaluation),
        FOOTNOTE if thesis else "",
        list(evaluation.notes),
        _pictures(anchor, evaluation),
    )


def _errors_ahead(evaluation: Evaluation) -> tuple[Figure, Any]:
    """Draw MSE and MAE side by side, as the thesis does."""
    figure = Figure(figsize=(9.6, 4.0), layout="constrained")
    axes = figure.subplots(1, 2)
    for ax, score in zip(axes, ("forecast_mse", "forecast_mae"), strict=True):
        plots.plot_horizon_errors(evaluation.scores, ax, score=score)
    return figure, axes


def _pictures(anchor: str, evaluation: Evaluation) -> list[Picture]:
    """Draw all figures of a run."""
    unit = evaluation.settings["unit"]
    drawn: list[tuple[str, str, str, Callable[[], tuple[Figure, Any]]]] = [
        (
            "True and imitated paths",
            "4.1, 4.2",
            sentences.imitation_sentence(evaluation),
            lambda: plots.plot_imitation(evaluation.imitation),
        ),
        (
            "The group at some times",
            "4.3, 4.4",
            sentences.snapshots_sentence(evaluation),
            lambda: plots.plot_snapshots(evaluation.imitation),
        ),
        (
            "Who sees whom, true and predicted",
            "4.5",
            sentences.graphs_sentence(evaluation),
            lambda: plots.plot_graphs(evaluation.graphs),
        ),
        (
            "Accuracy of the next graph",
            "4.6, 4.13",
            sentences.edge_sentence(evaluation),
            lambda: plots.plot_edge_accuracy(evaluation.edges),
        ),
        (
            "Cohesion of free runs",
            "4.7a, 4.8a",
            sentences.collective_sentence(evaluation, "amd"),
            lambda: plots.plot_collective(evaluation.collective, score="amd", unit=unit),
        ),
        (
            "Alignment of free runs",
            "4.7b, 4.8b",
            sentences.collective_sentence(evaluation, "avd"),
            lambda: plots.plot_collective(evaluation.collective, score="avd", unit=unit),
        ),
        (
            "Training",
            "4.9, 4.10",
            sentences.training_sentence(evaluation.history),
            lambda: plots.plot_training(evaluation.history),
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
            lambda: plots.plot_random_starts(evaluation.random_starts),
        ),
    ]
    pictures = []
    with house_style():
        for index, (title, thesis, sentence, draw) in enumerate(drawn):
            if title == "Training" and not evaluation.history.sizes.get("epoch"):
                continue
            sentence = sentence or "There is not enough data to score here."
            alt = f"{title}. {sentence}"
            svg = as_svg(draw()[0], f"{anchor}-f{index}", alt)
            pictures.append(Picture(title, thesis, sentence, svg))
    return pictures
