"""What neighbours do: kernels of distance, and maps around a focal individual."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from swarmssm.analysis.plots.forces import TERM_COLOURS, units
from swarmssm.analysis.plots.style import (
    colour_of,
    legend_below,
    new_axes,
    new_grid,
    paint_ground,
)

__all__ = ["plot_force_maps", "plot_kernels", "plot_modulation"]

NET = "#2f86c6"
#: Colours of kernels, those of the forces that they make.
KERNEL_COLOURS = {
    "attraction": TERM_COLOURS["cohesion"],
    "repulsion": TERM_COLOURS["separation"],
}
#: Ink on a map, which is light in any page.
DARK = "#111111"
#: From blue over white to red; without the darkest ends, which faint would look grey.
DIVERGING = ListedColormap(colormaps["RdBu_r"](np.linspace(0.1, 0.9, 256)))
#: Bins of a map with too few pairs, and the middle of its scale of colours.
EMPTY, NEUTRAL = "#c8c8c8", "#f7f7f7"
#: Bins of a map with fewer pairs stay empty; those within so many standard errors of 0 are faint.
FEWEST_PAIRS = 10
UNSURE = 2.0
#: The share of sure bins that is within the scale of colours, and how many times the ends of one
#: map may be those of another.
SHOWN, STRONGER = 0.98, 3.0


def plot_kernels(
    kernels: xr.Dataset,
    axes: npt.NDArray[Any] | None = None,
    *,
    truth: xr.Dataset | None = None,
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw what a neighbour does at each distance: net force, and alignment.

    Parameters
    ----------
    kernels
        What :func:`swarmssm.analysis.interaction_kernels` returned.
    axes
        Two axes; new ones if absent.
    truth
        What :func:`swarmssm.analysis.true_kernels` returned, drawn in black.

    Returns
    -------
    Figure and axes ``(2,)``. Bands are 90 % intervals. Curves are drawn over the distances at which
    there are neighbours, from ``believed_from`` to ``believed_to``: from the 1 % to the 98 %
    quantile, whose density is the grey area below. A dotted line marks the preferred distance,
    shaded with its interval.
    """
    figure, grid = new_grid(axes, 1, 2, (9.6, 3.9))
    distance = kernels["distance"].to_numpy()
    unit = str(kernels.attrs.get("unit", ""))
    attrs = kernels.attrs
    low, high = float(attrs.get("believed_from", 0.0)), float(attrs.get("believed_to", np.inf))
    inside = (distance >= low) & (distance <= high)
    density = kernels["density"].to_numpy()
    dense = density / max(float(density.max()), 1e-300)
    panels = (
        ("net", NET, "force of a neighbour: away < 0 < towards"),
        ("alignment", TERM_COLOURS["alignment"], "alignment with a neighbour"),
    )
    along = {
        str(key).removesuffix("_along"): kind
        for key, kind in kernels.attrs.items()
        if str(key).endswith("_along")
    }
    radial = [name for name, kind in along.items() if kind == "offset"]
    for ax, (name, colour, title) in zip(grid[0], panels, strict=True):
        if name not in kernels:
            ax.set_visible(False)
            continue
        curves = kernels[name].transpose("quantile", "distance").to_numpy()[:, inside]
        bottom, middle, top = curves
        ax.axhline(0.0, color="#7f7f7f", linewidth=0.8, zorder=1)
        shown_at = distance[inside]
        ax.fill_between(shown_at, bottom, top, color=colour, alpha=0.25, linewidth=0, zorder=2)
        ax.plot(
            shown_at, middle, color=colour, linewidth=2.0, label="posterior, 90 % band", zorder=3
        )
        shown = [curves]
        if name == "net" and len(radial) > 1:
            number = float(kernels["neighbors"].sel(quantile=0.5))
            for place, part in enumerate(radial):
                middle, word = kernels[part].sel(quantile=0.5).to_numpy()[inside], part
                if kernels.attrs.get(f"{part}_over_neighbors") == "sum":
                    middle, word = number * middle, f"{part} by {number:.2g} neighbours"
                style = KERNEL_COLOURS.get(part, f"C{place}")
                shown.append(middle[None])
                ax.plot(shown_at, middle, "--", color=style, linewidth=1.1, alpha=0.8, label=word)
        if truth is not None and name in truth:
            true = truth[name].to_numpy()[inside]
            ax.plot(shown_at, true, color=colour_of("truth"), linewidth=1.2, label="truth")
            shown.append(true[None])
        bottom = min(0.0, *(float(np.nanmin(c, initial=0.0)) for c in shown))
        top = max(0.0, *(float(np.nanmax(c, initial=0.0)) for c in shown))
        room = 0.08 * ((top - bottom) or 1.0)
        ax.set_ylim(bottom - 2.5 * room, top + room)
        ax.set_xlim(0.0, float(distance[-1]) if np.isinf(high) else 1.02 * high)
        ax.fill_between(
            distance,
            0.0,
            0.13 * dense,
            transform=ax.get_xaxis_transform(),
            color="#7f7f7f",
            alpha=0.35,
            linewidth=0,
            zorder=0,
        )
        ax.set_xlabel(f"distance ({unit})" if unit else "distance", parse_math=False)
        quantity = "force" if name == "net" else "rate of alignment"
        ax.set_ylabel(f"{quantity} ({units(kernels[name])})", parse_math=False)
        ax.set_title(title, fontsize=10)
        legend_below(ax, columns=2)
    if float(kernels["has_preferred_distance"]) > 0.5:
        near, middle, far = kernels["preferred_distance"].transpose("quantile").to_numpy()
        grid[0, 0].axvspan(near, far, color=NET, alpha=0.12, linewidth=0, zorder=0)
        grid[0, 0].axvline(middle, color=NET, linewidth=1.0, linestyle=":", zorder=1)
    return figure, grid[0]


