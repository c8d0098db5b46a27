"""Figures and sentences on each question that an analysis answers, as chapters of a page."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.interpretation.summary import formatted_summary
from swarmssm.analysis.plots import forces as force_plots
from swarmssm.analysis.plots import influence as influence_plots
from swarmssm.analysis.plots import latents as latent_plots
from swarmssm.analysis.plots.delays import plot_delays
from swarmssm.analysis.plots.gathered import plot_log_scores
from swarmssm.analysis.plots.inferred_edges import plot_edge_probabilities
from swarmssm.analysis.report import analysis_sentences as sentences
from swarmssm.analysis.report.blocks import Block, Chapter, Notes, Picture, Table, Text
from swarmssm.analysis.report.embed import report_style
from swarmssm.analysis.report.held_out import CAUTION, own_model, score_rows, score_sentence
from swarmssm.analysis.report.panels import (
    as_panels,
    kernel_figures,
    map_figure,
    modulation_figure,
    modulation_varies,
)

__all__ = ["HEADINGS", "analysis_chapter", "analysis_chapters"]

#: Frames of a curve over time that are drawn at most.
FRAMES = 1000
HEADINGS = {
    "forces": "Which forces act",
    "kernels": "What a neighbour does at each distance",
    "force_maps": "What goes with a neighbour's place",
    "latents": "What the latents carry",
    "influence": "Who moves whom",
    "delays": "Who turns first",
    "edges": "Inferred edges",
    "scores": "Held-out scores",
}
FINDINGS = (
    "The main numbers, medians with 90 % intervals where there are draws; what stands beside a "
    "number is what it has to be held against"
)
AHEAD = "Mean log score of positions at so many steps ahead, nats per coordinate (higher is better)"
Drawing = tuple[str, str, Callable[[], Sequence[Figure]]]


def analysis_chapters(analysis: Analysis, anchor: str = "") -> list[Chapter]:
    """Return a chapter on each question, with all its figures.

    Parameters
    ----------
    analysis
        What :func:`swarmssm.analysis.interpretation.analyze` returned.
    anchor
        What names of figures start with, where several analyses share a page.
    """
    tell: dict[str, Callable[[xr.Dataset, str], list[Drawing]]] = {
        "forces": _of_forces,
        "kernels": _of_kernels,
        "force_maps": _of_maps,
        "latents": _of_latents,
        "influence": _of_influence,
        "delays": lambda found, text: [("Who turns first", text, lambda: [plot_delays(found)[0]])],
        "edges": _of_edges,
        "scores": _of_scores,
    }
    chapters = []
    with report_style():
        for name, dataset in analysis.datasets.items():
            if name not in tell:
                continue
            sentence = ""
            further: list[Block] = []
            if name == "scores":
                own = own_model(dataset, str(analysis.settings.get("model", "")))
                sentence = f"{score_sentence(dataset, own)} {CAUTION} {sentence}".strip()
                further.append(Table(AHEAD, score_rows(dataset), "plain"))
            blocks: list[Block] = []
            for index, (title, text, draw) in enumerate(tell[name](dataset, sentence)):
                svg = as_panels(draw(), f"{anchor}{name}-f{index}", f"{title}. {text}")
                blocks.append(Picture(title, "", text, svg))
            blocks = blocks or [Text(sentence)]
            chapters.append(Chapter(name.replace("_", "-"), HEADINGS[name], blocks + further))
    return chapters


def analysis_chapter(anchor: str, analysis: Analysis | None) -> Chapter:
    """Return all that an analysis found as one chapter; without one, no blocks.

    Parameters
    ----------
    anchor
        Of the section, which names of figures start with.
    analysis
        What ``analyze`` returned; its scores are left to the comparison.
    """
    title = "Forces and kernels"
    if analysis is None:
        return Chapter("forces", title)
    blocks: list[Block] = [Table(FINDINGS, formatted_summary(analysis.datasets), "plain findings")]
    for chapter in analysis_chapters(analysis, f"{anchor}-"):
        if chapter.anchor != "scores":
            blocks += chapter.blocks
    return Chapter("forces", title, [*blocks, Notes(list(analysis.notes))])


def _of_forces(found: xr.Dataset, text: str) -> list[Drawing]:
    frames = found.sizes["time"]
    thinned = found.isel(trial=[0], time=slice(None, None, math.ceil(frames / FRAMES)))
    frame = fullest_frame(found)
    return [
        ("How large each force is", text, lambda: [force_plots.plot_force_shares(found)[0]]),
        (
            "The forces over time",
            sentences.over_time(found),
            lambda: [_over_time(thinned)],
        ),
        (
            "The forces in one frame",
            sentences.in_a_frame(found, frame),
            lambda: [force_plots.plot_force_arrows(found, frame=frame)[0]],
        ),
    ]


def _over_time(found: xr.Dataset) -> Figure:
    """Draw the strength of forces over time, not too wide for a narrow screen."""
    figure = Figure(figsize=(6.8, 3.8), layout="constrained")
    force_plots.plot_force_magnitudes(found, figure.add_subplot())
    return figure


def fullest_frame(found: xr.Dataset) -> int:
    """Return the frame of the first trial with most individuals, of several the middle one."""
    there = found["velocity"].isel(trial=0, draw=0).notnull().all("space").sum("individual")
    fullest = np.flatnonzero(there.to_numpy() == int(there.max()))
    return int(fullest[len(fullest) // 2])


def _of_kernels(found: xr.Dataset, text: str) -> list[Drawing]:
    drawn: list[Drawing] = [("Kernels of distance", text, lambda: kernel_figures(found))]
    if modulation_varies(found):
        drawn.append(
            (
                "By the direction of the neighbour",
                sentences.modulation(found),
                lambda: [modulation_figure(found)],
            )
        )
    return drawn


def _of_maps(found: xr.Dataset, text: str) -> list[Drawing]:
    return [("Force maps", text, lambda: [map_figure(found)])]


def _of_latents(found: xr.Dataset, text: str) -> list[Drawing]:
    drawn: list[Drawing] = [
        (
            "How well each source tells each force",
            text,
            lambda: [latent_plots.plot_sources(found)[0]],
        ),
        (
            "Each latent by itself",
            sentences.single_latents(found),
            lambda: [latent_plots.plot_latents(found)[0]],
        ),
    ]
    if "axis_r2" in found:
        drawn.append(
            (
                "The latent space turned towards the forces",
                sentences.rotated(found),
                lambda: [latent_plots.plot_rotated_axes(found)[0]],
            )
        )
    return drawn


def _of_influence(found: xr.Dataset, text: str) -> list[Drawing]:
    if not found["influence"].notnull().any():
        return []
    return [
        ("Who moves the others most", text, lambda: [influence_plots.plot_leadership(found)[0]]),
        ("Who moves whom", sentences.pairs(found), lambda: _network_and_matrix(found)),
    ]


def _network_and_matrix(found: xr.Dataset) -> list[Figure]:
    """Draw influence as arrows, and as a matrix."""
    return [
        influence_plots.plot_influence_network(found)[0],
        influence_plots.plot_influence_matrix(found)[0],
    ]


def _of_edges(found: xr.Dataset, text: str) -> list[Drawing]:
    return [("How likely an edge is", text, lambda: [plot_edge_probabilities(found)[0]])]


def _of_scores(found: xr.Dataset, text: str) -> list[Drawing]:
    return [("Log score ahead", text, lambda: [plot_log_scores(found)[0]])]
