"""Figures of calibration by simulation: rank histograms, distribution functions, coverage."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from swarmssm.analysis.plots.style import INDIVIDUALS, colour_of, legend_below, new_axes, new_grid
from swarmssm.inference.parameter_labels import short_names

__all__ = ["plot_calibration", "plot_coverage", "plot_ecdf_difference", "plot_rank_histograms"]

COLUMNS = 3
BAND = "#7f7f7f"
WARNING = "#cc5f00"
#: Beyond so many lines only those outside the band have a colour of their own.
LINES = 10


def plot_calibration(
    calibration: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw rank histograms, distribution functions and coverage on one sheet.

    Parameters
    ----------
    calibration
        ``data`` of :func:`swarmssm.analysis.sbc`.
    axes
        Two more than quantities; new ones if absent.

    Returns
    -------
    Figure and axes ``(quantity + 2,)``: the histograms, the distribution functions, the coverage.
    """
    number = calibration.sizes["parameter"]
    figure, grid = new_grid(_sheet(number) if axes is None else axes, 1, number + 2, (0.0, 0.0))
    *histograms, functions, coverage = grid[0]
    plot_rank_histograms(calibration, np.array(histograms))
    plot_ecdf_difference(calibration, functions)
    plot_coverage(calibration, coverage)
    return figure, grid[0]


def _sheet(number: int) -> npt.NDArray[Any]:
    """Return axes of a new figure: one for each quantity, and two below."""
    columns = min(COLUMNS, number)
    rows = -(-number // columns)
    upper, lower = 2.2 * rows + 0.2, max(4.6, 2.0 + 0.4 * number)
    figure = Figure(figsize=(11.0, upper + lower), layout="constrained")
    parts = figure.subfigures(2, 1, height_ratios=[upper, lower], squeeze=False)
    top, bottom = parts.flat
    above = top.subplots(rows, columns, squeeze=False).ravel()
    for ax in above[number:]:
        ax.set_axis_off()
    return np.concatenate([above[:number], bottom.subplots(1, 2)])


def plot_rank_histograms(
    calibration: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw a histogram of ranks for each quantity, with the interval of each bin.

    A hump says that the posterior is too wide, a trough that it is too narrow, a slope that it lies
    to one side. The intervals are those of single bins: of twenty, one may be outside.

    Parameters
    ----------
    calibration
        ``data`` of :func:`swarmssm.analysis.sbc`.
    axes
        As many as quantities; new ones if absent.

    Returns
    -------
    Figure and axes ``(row, column)``, those that are left over turned off.
    """
    names = [str(name) for name in calibration["parameter"].values]
    shape = () if axes is None else np.asarray(axes).shape
    columns = shape[-1] if shape else min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    figure, grid = new_grid(axes, rows, columns, (3.1 * columns, 2.3 * rows + 0.3))
    places = calibration["bin"].to_numpy()
    width = 1.0 / len(places)
    low, high = (calibration[f"histogram_{end}"].to_numpy() for end in ("low", "high"))
    edges = np.append(places - 0.5 * width, 1.0)
    short = short_names(names)
    for ax, name in zip(grid.flat, names, strict=False):
        one = calibration.sel(parameter=name)
        good = bool(one["passes"])
        ax.bar(places, one["histogram"], width=0.92 * width, color=_colour(good))
        ax.stairs(high, edges, baseline=low, fill=True, color=BAND, alpha=0.28, zorder=0)
        ax.plot(places, calibration["expected"], color=BAND, linewidth=1.0)
        mark = "" if good else " (outside)"
        ax.set_title(short[name] + mark, fontsize=9, parse_math=False)
        ax.set_xlim(0.0, 1.0)
        ax.set_xlabel("rank of the truth (share of draws below)", fontsize=8)
        ax.set_ylabel("data sets", fontsize=8)
        ax.tick_params(labelsize=8)
        ax.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    for ax in list(grid.flat)[len(names) :]:
        ax.set_axis_off()
    return figure, grid


def plot_ecdf_difference(calibration: xr.Dataset, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw how far the distribution functions of ranks are from uniform, with their band.

    The band holds the whole of a calibrated quantity's line with the probability
    ``calibration.attrs["band_level"]``. A line above zero on the left and below on the right is a
    posterior that is too narrow, the reverse one that is too wide; one that stays above it is an
    estimate that is too high.

    Parameters
    ----------
    calibration
        ``data`` of :func:`swarmssm.analysis.sbc`.
    ax
        Where to draw; new axes if absent.
    """
    figure, ax = new_axes(ax)
    points = calibration["point"].to_numpy()
    low, high = (calibration[f"ecdf_{end}"].to_numpy() - points for end in ("low", "high"))
    level = float(calibration.attrs["band_level"])
    ax.fill_between(
        points,
        low,
        high,
        color=BAND,
        alpha=0.25,
        linewidth=0,
        label=f"{100 * level:.0f} % band, whole line",
    )
    ax.axhline(0.0, color=BAND, linewidth=0.8)
    names = [str(name) for name in calibration["parameter"].values]
    inside = calibration["passes"].to_numpy().astype(bool)
    many = len(names) > LINES
    short = short_names(names)
    for index, name in enumerate(names):
        plain = many and inside[index]
        ax.plot(
            points,
            calibration["ecdf"].to_numpy()[index] - points,
            color=BAND if plain else INDIVIDUALS[index % len(INDIVIDUALS)],
            linewidth=1.0 if inside[index] else 2.2,
            linestyle="-" if index < len(INDIVIDUALS) or plain else "--",
            label=None if plain else short[name] + ("" if inside[index] else " (outside)"),
        )
    ax.set_xlim(0.0, 1.0)
    ax.set_xlabel("rank of the truth (share of draws below)")
    ax.set_ylabel("share of data sets below, minus uniform")
    legend_below(ax)
    return figure, ax


def plot_coverage(calibration: xr.Dataset, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw how many central intervals of each level hold the truth, with binomial errors.

    Parameters
    ----------
    calibration
        ``data`` of :func:`swarmssm.analysis.sbc`.
    ax
        Where to draw; new axes if absent.

    Returns
    -------
    Figure and axes: a row for each quantity, a colour for each level, whose aim is a dotted line.
    """
    names = [str(name) for name in calibration["parameter"].values]
    figure, ax = new_axes(ax, (6.4, 1.4 + 0.42 * len(names)))
    rows = np.arange(len(names))
    levels = calibration["level"].to_numpy()
    for index, level in enumerate(levels):
        one = calibration.sel(level=level)
        colour = INDIVIDUALS[index % len(INDIVIDUALS)]
        share, low, high = (one[name].to_numpy() for name in _COVERAGE)
        place = rows + 0.15 * (index - 0.5 * (len(levels) - 1))
        ax.axvline(float(one["expected_coverage"]), color=colour, linestyle=":", linewidth=1.2)
        ax.errorbar(
            share,
            place,
            xerr=np.stack([share - low, high - share]),
            fmt="o",
            markersize=3.5,
            color=colour,
            linewidth=1.2,
            label=f"{100 * level:.0f} % intervals",
        )
    ax.set_yticks(rows, list(short_names(names).values()), parse_math=False)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlim(right=1.005)
    ax.set_xlabel("share of intervals that hold the truth")
    legend_below(ax)
    return figure, ax


_COVERAGE = ("coverage", "coverage_low", "coverage_high")


def _colour(good: bool) -> str:
    return colour_of("") if good else WARNING
