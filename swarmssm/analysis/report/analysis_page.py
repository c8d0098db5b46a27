"""The page on what a fitted model says: forces, rules, latents, influence, and how sure."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from swarmssm.analysis.analyzed import Analysis
from swarmssm.analysis.findings import findings_table
from swarmssm.analysis.plots import forces as force_plots
from swarmssm.analysis.plots import influence as influence_plots
from swarmssm.analysis.plots import latents as latent_plots
from swarmssm.analysis.plots.gathered import plot_log_scores
from swarmssm.analysis.report import analysis_sentences as sentences
from swarmssm.analysis.report.embed import house_style
from swarmssm.analysis.report.facts import (
    data_facts,
    model_facts,
    parameter_rows,
    provenance_facts,
)
from swarmssm.analysis.report.held_out import CAUTION, own_model, score_rows, score_sentence
from swarmssm.analysis.report.page import render, write_page
from swarmssm.analysis.report.panels import (
    as_panels,
    kernel_figures,
    map_figure,
    modulation_figure,
    modulation_varies,
)
from swarmssm.analysis.report.sections import Picture
from swarmssm.errors import InputError
from swarmssm.files import check_output
from swarmssm.inference import Fit

__all__ = ["analysis_page", "report_analysis"]

#: Frames of a curve over time that are drawn at most.
FRAMES = 1000
HEADINGS = {
    "forces": "Which forces act",
    "kernels": "What a neighbour does at each distance",
    "force_maps": "What goes with a neighbour's place",
    "latents": "What the latents carry",
    "influence": "Who moves whom",
    "scores": "Held-out scores",
}
Drawing = tuple[str, str, Callable[[], Sequence[Figure]]]


@dataclass(frozen=True)
class Chapter:
    """The figures of one analysis, and its sentence, which stands alone where there are none.

    ``rows`` are those of a table of scores.
    """

    anchor: str
    heading: str
    sentence: str
    pictures: list[Picture]
    rows: list[dict[str, str]] = field(default_factory=list)


def analysis_page(
    analysis: Analysis, fit: Fit, tracks: xr.Dataset, title: str = "swarmssm analysis"
) -> str:
    """Return the page as HTML; it needs no network.

    Parameters
    ----------
    analysis
        What :func:`swarmssm.analysis.analyze` returned.
    fit, tracks
        The fit and the tracks that it speaks of.
    title
        Heading.

    Raises
    ------
    InputError
        If the analysis holds nothing.
    """
    if not analysis.datasets.keys() & HEADINGS.keys():
        raise InputError("analysis: there is nothing in it to report.")
    settings = {name: value for name, value in analysis.settings.items() if value not in ({}, None)}
    shown = ("part", "draws", "seed", "options", "version")
    asked = [(name, _words(settings[name])) for name in shown if name in settings]
    return render(
        "analysis.html",
        title=title,
        findings=findings_table(analysis),
        chapters=_chapters(analysis),
        notes=list(analysis.notes),
        parameters=parameter_rows(fit),
        data=data_facts(fit, tracks, str(settings.get("part", "all")), "analysed part"),
        model=model_facts(fit),
        asked=asked,
        provenance=provenance_facts(fit),
    )


def report_analysis(
    analysis: Analysis,
    fit: Fit,
    tracks: xr.Dataset,
    path: str | Path,
    *,
    title: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the page, beside and renamed.

    Parameters
    ----------
    analysis, fit, tracks
        As for :func:`analysis_page`.
    path
        The file to write.
    title
        Heading; default names the model and the file.
    overwrite
        Whether an existing file may be replaced.

    Returns
    -------
    The path.

    Raises
    ------
    InputError
        If the analysis holds nothing, or the file exists and may not be replaced.
    WorkError
        If it cannot be written; what was there before is then unchanged.
    """
    path = check_output(Path(path), overwrite=overwrite)
    if title is None:
        source = str(tracks.attrs.get("source_file", "")) or "tracks"
        title = f"What {fit.settings.model} says of {source}"
    return write_page(analysis_page(analysis, fit, tracks, title), path, overwrite=overwrite)


def _words(value: Any) -> str:
    """Return a setting as text."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_words(one)}" for name, one in value.items())
    return str(value)


def _chapters(analysis: Analysis) -> list[Chapter]:
    """Draw all figures."""
    tell: dict[str, Callable[[xr.Dataset, str], list[Drawing]]] = {
        "forces": _of_forces,
        "kernels": _of_kernels,
        "force_maps": _of_maps,
        "latents": _of_latents,
        "influence": _of_influence,
        "scores": _of_scores,
    }
    chapters = []
    with house_style():
        for name, dataset in analysis.datasets.items():
            if name not in tell:
                continue
            sentence = analysis.sentences.get(name, "")
            rows = []
            if name == "scores":
                own = own_model(dataset, str(analysis.settings.get("model", "")))
                sentence = f"{score_sentence(dataset, own)} {CAUTION} {sentence}".strip()
                rows = score_rows(dataset)
            pictures = []
            for index, (title, text, draw) in enumerate(tell[name](dataset, sentence)):
                svg = as_panels(draw(), f"{name}-f{index}", f"{title}. {text}")
                pictures.append(Picture(title, "", text, svg))
            anchor = name.replace("_", "-")
            chapters.append(Chapter(anchor, HEADINGS[name], sentence, pictures, rows))
    return chapters


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


def _of_scores(found: xr.Dataset, text: str) -> list[Drawing]:
    return [("Log score ahead", text, lambda: [plot_log_scores(found)[0]])]
