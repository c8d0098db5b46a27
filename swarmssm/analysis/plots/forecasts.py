"""Forecasts with their fans: in space, and each coordinate over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch

from swarmssm.analysis.plots.style import (
    MODEL_COLOUR,
    colour_of,
    individual_colours,
    label_axes,
    new_axes,
    new_grid,
)
from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["plot_forecast", "plot_forecast_over_time"]

#: Individuals and draws that are drawn by default.
MOST, FEW, DRAWS = 10, 3, 30
FAINT = "#7f7f7f"


def plot_forecast(
    fan: xr.Dataset,
    ax: Axes | None = None,
    *,
    trial: str | None = None,
    individuals: Sequence[str] | None = None,
    steps: Sequence[int] | None = None,
    draws: int = DRAWS,
    title: str | None = None,
) -> tuple[Figure, Axes]:
    """Draw where each individual came from, where it may go, and where it went.

    Parameters
    ----------
    fan
        What :func:`swarmssm.analysis.scoring.forecast_fans.forecast_fan` returned.
    ax
        Where to draw; new axes if absent.
    trial
        Label; default the first.
    individuals
        Labels; default the first ten that are forecast.
    steps
        Steps ahead at which ellipses are drawn; default the last.
    draws
        How many sampled paths to draw; 0 for none.
    title
        Default: from when, and how far ahead.

    Returns
    -------
    Figure and axes: a grey line for the history, a dot where the forecast begins; thin lines in
    the individual's colour for draws, ellipses that hold the shares of them that the levels say;
    the truth as a line of the page's ink, with a cross where it was last seen.

    Raises
    ------
    InputError
        If a label or a step is unknown.
    """
    part, names = _part(fan, trial, individuals, MOST)
    chosen = [int(fan["step"][-1])] if steps is None else [int(step) for step in steps]
    strange = [step for step in chosen if step not in fan["step"].values]
    if strange:
        raise InputError(
            f"steps: the forecast has no step {strange[0]}; it has 1 to {int(fan['step'][-1])}."
        )
    figure, ax = new_axes(ax, (5.2, 5.2))
    start = part["history"].isel(before=-1)
    truth = colour_of("truth")
    for name, colour in zip(names, individual_colours(len(names)), strict=True):
        one = part.sel(individual=name)
        past = _plane(one["history"], "before")
        begin = _plane(start.sel(individual=name), None)
        ax.plot(past[:, 0], past[:, 1], color=FAINT, linewidth=1.2, alpha=0.8, zorder=2)
        paths = _plane(one["draws"].isel(draw=slice(0, draws)), "draw", "step")
        lines = [np.vstack([begin, path]) for path in paths]
        ax.add_collection(LineCollection(lines, colors=colour, linewidths=0.6, alpha=0.3, zorder=1))
        for step in chosen:
            for patch in _ellipses(one.sel(step=step), colour):
                ax.add_patch(patch)
        came = np.vstack([begin, _plane(one["observed"], "step")])
        ax.plot(came[:, 0], came[:, 1], color=truth, linewidth=1.3, zorder=4)
        known = came[np.isfinite(came).all(axis=-1)]
        if len(known) > 1:
            ax.plot(*known[-1], "x", color=truth, markersize=5, zorder=4)
        ax.plot(*begin, "o", color=colour, markersize=4.5, zorder=5)
    ax.autoscale_view()
    label_axes(ax, fan["space"].to_numpy(), fan.attrs)
    if title is None:
        seconds = float(fan["ahead"].sel(step=chosen[-1]))
        title = f"{seconds:.3g} s ahead from {float(part['start']):.4g} s"
        left = fan.sizes["individual"] - len(names)
        title += f", {len(names)} of {fan.sizes['individual']}" if left else ""
    ax.set_title(title, fontsize=10)
    _legend(ax, fan, draws)
    return figure, ax


def plot_forecast_over_time(
    fan: xr.Dataset,
    axes: npt.NDArray[Any] | None = None,
    *,
    trial: str | None = None,
    individuals: Sequence[str] | None = None,
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw each coordinate of some individuals over time, with the fan of its forecast.

    Parameters
    ----------
    fan
        What :func:`swarmssm.analysis.scoring.forecast_fans.forecast_fan` returned.
    axes
        One for each individual and coordinate; new ones if absent.
    trial
        Label; default the first.
    individuals
        Labels; default the first three that are forecast.

    Returns
    -------
    Figure and axes ``(individual, space)``: in the page's ink what was and came, in colour the
    median of the draws and a band for each level.

    Raises
    ------
    InputError
        If a label is unknown.
    """
    part, names = _part(fan, trial, individuals, FEW)
    spaces = [str(name) for name in fan["space"].values]
    rows, columns = len(names), len(spaces)
    size = (3.9 * columns, 1.7 * rows + 0.9)
    figure, grid = new_grid(axes, rows, columns, size, sharex=True)
    ahead, behind = part["ahead"].to_numpy(), part["behind"].to_numpy()
    levels = sorted((float(level) for level in fan["level"].values), reverse=True)
    truth, unit = colour_of("truth"), str(fan.attrs.get("unit", ""))
    for line, name in zip(grid, names, strict=True):
        for ax, space in zip(line, spaces, strict=True):
            one = part.sel(individual=name, space=space)
            for level, shade in zip(levels, _shades(len(levels)), strict=True):
                low, high = (one[end].sel(level=level) for end in ("low", "high"))
                ax.fill_between(ahead, low, high, color=MODEL_COLOUR, alpha=shade, linewidth=0)
            ax.plot(ahead, one["median"], color=MODEL_COLOUR, linewidth=1.4)
            past, came = one["history"].to_numpy(), one["observed"].to_numpy()
            ax.plot(
                np.concatenate([behind, ahead]),
                np.concatenate([past, came]),
                color=truth,
                linewidth=1.1,
            )
            ax.axvline(0.0, color=FAINT, linewidth=0.8, zorder=0)
            ax.set_ylabel(f"{space} of {name}" + (f" ({unit})" if unit else ""), parse_math=False)
    for ax in grid[-1]:
        ax.set_xlabel("time ahead (s)")
    handles = [
        Line2D([], [], color=truth, linewidth=1.1, label="observed"),
        Line2D([], [], color=MODEL_COLOUR, linewidth=1.4, label="median"),
        *(
            Patch(color=MODEL_COLOUR, alpha=shade, linewidth=0, label=f"{100 * level:.0f} %")
            for level, shade in zip(levels, _shades(len(levels)), strict=True)
        ),
    ]
    if axes is None:
        figure.align_ylabels(grid)
        figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure, grid


