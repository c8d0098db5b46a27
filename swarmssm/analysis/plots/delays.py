"""Who turns first: delays between the directions of individuals."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarmssm.analysis.interpretation.tables import drawn_pairs
from swarmssm.analysis.plots.style import individual_colours, legend_below, new_grid

__all__ = ["plot_delays"]

#: Individuals whose names are written beside their leads at most.
MANY = 40


def plot_delays(
    delays: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw how well directions agree at each delay, and with which delay the others follow.

    Parameters
    ----------
    delays
        What :func:`swarmssm.analysis.leadership_delays` returned.
    axes
        Two axes; new ones if absent.

    Returns
    -------
    Figure and axes ``(2,)``: the correlation of the ten pairs whose directions agree best against
    the delay with which the first follows the second, and for each individual the mean delay with
    which the others follow, with 90 % intervals over resampled blocks of time.
    """
    figure, grid = new_grid(axes, 1, 2, (8.4, 3.8))
    axes = grid.ravel()
    _draw_correlations(delays, axes[0])
    _draw_leads(delays, axes[1])
    return figure, axes


def _draw_correlations(delays: xr.Dataset, ax: Axes) -> None:
    """Draw the correlation of pairs against the delay."""
    pairs = drawn_pairs(delays)
    for (one, other), colour in zip(pairs, individual_colours(len(pairs)), strict=True):
        correlation = delays["correlation"].sel(individual=one, neighbor=other)
        ax.plot(delays["delay"], correlation, color=colour, label=f"{one} follows {other}")
    ax.axvline(0.0, color="#7f7f7f", linewidth=0.8, linestyle=":")
    ax.set_xlabel("delay (s)")
    ax.set_ylabel("correlation of directions")
    ax.set_title("pairs that agree best", fontsize=10)
    if pairs:
        legend_below(ax)


def _draw_leads(delays: xr.Dataset, ax: Axes) -> None:
    """Draw the mean delay with which others follow, an individual a row."""
    lead = delays["lead"].to_numpy()
    low, high = (delays["lead_interval"].sel(quantile=q).to_numpy() for q in (0.05, 0.95))
    order = np.argsort(np.where(np.isnan(lead), -np.inf, lead))
    rows = np.arange(len(lead))
    ax.hlines(rows, low[order], high[order], color="#2f86c6", linewidth=1.6)
    ax.plot(lead[order], rows, "o", color="#2f86c6", markersize=5)
    ax.axvline(0.0, color="#7f7f7f", linewidth=0.8, linestyle=":")
    names = np.array([str(name) for name in delays["individual"].to_numpy()])
    if len(names) <= MANY:
        ax.set_yticks(rows, names[order], parse_math=False)
    else:
        ax.set_yticks([])
    ax.set_xlabel("mean delay with which the others follow (s)")
    ax.set_title("who turns first", fontsize=10)
