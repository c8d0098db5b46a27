"""Forces on the individuals: how strong over time, which share, and where they point."""

import zlib
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarmssm.analysis.plots.style import dot_size, label_axes, legend_below, new_axes
from swarmssm.analysis.scoring.table import format_number, format_unit

__all__ = ["TERM_COLOURS", "plot_force_arrows", "plot_force_magnitudes", "plot_force_shares"]

#: One colour a term in every figure.
TERM_COLOURS = {
    "cohesion": "#2f86c6",
    "separation": "#cc5f00",
    "alignment": "#009e73",
    "self": "#8a6fc8",
    "other": "#7f7f7f",
}
#: Of forces that only a model of one's own has.
OWN_COLOURS = ("#a0522d", "#c4679b", "#6b8e23", "#b8860b", "#4f6d7a")
#: So many draws are drawn as arrows of their own at most.
FAINT_DRAWS = 20
#: The longest arrow, as a share of the extent of the group.
ARROW = 0.16


def term_colour(term: str) -> str:
    """Return the colour of a force, the same in every figure."""
    return TERM_COLOURS.get(term, OWN_COLOURS[zlib.crc32(term.encode()) % len(OWN_COLOURS)])


def plot_force_magnitudes(
    summary: xr.Dataset, ax: Axes | None = None, *, trial: str | None = None
) -> tuple[Figure, Axes]:
    """Draw the mean strength of each force over time, with 90 % bands.

    Parameters
    ----------
    summary
        What :func:`swarmssm.analysis.force_summary` returned.
    ax
        Where to draw; new axes if absent.
    trial
        Which one; absent, the first.

    Returns
    -------
    Figure and axes. The few highest peaks may leave the axes.
    """
    figure, ax = new_axes(ax, (7.2, 3.8))
    chosen = summary["group_magnitude"]
    chosen = chosen.isel(trial=0) if trial is None else chosen.sel(trial=trial)
    seconds = chosen["time"].to_numpy()
    highest = 0.0
    for term in chosen["term"].to_numpy():
        low, middle, high = chosen.sel(term=term).transpose("quantile", "time").to_numpy()
        colour = term_colour(str(term))
        ax.fill_between(seconds, low, high, color=colour, alpha=0.22, linewidth=0)
        ax.plot(seconds, middle, color=colour, linewidth=1.2, label=str(term))
        for curve, share in ((middle, 0.995), (high, 0.95)):
            known = curve[np.isfinite(curve)]
            if known.size:
                highest = max(highest, float(np.quantile(known, share)))
    ax.set_xlabel("time (s)")
    ax.set_ylabel(f"mean force ({units(chosen)})", parse_math=False)
    ax.set_ylim(0.0, 1.08 * highest if highest > 0 else 1.0)
    if len(seconds) > 1:
        ax.set_xlim(seconds[0], seconds[-1])
    legend_below(ax)
    return figure, ax


def plot_force_shares(summary: xr.Dataset, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw which share of the sum of mean magnitudes each force has, with 90 % intervals.

    Parameters
    ----------
    summary
        What :func:`swarmssm.analysis.force_summary` returned.
    ax
        Where to draw; new axes if absent.

    Returns
    -------
    Figure and axes, a bar for each term.
    """
    figure, ax = new_axes(ax, (5.2, 2.6))
    low, middle, high = 100 * summary["share"].transpose("quantile", "term").to_numpy()
    terms = [str(term) for term in summary["term"].to_numpy()]
    rows = np.arange(len(terms))
    colours = [term_colour(term) for term in terms]
    ax.barh(rows, middle, color=colours, alpha=0.8, height=0.68)
    around = np.nan_to_num([middle - low, high - middle]).clip(min=0)
    ax.errorbar(middle, rows, xerr=around, fmt="none", ecolor="#000000", elinewidth=1.4, capsize=3)
    ax.set_yticks(rows, terms)
    ax.invert_yaxis()
    ax.set_xlim(0.0, 1.15 * float(np.nanmax(high, initial=1.0)))
    ax.set_xlabel("share of the sum of mean magnitudes (%)")
    return figure, ax


def plot_force_arrows(
    forces: xr.Dataset,
    ax: Axes | None = None,
    *,
    trial: str | None = None,
    frame: int = 0,
    terms: tuple[str, ...] = ("cohesion", "separation", "alignment", "self"),
) -> tuple[Figure, Axes]:
    """Draw one frame: where individuals are and head, and the forces on each.

    Parameters
    ----------
    forces
        What :func:`swarmssm.analysis.posterior_forces` returned; of three dimensions
        the first two are drawn.
    ax
        Where to draw; new axes if absent.
    trial
        Which one; absent, the first.
    frame
        Number of the frame, negative from the end.
    terms
        Which forces.

    Returns
    -------
    Figure and axes. Strong arrows are the posterior mean, faint ones single draws; lengths are to
    one scale, which the title gives, and black ticks are headings.
    """
    figure, ax = new_axes(ax, (6.0, 5.6))
    chosen = forces.isel(trial=0) if trial is None else forces.sel(trial=trial)
    chosen = chosen.isel(time=frame)
    place = chosen["position"].mean("draw").transpose("individual", "space").to_numpy()[:, :2]
    velocity = chosen["velocity"].mean("draw").transpose("individual", "space").to_numpy()[:, :2]
    drawn = chosen["force"].sel(term=list(terms))
    own = drawn.transpose("term", "draw", "individual", "space").to_numpy()[..., :2]
    seen = np.isfinite(place).all(-1)
    place, velocity, own = place[seen], velocity[seen], own[:, :, seen]
    mean = own.mean(1)
    length = np.linalg.norm(mean, axis=-1)
    extent = (float(np.ptp(place, axis=0).max()) if len(place) else 0.0) or 1.0
    longest = float(length.max(initial=0.0)) or 1.0
    scale = longest / (ARROW * extent)
    across, up = place[:, 0], place[:, 1]
    arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": scale}
    for term, draws, middle in zip(terms, own, mean, strict=True):
        arrows["color"] = term_colour(term)
        for one in draws[:FAINT_DRAWS] if len(draws) > 1 else []:
            ax.quiver(across, up, one[:, 0], one[:, 1], alpha=0.12, width=0.003, zorder=2, **arrows)
        ax.quiver(
            across, up, middle[:, 0], middle[:, 1], width=0.0065, zorder=3, label=term, **arrows
        )
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    heading = np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 0)
    reach = 0.045 * extent
    for start, toward in zip(place, heading, strict=True):
        end = start + reach * toward
        ax.plot(*zip(start, end, strict=True), color="#000000", linewidth=1.6, zorder=4)
    ax.scatter(across, up, s=dot_size(len(place), 34.0), c="#000000", linewidths=0, zorder=5)
    label_axes(ax, forces["space"].to_numpy(), forces.attrs)
    # No mean arrow is cut off, and few of the draws, which may be longer.
    room = 1.3 * ARROW * extent
    for corner in (place - room, place + room) if len(place) else ():
        ax.update_datalim(corner)
    ax.margins(0.0)
    ax.autoscale_view()
    length_of_it = f"{format_number(longest, 2)} {units(forces['force'])}"
    ax.set_title(
        f"{float(chosen['time']):.3g} s; longest arrow {length_of_it}",
        fontsize=10,
        parse_math=False,
    )
    legend_below(ax)
    return figure, ax


def units(values: xr.DataArray) -> str:
    """Return the units of values as they are written in a figure."""
    return format_unit(str(values.attrs.get("units", "")))
