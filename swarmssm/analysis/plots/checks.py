"""Figures of posterior predictive checks: the recording over the band of its replicates."""

from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from swarmssm.analysis.diagnostics.checks.result import LEVEL
from swarmssm.analysis.plots.style import (
    INDIVIDUALS,
    colour_of,
    figure_of,
    legend_below,
    new_axes,
    new_grid,
)
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.analysis.scoring.table import format_number, format_unit
from swarmssm.errors import InputError
from swarmssm.metrics.states import STATES

__all__ = [
    "plot_check_overview",
    "plot_order_parameters",
    "plot_pit",
    "plot_statistic",
    "plot_statistics",
]

COLUMNS = 4
#: The recording, the replicates of the model, and what is neither.
RECORDING, REPLICATES, BAND = colour_of("truth"), colour_of(""), "#7f7f7f"
VERDICT_COLOURS = {
    "consistent": colour_of("truth"),
    "borderline": "#b8860b",
    "mismatch": "#cc5f00",
    "unknown": BAND,
}
#: Beyond this standardised distance a dot stands at the edge, as an arrow.
FARTHEST = 8.0
#: Curves that rise over more than this factor have logarithmic axes.
DECADES = 30.0


def plot_check_overview(checked: xr.Dataset, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw the recording among its replicates, a row for each statistic.

    Distances are from the median of the replicates, so that 90 % of them are within the bar.
    Of numbers they have a side; histograms and curves are far in one direction only.

    Parameters
    ----------
    checked
        ``data`` of :func:`swarmssm.analysis.diagnostics.checks.check`.
    ax
        Where to draw; new axes if absent.

    Returns
    -------
    Figure and axes: the farthest at the top; an arrow is farther than the axis.
    """
    order = np.argsort(-np.nan_to_num(np.abs(checked["place"].to_numpy()), nan=-1.0), kind="stable")
    one = checked.isel(statistic=order)
    names = one["title"].to_numpy().astype(str)
    figure, ax = new_axes(ax, (6.9, 1.3 + 0.27 * len(names)))
    rows = np.arange(len(names))
    bars = quantiles(one["place_replicated"].to_numpy())
    bars = np.clip(np.nan_to_num(bars), -FARTHEST, FARTHEST)
    width = bars[2] - bars[0]
    ax.barh(rows, width, left=bars[0], height=0.62, color=REPLICATES, alpha=0.3, linewidth=0)
    place = one["place"].to_numpy()
    shown = np.clip(place, -FARTHEST, FARTHEST)
    for verdict, colour in VERDICT_COLOURS.items():
        for far, mark in ((False, "o"), (True, "")):
            chosen = (one["verdict"].to_numpy() == verdict) & ((np.abs(place) > FARTHEST) == far)
            for row in rows[chosen & np.isfinite(place)]:
                sign = ">" if place[row] > 0 else "<"
                ax.plot(shown[row], row, mark or sign, color=colour, markersize=6.0, clip_on=False)
    ax.axvline(0.0, color=BAND, linewidth=0.8, zorder=0)
    ax.set_yticks(rows, list(names), parse_math=False)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlim(-FARTHEST - 0.4, FARTHEST + 0.4)
    ax.set_xlabel("standardised distance from the replicates (90 % of these in the bar)")
    for row, p_value, verdict in zip(
        rows, one["p_value"].to_numpy(), one["verdict"].to_numpy(), strict=True
    ):
        text = "" if np.isnan(p_value) else f"p = {_p(p_value)}  {verdict}"
        ax.annotate(
            text, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=8,
            color=VERDICT_COLOURS[str(verdict)] if verdict != "consistent" else BAND,
        )  # fmt: skip
    ax.tick_params(axis="y", length=0)
    return figure, ax


def plot_statistics(
    checked: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw every statistic, see :func:`plot_statistic`.

    Parameters
    ----------
    checked
        ``data`` of :func:`swarmssm.analysis.diagnostics.checks.check`.
    axes
        As many as statistics, rounded up to whole rows; new ones if absent.

    Returns
    -------
    Figure and axes ``(row, column)``, those that are left over turned off.
    """
    names = [str(name) for name in checked["statistic"].values]
    shape = () if axes is None else np.asarray(axes).shape
    columns = shape[-1] if shape else min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    figure, grid = new_grid(axes, rows, columns, (3.2 * columns, 2.6 * rows + 0.2))
    for ax, name in zip(grid.flat, names, strict=False):
        plot_statistic(checked, name, ax)
        ax.tick_params(labelsize=8)
        ax.xaxis.label.set_size(8)
        ax.yaxis.label.set_size(8)
        ax.title.set_size(9)
    for ax in list(grid.flat)[len(names) :]:
        ax.set_axis_off()
    return figure, grid


def plot_statistic(checked: xr.Dataset, name: str, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw a statistic of the recording over those of its replicates.

    A number is a line in a histogram of the replicates'; a curve or a histogram a line over the
    middle and the central 90 % of the replicates' at each point; a map is the difference between
    the recording and the mean of the replicates.

    Parameters
    ----------
    checked
        ``data`` of :func:`swarmssm.analysis.diagnostics.checks.check`.
    name
        Of the statistic.
    ax
        Where to draw; new axes if absent.

    Raises
    ------
    InputError
        If there is no such statistic, or it has more than two axes.
    """
    if name not in checked["statistic"].values:
        raise InputError(
            f"name: {name!r} is none of the checked statistics, which are "
            f"{', '.join(map(str, checked['statistic'].values))}."
        )
    figure, ax = new_axes(ax, (4.6, 3.3))
    own, drawn = checked[f"{name}_observed"], checked[f"{name}_replicated"]
    draw = [_plot_number, _plot_curve, _plot_map]
    if own.ndim >= len(draw):
        raise InputError(f"name: {name} has {own.ndim} axes; at most two can be drawn.")
    draw[own.ndim](ax, own, drawn)
    one = checked.sel(statistic=name)
    verdict = str(one["verdict"].item())
    mark = "" if np.isnan(one["p_value"]) else f"\n{verdict}, p = {_p(float(one['p_value']))}"
    ax.set_title(f"{own.attrs['long_name']}{mark}", fontsize=10, parse_math=False)
    if verdict != "consistent":
        ax.title.set_color(VERDICT_COLOURS[verdict])
    return figure, ax


def plot_order_parameters(
    checked: xr.Dataset, run: int = 0, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw order parameters over the time of a run, with the band of 90 % of the replicates.

    Parameters
    ----------
    checked
        ``data`` of :func:`swarmssm.analysis.diagnostics.checks.check`.
    run
        Which.
    axes
        As many as there are order parameters; new ones if absent.

    Returns
    -------
    Figure and axes ``(series,)``.

    Raises
    ------
    InputError
        If there is no such run.
    """
    if not 0 <= run < checked.sizes["run"]:
        raise InputError(f"run: there are {checked.sizes['run']}, counted from 0, not {run}.")
    one = checked.isel(run=run)
    there = one["series_observed"].notnull().any("step").to_numpy()
    known = one["series"].to_numpy()[there]
    figure, grid = new_grid(axes, len(known), 1, (6.8, 1.7 * len(known) + 0.6), sharex=True)
    ahead = one["ahead"].to_numpy()
    for ax, name in zip(grid.flat, known, strict=True):
        low, middle, high = one["series_replicated"].sel(series=name).to_numpy()
        band = {"color": REPLICATES, "alpha": 0.3, "linewidth": 0}
        ax.fill_between(ahead, low, high, label="90 % of replicates", **band)
        ax.plot(ahead, middle, color=REPLICATES, linewidth=1.0, label="their median")
        own = one["series_observed"].sel(series=name).to_numpy()
        ax.plot(ahead, own, color=RECORDING, linewidth=1.2, label="recording")
        unit = format_unit(str(one["series_units"].sel(series=name).item()))
        title = "AMD" if str(name) == "amd" else str(name).replace("_", " ")
        ax.set_ylabel(f"{title} ({unit})" if unit else title, parse_math=False)
        if not unit:
            ax.set_ylim(-0.02, 1.02)
    grid.flat[-1].set_xlabel("time since the start of the run (s)")
    if axes is None:
        handles = grid.flat[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper right", ncols=3, frameon=False, fontsize=9)
    return figure, grid.ravel()


def plot_pit(pit: xr.Dataset, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw how far the distribution of PITs is from uniform, with the band of 95 %.

    A line above zero on the left and below on the right shows forecasts that are too narrow, the
    reverse ones that are too wide; a line on one side of zero shows biased forecasts.

    Parameters
    ----------
    pit
        ``data`` of :func:`swarmssm.analysis.diagnostics.checks.one_step_pit`.
    ax
        Where to draw; new axes if absent.
    """
    figure, ax = new_axes(ax)
    points = pit["point"].to_numpy()
    low, high = (pit[f"ecdf_{end}"].to_numpy() - points for end in ("low", "high"))
    level = float(pit.attrs["band_level"])
    ax.fill_between(
        points,
        low,
        high,
        color=BAND,
        alpha=0.3,
        linewidth=0,
        label=f"{100 * level:.0f} % band, whole line",
    )
    ax.axhline(0.0, color=BAND, linewidth=0.8)
    for index, name in enumerate(pit["parameter"].to_numpy().astype(str)):
        one = pit.sel(parameter=name)
        mark = "" if bool(one["passes"]) else " (outside)"
        colour = INDIVIDUALS[index % len(INDIVIDUALS)]
        ax.plot(points, one["ecdf"] - points, color=colour, linewidth=1.6, label=f"{name}{mark}")
    ax.set_xlim(0.0, 1.0)
    ax.set_xlabel("PIT: probability of smaller values in the forecast")
    ax.set_ylabel("share of observations below, minus uniform")
    legend_below(ax)
    return figure, ax


def _plot_number(ax: Axes, own: xr.DataArray, drawn: xr.DataArray) -> None:
    values = drawn.to_numpy()
    values = values[np.isfinite(values)]
    if values.size:
        ax.hist(values, bins=min(25, max(8, values.size // 6)), color=REPLICATES, alpha=0.4)
    if np.isfinite(own):
        ax.axvline(float(own), color=RECORDING, linewidth=2.2)
    ax.set_xlabel(_label("", own.attrs["units"]), parse_math=False)
    ax.set_ylabel("replicates")


def _plot_curve(ax: Axes, own: xr.DataArray, drawn: xr.DataArray) -> None:
    axis = own[own.dims[0]]
    places = axis.to_numpy()
    values = own.to_numpy()
    low, middle, high = quantiles(drawn.to_numpy())
    bars = own.attrs["kind"] == "histogram"
    states = str(axis.attrs["long_name"]) == ", ".join(STATES)
    if states:
        ax.bar(places, high - low, bottom=low, width=0.7, color=REPLICATES, alpha=0.4)
        ax.plot(places, values, "o", color=RECORDING, markersize=6.0)
        ax.set_xticks(places, list(STATES), rotation=20)
    else:
        step: Literal["mid"] | None = "mid" if bars else None
        ax.fill_between(places, low, high, color=REPLICATES, alpha=0.35, linewidth=0, step=step)
        line: dict[str, Any] = {"drawstyle": "steps-mid"} if bars else {}
        ax.plot(places, middle, color=REPLICATES, linewidth=1.0, **line)
        ax.plot(places, values, color=RECORDING, linewidth=1.4, **line)
        ax.set_xlabel(_label(axis.attrs["long_name"], axis.attrs["units"]), parse_math=False)
        positive = values[values > 0]
        rises = not bars and len(positive) == len(values) and values.max() > DECADES * values.min()
        if rises and (places > 0).all() and np.nanmin(low, initial=1.0) > 0:
            ax.set_xscale("log")
            ax.set_yscale("log")
            # Within a decade the labels of the smaller ticks lie over each other.
            ax.xaxis.set_minor_formatter(NullFormatter())
    unit = own.attrs["units"]
    ax.set_ylabel("share" if bars else _label("", unit), parse_math=False)


def _plot_map(ax: Axes, own: xr.DataArray, drawn: xr.DataArray) -> None:
    first, second = (own[dim] for dim in own.dims)
    values = drawn.to_numpy()
    known = values[np.isfinite(values).all((1, 2))]
    difference = own.to_numpy() - (known.mean(0) if len(known) else 0.0)
    most = float(np.nanmax(np.abs(difference), initial=0.0)) or 1.0
    # The first axis, ahead, goes up; the second, to the left, from right to left.
    image = ax.pcolormesh(
        second.to_numpy(), first.to_numpy(), difference, cmap="PuOr_r", vmin=-most, vmax=most
    )
    ax.invert_xaxis()
    ax.locator_params(nbins=4)
    ax.set_aspect("equal", adjustable="box")
    figure_of(ax).colorbar(image, ax=ax, label="share, minus replicates'", shrink=0.9)
    ax.set_xlabel(_label(second.attrs["long_name"], second.attrs["units"]), parse_math=False)
    ax.set_ylabel(_label(first.attrs["long_name"], first.attrs["units"]), parse_math=False)


def _label(text: str, unit: str) -> str:
    """Return a label with its unit."""
    unit = format_unit(unit)
    if text and unit:
        return f"{text} ({unit})"
    return text or unit


def _p(value: float) -> str:
    return format_number(value, 2) if value < 2 * LEVEL else f"{value:.2f}"
