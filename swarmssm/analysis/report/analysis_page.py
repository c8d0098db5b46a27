"""The page on what a fitted model says: forces, rules, latents, influence, and how sure."""

from pathlib import Path

import xarray as xr

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.interpretation.summary import formatted_summary
from swarmssm.analysis.report.analysis_chapters import FINDINGS, HEADINGS, analysis_chapters
from swarmssm.analysis.report.blocks import Table
from swarmssm.analysis.report.facts import (
    data_facts,
    model_facts,
    parameter_rows,
    provenance_facts,
)
from swarmssm.analysis.report.page import render, write_page
from swarmssm.analysis.report.wording import setting_words
from swarmssm.errors import InputError
from swarmssm.files import check_output
from swarmssm.inference import Fit

__all__ = ["analysis_page", "report_analysis"]


def analysis_page(
    analysis: Analysis, fit: Fit, tracks: xr.Dataset, title: str = "swarmssm analysis"
) -> str:
    """Return the page as HTML; it needs no network.

    Parameters
    ----------
    analysis
        What :func:`swarmssm.analysis.interpretation.analyze` returned.
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
    asked = [(name, setting_words(settings[name])) for name in shown if name in settings]
    return render(
        "analysis.html",
        title=title,
        findings=Table(FINDINGS, formatted_summary(analysis.datasets), "plain findings"),
        chapters=analysis_chapters(analysis),
        notes=[analysis.verdict(), *analysis.notes],
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
