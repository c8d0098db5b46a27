"""Figures, tables and a Methods paragraph of an analysis as files for a paper."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import xarray as xr
from matplotlib.figure import Figure

from swarmssm.analysis import plots
from swarmssm.analysis.interpretation.methods import methods_text
from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.interpretation.tables import write_tables
from swarmssm.analysis.plots.style import save_figure
from swarmssm.errors import InputError, WorkError
from swarmssm.inference import Fit

__all__ = ["check_folder", "figures_of", "write_analysis_files"]


def _kernels(found: xr.Dataset) -> tuple[Figure, Any]:
    """Draw the two panels of kernels below each other, as a column of a paper has room for."""
    figure = Figure(figsize=(4.6, 7.4), layout="constrained")
    drawn = plots.plot_kernels(found, figure.subplots(2, 1))
    for ax in figure.axes:
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False, fontsize=7)
        ax.title.set_fontsize(8)
    return drawn


#: Name of the file, the dataset that is drawn, and the plot of it.
FIGURES: tuple[tuple[str, str, Callable[[xr.Dataset], Any]], ...] = (
    ("force-shares", "forces", plots.plot_force_shares),
    ("forces-over-time", "forces", plots.plot_force_magnitudes),
    ("force-arrows", "forces", plots.plot_force_arrows),
    ("kernels", "kernels", _kernels),
    ("modulation", "kernels", plots.plot_modulation),
    ("force-maps", "force_maps", plots.plot_force_maps),
    ("latent-sources", "latents", plots.plot_sources),
    ("latents", "latents", plots.plot_latents),
    ("latent-axes", "latents", plots.plot_rotated_axes),
    ("leadership", "influence", plots.plot_leadership),
    ("influence-network", "influence", plots.plot_influence_network),
    ("influence-matrix", "influence", plots.plot_influence_matrix),
    ("delays", "delays", plots.plot_delays),
    ("edge-probabilities", "edges", plots.plot_edge_probabilities),
    ("scores", "scores", plots.plot_scores),
)
#: A variable that a dataset must have for a plot, where not all have it.
ASKS = {"modulation": "modulation", "latent-axes": "axis_r2"}


def figures_of(analysis: Analysis) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of an analysis, each with a name for its file."""
    datasets = analysis.datasets
    for name, which, plot in FIGURES:
        found = datasets.get(which)
        if found is None or ASKS.get(name, "") not in {"", *map(str, found)}:
            continue
        if which == "influence" and not found["influence"].notnull().any():
            continue
        yield name, plot(found)[0]


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
    width: float | str | None = None,
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
        Of the figures in mm, or text such as ``"85mm"``; absent, as they are drawn for a page.
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
            for title, figure in figures_of(analysis):
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
