"""Figures, tables and a Methods paragraph of an analysis as files for a paper."""

import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import xarray as xr
from matplotlib.figure import Figure

from swarmssm.analysis.interpretation.methods import methods_text
from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.interpretation.tables import write_tables
from swarmssm.analysis.plots.style import save_figure
from swarmssm.analysis.report.contents import CONTENTS
from swarmssm.errors import InputError, WorkError
from swarmssm.inference import Fit

__all__ = ["check_folder", "figures_of", "write_analysis_files"]


def figures_of(results: Mapping[str, Any]) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of a report, each with a name for its file.

    Parameters
    ----------
    results
        By the names that ``Content.needs`` asks for, such as the datasets of an analysis.
    """
    for content in CONTENTS:
        made = None if results.get(content.needs) is None else content.make(results[content.needs])
        if made is None or isinstance(made, pd.DataFrame):
            continue
        if isinstance(made, tuple):
            made = made[0]
        drawn = [made] if isinstance(made, Figure) else list(made)
        name = re.sub(r"[^a-z0-9]+", "-", f"{content.section} {content.title}".lower()).strip("-")
        for index, figure in enumerate(drawn, start=1):
            yield name if len(drawn) == 1 else f"{name}-{index}", figure


def check_folder(folder: Path, *, overwrite: bool = False) -> None:
    """Refuse a folder that cannot be written to, or that holds files already.

    Raises
    ------
    InputError
        If it is a file, its parent is missing, or it is not empty and ``overwrite`` is false.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: it is a file, and a folder is needed.")
    if not folder.resolve().parent.is_dir():
        raise InputError(f"{folder}: there is no folder {folder.resolve().parent}. Make it first.")
    if folder.exists() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"{folder}: it is not empty. Name a new folder, or allow overwriting.")


def write_analysis_files(
    analysis: Analysis,
    fit: Fit,
    tracks: xr.Dataset,
    folder: str | Path,
    *,
    format: Literal["pdf", "svg", "png"] = "pdf",
    width: float | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write the figures, a csv of each table behind them, and ``methods.md``.

    Parameters
    ----------
    analysis, fit, tracks
        An analysis, its fit and its tracks.
    folder
        Where to write; made if it is not there.
    format
        Of the figures.
    width
        Of the figures in mm; absent, as they are drawn for a page.
    overwrite
        Whether files of the same names are replaced. Others stay.

    Returns
    -------
    The files.

    Raises
    ------
    InputError
        If the folder is not empty and may not be changed, or the width is not positive.
    WorkError
        If writing fails; no file is then half-written.
    """
    folder = Path(folder)
    check_folder(folder, overwrite=overwrite)
    try:
        with tempfile.TemporaryDirectory(prefix=".figures-", dir=folder.resolve().parent) as name:
            beside = Path(name)
            for title, figure in figures_of(analysis.datasets):
                save_figure(figure, beside / f"{title}.{format}", width)
            write_tables(analysis.to_pandas(), beside)
            text = methods_text(analysis, fit, tracks)
            (beside / "methods.md").write_text(text, encoding="utf-8")
            folder.mkdir(exist_ok=True)
            written = sorted(path.name for path in beside.iterdir())
            for own in written:
                os.replace(beside / own, folder / own)
    except OSError as error:
        raise WorkError(f"{folder}: it cannot be written ({error.strerror}).") from error
    return [folder / own for own in written]