def plot_modulation(kernels: xr.Dataset, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw by how much a neighbour counts, by the angle at which it is seen.

    Parameters
    ----------
    kernels
        What :func:`swarmssm.analysis.interaction_kernels` returned, with ``modulation``.
    ax
        Where to draw; new axes if absent.

    Returns
    -------
    Figure and axes, 0 degrees being ahead.
    """
    figure, ax = new_axes(ax, (5.2, 3.3))
    angle = np.degrees(kernels["angle"].to_numpy())
    low, middle, high = kernels["modulation"].transpose("quantile", "angle").to_numpy()
    ax.axhline(1.0, color="#7f7f7f", linewidth=0.8)
    ax.fill_between(angle, low, high, color=NET, alpha=0.22, linewidth=0)
    ax.plot(angle, middle, color=NET, linewidth=1.8)
    ax.set_xlim(-180, 180)
    ax.set_xticks([-180, -90, 0, 90, 180])
    ax.set_ylim(min(0.0, float(low.min())), 1.1 * max(1.0, float(high.max())))
    ax.set_xlabel("direction of the neighbour from the heading (degrees)")
    ax.set_ylabel("factor")
    return figure, ax


def plot_force_maps(
    maps: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw turning and speeding by where a neighbour is, the model beside the raw data.

    Parameters
    ----------
    maps
        What :func:`swarmssm.analysis.force_maps` returned; or one map of those, without
        the dimension ``source``.
    axes
        Two for each source; new ones if absent.

    Returns
    -------
    Figure and axes ``(2, source)``: turning above (red: to the right), speeding below (red: faster)
    with one scale of colours a row, made for the bins that are sure. The focal individual is the
    triangle, heading up. Bins whose mean is within two standard errors of 0 are faint, those with
    fewer than ten pairs are left out.
    """
    if "source" not in maps.dims:
        maps = maps.expand_dims(source=[str(maps.attrs.get("source", ""))])
    sources = [str(name) for name in maps["source"].to_numpy()]
    figure, grid = new_grid(axes, 2, len(sources), (3.9 * len(sources) + 0.9, 7.2))
    titles = {"model": "model's accelerations", "raw": "raw data"}
    unit = str(maps.attrs.get("unit", ""))
    across, along = (_edges(maps[name].to_numpy()) for name in ("left_right", "front_back"))
    told = f" ({unit})" if unit else ""
    words = {"turning": "turning, right > 0", "speeding": "speeding up > 0"}
    for line, name in zip(grid, ("turning", "speeding"), strict=True):
        values = maps[name].transpose("source", "front_back", "left_right").to_numpy()
        error = maps[f"{name}_error"].transpose("source", "front_back", "left_right").to_numpy()
        count = maps["count"].transpose("source", "front_back", "left_right").to_numpy()
        values = np.where(count >= FEWEST_PAIRS, values, np.nan)
        sure = np.abs(values) > UNSURE * error
        limit = _colour_limit(values, sure)
        beyond = bool((np.abs(values) > limit).any())
        for ax, source, own, firm in zip(line, sources, values, sure, strict=True):
            paint_ground(ax, EMPTY)
            # Faint bins let this through, not the page: they are as faint in the dark.
            ax.imshow(
                np.where(np.isfinite(own), 1.0, np.nan),
                cmap=ListedColormap([NEUTRAL]),
                extent=(across[0], across[-1], along[0], along[-1]),
                origin="lower",
            )
            ax.pcolormesh(
                across,
                along,
                own,
                cmap=DIVERGING,
                vmin=-limit,
                vmax=limit,
                alpha=np.where(firm, 1.0, 0.35),
                linewidth=0,
                rasterized=True,
            )
            ax.plot([0], [0], marker="^", color=DARK, markersize=9, linestyle="")
            ax.set_aspect("equal", adjustable="box")
            ax.set_xlabel(f"left ← neighbour → right{told}", parse_math=False)
            ax.set_ylabel(f"behind ← neighbour → ahead{told}", parse_math=False)
            ax.set_title(f"{name}: {titles.get(source, source)}", fontsize=10)
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        colours = ScalarMappable(Normalize(-limit, limit), DIVERGING)
        ends = "both" if beyond else "neither"
        bar = figure.colorbar(colours, ax=list(line), shrink=0.85, pad=0.02, extend=ends)
        bar.set_label(f"{words[name]} ({units(maps[name])})", parse_math=False)
    return figure, grid


def _colour_limit(values: npt.NDArray[np.float64], sure: npt.NDArray[np.bool_]) -> float:
    """Return the end of a scale for several maps ``(source, ...)`` on which each can be read.

    Bins that are not sure may be far from 0 by chance, and a map far stronger than another would
    leave this one blank: where it is more than so many times as strong, its ends are cut off.
    """
    ends = [
        float(np.quantile(np.abs(own[firm]), SHOWN))
        for own, firm in zip(values, sure, strict=True)
        if firm.any()
    ]
    if ends:
        return min(max(ends), STRONGER * min(ends))
    known = np.abs(values[np.isfinite(values)])
    return (float(np.quantile(known, SHOWN)) if known.size else 0.0) or 1.0


def _edges(middles: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the edges of bins from their middles."""
    half = 0.5 * (middles[1] - middles[0])
    return np.append(middles - half, middles[-1] + half)
