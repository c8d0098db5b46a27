"""Figures of a backtest: scores and coverage over how far ahead a forecast is."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarmssm.analysis.plots.style import (
    LINE_STYLES,
    colour_of,
    legend_below,
    log_scale,
    new_axes,
)
from swarmssm.analysis.scoring.differences import score_intervals
from swarmssm.analysis.scoring.table import format_unit

__all__ = ["plot_forecast_coverage", "plot_scores"]

#: Of several fits; the first is the model's own colour of all figures.
FITS = ("#2f86c6", "#c4679b", "#8a6fc8", "#a0522d", "#6b8e23", "#5c7fb8")
TITLES = {
    "log_score": ("log score of positions", "higher is better"),
    "crps": ("CRPS of positions", "lower is better"),
    "energy_score": ("energy score of positions", "lower is better"),
    "mse": ("squared error of the mean", "lower is better"),
    "coverage": ("share of positions inside", ""),
    "width": ("width of the interval", ""),
}
#: Values that differ by more than this ratio are drawn on a logarithmic scale.
RATIO = 5.0


def plot_scores(
    scores: xr.Dataset, score: str = "crps", ax: Axes | None = None, *, level: float = 0.9
) -> tuple[Figure, Axes]:
    """Draw the mean score of each model over how far ahead it forecasts, with 90 % intervals.

    The intervals are those of each mean by itself, by the moving-block bootstrap; what makes frames
    hard for all is in them. Whether two models differ is told by
    :func:`swarmssm.analysis.scoring.paired_difference`. What is infinite is left out.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    score
        ``"log_score"``, ``"crps"``, ``"energy_score"``, ``"mse"``, ``"coverage"`` or ``"width"``.
    ax
        Axes; new ones if absent.
    level
        Of the interval, for the last two.

    Returns
    -------
    Figure and axes.

    Raises
    ------
    InputError
        If there is no such score or level.
    """
    found = score_intervals(scores, score, level)
    figure, ax = new_axes(ax)
    ahead = found["ahead"].to_numpy()
    fits = 0
    for index, name in enumerate(str(model) for model in found["model"].values):
        low, middle, high = found.isel(model=index).to_numpy().T
        middle = np.where(np.isfinite(middle), middle, np.nan)
        rival = name in LINE_STYLES
        colour = colour_of(name) if rival else FITS[fits % len(FITS)]
        fits += not rival
        title = str(found["title"].values[index])
        style = LINE_STYLES.get(name, "-")
        ax.plot(ahead, middle, style, color=colour, marker="o", markersize=3, label=title)
        told = np.isfinite(low) & np.isfinite(high)
        if told.any():
            ax.fill_between(ahead[told], low[told], high[told], color=colour, alpha=0.15, lw=0)
    words, direction = TITLES[score]
    unit = format_unit(str(found.attrs["units"]))
    if score == "log_score":
        unit = "nats per coordinate"
    if score == "coverage":
        words, unit = f"{words} the {100 * level:.0f} % interval", ""
    label = words + (f" ({unit})" if unit else "") + (f"\n{direction}" if direction else "")
    ax.set_ylabel(label, parse_math=False)
    ax.set_xlabel("time ahead (s)")
    drawn = found.sel(quantile=0.5).to_numpy()
    drawn = drawn[np.isfinite(drawn)]
    positive = score not in ("log_score", "coverage") and drawn.size and drawn.min() > 0
    if positive and drawn.max() > RATIO * drawn.min():
        log_scale(ax)
    legend_below(ax)
    return figure, ax


def plot_forecast_coverage(
    scores: xr.Dataset, level: float = 0.9, ax: Axes | None = None
) -> tuple[Figure, Axes]:
    """Draw how much of what came was inside each model's intervals, beside what they promise.

    Below the line a model is surer than it should be, above it less sure than it could be.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    level
        Of the interval.
    ax
        Axes; new ones if absent.

    Returns
    -------
    Figure and axes.

    Raises
    ------
    InputError
        If there is no such level.
    """
    figure, ax = plot_scores(scores, "coverage", ax, level=level)
    ax.axhline(level, color="#7f7f7f", linewidth=1.0, zorder=0)
    ax.set_ylim(max(-0.02, min(level - 0.2, ax.get_ylim()[0])), 1.02)
    return figure, ax