def _part(
    fan: xr.Dataset, trial: str | None, individuals: Sequence[str] | None, most: int
) -> tuple[xr.Dataset, list[str]]:
    """Return one trial, and the labels of the individuals to draw."""
    labels = [str(label) for label in fan["trial"].values]
    if trial is not None and str(trial) not in labels:
        raise InputError(f"trial: there is no {str(trial)!r}; there are {', '.join(labels[:8])}.")
    part = fan.isel(trial=0 if trial is None else labels.index(str(trial)))
    everyone = [str(name) for name in fan["individual"].values]
    if individuals is None:
        forecast = part["median"].notnull().all(("step", "space")).to_numpy()
        chosen = [name for name, there in zip(everyone, forecast, strict=True) if there][:most]
        if not chosen:
            raise InputError(f"fan: in trial {part['trial'].item()} nobody is forecast.")
        return part, chosen
    chosen = [str(name) for name in individuals]
    unknown = [name for name in chosen if name not in everyone]
    if unknown or not chosen:
        said = f"there is no {unknown[0]!r}" if unknown else "none is named"
        raise InputError(f"individuals: {said}; there are {', '.join(everyone[:10])}.")
    return part, chosen


def _plane(values: xr.DataArray, *dims: str | None) -> Array:
    """Return the first two coordinates, the given dimensions before them."""
    order = [dim for dim in dims if dim is not None]
    array: Array = values.transpose(*order, "space").to_numpy()
    return array[..., :2]


def _ellipses(one: xr.Dataset, colour: str) -> list[Ellipse]:
    """Return the ellipses of one individual at one step, the widest first."""
    covariance = one["covariance"].transpose("plane", "axis").to_numpy()
    if not np.isfinite(covariance).all():
        return []
    spread, axes = np.linalg.eigh(covariance)
    width, height = 2.0 * np.sqrt(np.maximum(spread[::-1], 0.0))
    angle = float(np.degrees(np.arctan2(axes[1, -1], axes[0, -1])))
    center = one["center"].to_numpy()
    reach = np.sort(one["reach"].to_numpy())[::-1]
    return [
        Ellipse(
            (center[0], center[1]),
            width * far,
            height * far,
            angle=angle,
            facecolor=colour,
            edgecolor=colour,
            alpha=0.22,
            linewidth=0.8,
            zorder=1.5,
        )
        for far in reach
    ]


def _shades(count: int) -> list[float]:
    """Return how opaque bands are, the widest first."""
    return [float(shade) for shade in np.linspace(0.18, 0.4, count)]


def _legend(ax: Axes, fan: xr.Dataset, draws: int) -> None:
    """Say what is what, below."""
    truth = colour_of("truth")
    levels = ", ".join(f"{100 * float(level):.0f} %" for level in np.sort(fan["level"].values))
    handles: list[Any] = [
        Line2D([], [], color=FAINT, linewidth=1.2, label="before"),
        Line2D([], [], color=truth, marker="x", linewidth=1.3, markersize=5, label="what came"),
        Patch(facecolor=MODEL_COLOUR, alpha=0.35, label=f"ellipses of {levels}"),
    ]
    if draws:
        handles.insert(2, Line2D([], [], color=MODEL_COLOUR, linewidth=0.8, label="draws"))
    ax.legend(
        handles=handles,
        frameon=False,
        fontsize=9,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.14),
        ncols=4,
    )
