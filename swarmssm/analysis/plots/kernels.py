"""What neighbours do: kernels of distance, and maps around a focal individual."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
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
#: Bins of a map with too few pairs, and the middle of its scale of colours.
EMPTY, NEUTRAL = "#c8c8c8", "#f7f7f7"
#: Where fewer neighbours are than this share of the highest density, curves fade out.
FADES_BELOW = 0.2
#: The axes are made for distances at which there are neighbours, to this share of the most.
SHOWN_FROM = 0.02
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
    Figure and axes ``(2,)``. Bands are 90 % intervals and fade where there are hardly any
    neighbours, whose distances are the grey hills below; the axes are made for the distances
    between the 1st and the 99th percentile. A dotted line marks the preferred distance, shaded
    with its interval.
    """
    figure, grid = new_grid(axes, 1, 2, (9.6, 3.9))
    distance = kernels["distance"].to_numpy()
    unit = str(kernels.attrs.get("unit", ""))
    density = kernels["density"].to_numpy()
    dense = density / max(float(density.max()), 1e-300)
    alpha = np.clip(dense / FADES_BELOW, 0.0, 1.0)
    low, high = (kernels.attrs.get(f"believed_{end}") for end in ("from", "to"))
    inside = (distance >= (low or 0.0)) & (distance <= (np.inf if high is None else high))
    inside &= dense > SHOWN_FROM
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
        curves = kernels[name].transpose("quantile", "distance").to_numpy()
        ax.axhline(0.0, color="#7f7f7f", linewidth=0.8, zorder=1)
        _faded_band(ax, distance, curves, alpha, colour)
        ax.plot([], [], color=colour, linewidth=2.0, label="posterior, 90 % band")
        shown = [curves[:, inside]]
        if name == "net" and len(radial) > 1:
            number = float(kernels["neighbors"].sel(quantile=0.5))
            for place, part in enumerate(radial):
                middle, word = kernels[part].sel(quantile=0.5).to_numpy(), part
                if kernels.attrs.get(f"{part}_over_neighbors") == "sum":
                    middle, word = number * middle, f"{part} by {number:.2g} neighbours"
                style = KERNEL_COLOURS.get(part, f"C{place}")
                ax.plot(distance, middle, "--", color=style, linewidth=1.1, alpha=0.8, label=word)
        if truth is not None and name in truth:
            true = truth[name].to_numpy()
            ax.plot(truth["distance"], true, color=colour_of("truth"), linewidth=1.2, label="truth")
            shown.append(true[None, inside])
        bottom = min(0.0, *(float(np.nanmin(c, initial=0.0)) for c in shown))
        top = max(0.0, *(float(np.nanmax(c, initial=0.0)) for c in shown))
        room = 0.08 * ((top - bottom) or 1.0)
        ax.set_ylim(bottom - 2.5 * room, top + room)
        ax.set_xlim(0.0, float(distance[-1]))
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
        ax.set_ylabel(
            f"{'force' if name == 'net' else 'g'} ({units(kernels[name])})", parse_math=False
        )
        ax.set_title(title, fontsize=10)
        legend_below(ax)
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
                cmap="RdBu_r",
                vmin=-limit,
                vmax=limit,
                alpha=np.where(firm, 1.0, 0.35),
                linewidth=0,
                rasterized=True,
            )
            ax.plot([0], [0], marker="^", color=DARK, markersize=9, linestyle="")
            ax.set_aspect("equal", adjustable="box")
            ax.set_xlabel(f"left – right ({unit})" if unit else "left – right", parse_math=False)
            ax.set_ylabel(f"back – front ({unit})" if unit else "back – front", parse_math=False)
            ax.set_title(f"{name}: {titles.get(source, source)}", fontsize=10)
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        colours = ScalarMappable(Normalize(-limit, limit), "RdBu_r")
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


def _faded_band(
    ax: Axes,
    distance: npt.NDArray[np.float64],
    curves: npt.NDArray[np.float64],
    alpha: npt.NDArray[np.float64],
    colour: str,
) -> None:
    """Draw a band and its middle, fainter where there are few data."""
    low, middle, high = curves
    red, green, blue, _ = to_rgba(colour)
    # A picture that fades from left to right, cut out along the band.
    fine = np.linspace(distance[0], distance[-1], 400)
    shade = np.empty((1, len(fine), 4))
    shade[..., :3] = red, green, blue
    shade[..., 3] = 0.3 * np.interp(fine, distance, alpha)
    outline = np.concatenate([np.stack([distance, low], -1), np.stack([distance, high], -1)[::-1]])
    band = Polygon(outline, facecolor="none", edgecolor="none")
    ax.add_patch(band)
    bottom, top = float(low.min()), float(high.max())
    # A band without any width is still a picture with some.
    room = 1e-6 * max(abs(bottom), abs(top), 1e-6)
    extent = (distance[0], distance[-1], bottom - room, top + room)
    picture = ax.imshow(
        shade, extent=extent, aspect="auto", origin="lower", interpolation="bilinear", zorder=2
    )
    picture.set_clip_path(band)
    points = np.stack([distance, middle], -1)
    faces = [(red, green, blue, float(own)) for own in 0.5 * (alpha[1:] + alpha[:-1])]
    pieces = np.stack([points[:-1], points[1:]], 1)
    ax.add_collection(
        LineCollection(list(pieces), colors=faces, linewidths=2.0, capstyle="butt", zorder=3)
    )


def _edges(middles: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the edges of bins from their middles."""
    half = 0.5 * (middles[1] - middles[0])
    return np.append(middles - half, middles[-1] + half)
