"""Figures that both pages on analyses have, in parts that a narrow screen puts below each other."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure

from swarmssm.analysis.plots.kernels import plot_force_maps, plot_kernels, plot_modulation
from swarmssm.analysis.report.embed import as_svg

__all__ = [
    "as_panels",
    "kernel_figures",
    "map_figure",
    "modulation_figure",
    "modulation_varies",
]

SIZE = (4.4, 3.8)
MAPS = (6.4, 6.0)
IN_WORDS = {"model": "model's map", "raw": "raw map"}
#: A kernel's factor by angle is shown where its middle leaves 1 by more than this.
MODULATED = 1e-6


def as_panels(figures: Sequence[Figure], name: str, alt: str) -> Markup:
    """Return figures as SVG elements in a row that is broken where the page is narrow.

    Parameters
    ----------
    figures
        What to draw.
    name
        Unlike that of any other figure on the page.
    alt
        What they show together; to each is added which it is.
    """
    if len(figures) == 1:
        return as_svg(figures[0], name, alt)
    count = len(figures)
    drawn = [
        as_svg(figure, f"{name}-p{index}", f"{alt} Panel {index} of {count}: {_title(figure)}.")
        for index, figure in enumerate(figures, start=1)
    ]
    return Markup('<div class="panels">\n{}\n</div>').format(Markup("\n").join(drawn))


def kernel_figures(found: xr.Dataset) -> list[Figure]:
    """Draw the kernels of distance, each in a figure of its own, with the truth if it is known."""
    names = [str(name) for name in found if str(name).startswith("truth_")]
    curves = [name for name in names if "distance" in found[name].dims]
    truth = found[curves].rename({name: name.removeprefix("truth_") for name in curves})
    figures = [_figure(), _figure()]
    axes = np.array([figure.add_subplot() for figure in figures], dtype=object)
    plot_kernels(found, axes, truth=truth if curves else None)
    for ax in axes:
        _, words = ax.get_legend_handles_labels()
        ax.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.16),
            ncols=2,
            frameon=False,
            fontsize=9 if len(words) <= 2 else 8,
            columnspacing=1.0,
            handlelength=1.6,
        )
    return figures


def modulation_varies(found: xr.Dataset) -> bool:
    """Return whether a neighbour counts more at one angle than at another."""
    if "modulation" not in found:
        return False
    middle = found["modulation"].sel(quantile=0.5).to_numpy()
    return bool(np.abs(middle - 1.0).max() > MODULATED)


def modulation_figure(found: xr.Dataset) -> Figure:
    """Draw how much a neighbour counts by its direction, as large as a kernel."""
    figure = _figure()
    ax = figure.add_subplot()
    plot_modulation(found, ax)
    ax.set_title("how much a neighbour counts", fontsize=10)
    return figure


def map_figure(found: xr.Dataset) -> Figure:
    """Draw force maps, model beside raw, small enough for a narrow screen."""
    figure = Figure(figsize=MAPS, layout="constrained")
    axes = figure.subplots(2, found.sizes["source"], squeeze=False)
    plot_force_maps(found, axes)
    sources = [str(name) for name in found["source"].to_numpy()]
    for line, name in zip(axes, ("turning", "speeding"), strict=True):
        for ax, source in zip(line, sources, strict=True):
            ax.set_title(f"{name}: {IN_WORDS.get(source, source)}", fontsize=10)
            ax.set_ylabel(ax.get_ylabel() if source == sources[0] else "", parse_math=False)
    return figure


def _figure() -> Figure:
    return Figure(figsize=SIZE, layout="constrained")


def _title(figure: Figure) -> str:
    """Return what is written above the first axes of a figure."""
    return str(figure.axes[0].get_title())
