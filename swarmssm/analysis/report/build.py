"""From sections to one self-contained HTML file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from swarmssm.analysis.evaluate import evaluate
from swarmssm.analysis.evaluation import Evaluation
from swarmssm.analysis.report.page import render, write_page
from swarmssm.analysis.report.sections import Section, section_of
from swarmssm.errors import InputError
from swarmssm.files import check_output
from swarmssm.inference import Fit

__all__ = ["build_report", "report_many", "report_run", "write_report"]


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
    return render("page.html", title=title, sections=sections)


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


def report_run(
    fit: Fit,
    tracks: xr.Dataset,
    path: str | Path,
    *,
    title: str | None = None,
    evaluation: Evaluation | None = None,
    thesis: str | None = "auto",
    overwrite: bool = False,
    **options: Any,
) -> Path:
    """Evaluate one fit and write its report.

    Parameters
    ----------
    fit, tracks
        A fit and the tracks to evaluate it on.
    path
        The file to write.
    title
        Heading; default names the model and the file.
    evaluation
        What :func:`swarmssm.analysis.evaluate` returned for them, if it is there already.
    thesis
        Which of the thesis's tables to print beside, see
        :func:`swarmssm.analysis.table.scores_table`.
    overwrite
        Whether an existing file may be replaced.
    **options
        For :func:`swarmssm.analysis.evaluate`.

    Returns
    -------
    The path.

    Raises
    ------
    InputError, WorkError
        As :func:`swarmssm.analysis.evaluate` and :func:`write_report`.
    """
    check_output(Path(path), overwrite=overwrite)
    if title is None:
        source = str(tracks.attrs.get("source_file", "")) or "tracks"
        title = f"{fit.settings.model} on {source}"
    if evaluation is None:
        evaluation = evaluate(fit, tracks, **options)
    section = section_of(title, fit, tracks, evaluation, thesis=thesis)
    return write_report([section], path, title=title, overwrite=overwrite)


def report_many(
    runs: Sequence[tuple[str, Fit, xr.Dataset] | tuple[str, Fit, xr.Dataset, Evaluation]],
    path: str | Path,
    *,
    title: str = "swarmssm report",
    overwrite: bool = False,
    **options: Any,
) -> Path:
    """Evaluate several fits and write one report with a section on each.

    Parameters
    ----------
    runs
        ``(title, fit, tracks)`` each, or with the evaluation as a fourth if it is there already.
    path
        The file to write.
    title
        Heading of the page.
    overwrite
        Whether an existing file may be replaced.
    **options
        For :func:`swarmssm.analysis.evaluate`.

    Returns
    -------
    The path.

    Raises
    ------
    InputError, WorkError
        As :func:`swarmssm.analysis.evaluate` and :func:`write_report`.
    """
    check_output(Path(path), overwrite=overwrite)
    sections = []
    for index, (heading, fit, tracks, *done) in enumerate(runs, start=1):
        evaluation = done[0] if done else evaluate(fit, tracks, **options)
        sections.append(section_of(heading, fit, tracks, evaluation, anchor=f"run{index}"))
    return write_report(sections, path, title=title, overwrite=overwrite)
