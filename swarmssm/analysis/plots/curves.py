"""Scores over time, over epochs and over steps ahead."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from swarmssm.analysis.plots.style import (
    LINE_STYLES,
    colour_of,
    legend_below,
    log_scale,
    new_axes,
    new_grid,
    whole_numbers,
)

__all__ = ["plot_collective", "plot_horizon_errors", "plot_training"]

#: Sizes of a figure of the loss alone, and with one and two errors beside it.
SIZES = ((6.4, 3.4), (8.0, 3.2), (9.6, 3.1))
#: Points that are drawn one by one.
FEW = 3
#: A loss that is so many times the usual range above the lowest is a spike.
SPIKE = 20.0
HORIZON_LABELS = {
    "squared_error": "mean squared error (scaled)",
    "forecast_mse": "MSE (4.2)",
    "forecast_mae": "MAE (4.3)",
}


def plot_collective(
    collective: xr.Dataset, ax: Axes | None = None, *, score: str = "amd", unit: str = ""
) -> tuple[Figure, Axes]:
    """Draw AMD or AVD of free runs over time (figs 4.7, 4.8).

    Parameters
    ----------
    collective
        With ``amd (series, time)``, ``amd_low`` and ``amd_high``, or the same of ``avd``.
    ax
        Where to draw; new axes if absent.
    score
        ``"amd"`` or ``"avd"``.
    unit
        Unit of length.

    Returns
    -------
    Figure and axes: a line a series, with a band for the truth and the model, whose values the axis
    is made for: another line may leave it. Where a run left all bounds there is a gap.
    """
    figure, ax = new_axes(ax)
    seconds = collective["time"].to_numpy()
    highest = 0.0
    for name, title in zip(collective["series"].values, collective["title"].values, strict=True):
        chosen = collective.sel(series=name)
        line = _finite(chosen[score])
        colour = colour_of(str(name))
        banded = str(name) not in ("stay-put", "constant-velocity", "noise-floor")
        if banded:
            low, high = _finite(chosen[f"{score}_low"]), _finite(chosen[f"{score}_high"])
            highest = max(highest, float(np.nanmax(high, initial=0.0)))
            highest = max(highest, float(np.nanmax(line, initial=0.0)))
            ax.fill_between(seconds, low, high, color=colour, alpha=0.18, linewidth=0)
        ax.plot(
            seconds,
            line,
            color=colour,
            linestyle=LINE_STYLES.get(str(name), "-"),
            linewidth=2.0 if banded else 1.4,
            label=str(title),
        )
    ax.set_xlabel("time since the start of the run (s)")
    measure = f"{unit}/s" if score == "avd" else unit
    name = {"amd": "AMD", "avd": "AVD"}[score]
    ax.set_ylabel(f"{name} ({measure})" if unit else name, parse_math=False)
    top = ax.get_ylim()[1]
    ax.set_ylim(0.0, min(top, 1.6 * highest) if highest > 0 else top)
    legend_below(ax)
    return figure, ax


def plot_horizon_errors(
    scores: xr.Dataset, ax: Axes | None = None, *, score: str = "forecast_mse"
) -> tuple[Figure, Axes]:
    """Draw the error at each number of steps ahead (figs 4.11, 4.12).

    Parameters
    ----------
    scores
        With ``score (method, step)`` and the coordinate ``title (method)``.
    ax
        Where to draw; new axes if absent.
    score
        ``"forecast_mse"``, ``"forecast_mae"`` or ``"squared_error"``.

    Returns
    -------
    Figure and axes with a logarithmic error axis; an error of 0 or infinity is a gap.
    """
    figure, ax = new_axes(ax)
    steps = scores["step"].to_numpy()
    for name, title in zip(scores["method"].values, scores["title"].values, strict=True):
        error = _finite(scores[score].sel({"method": name}))
        error = np.where(error > 0, error, np.nan)
        ax.plot(
            steps,
            error,
            color=colour_of(str(name)),
            linestyle=LINE_STYLES.get(str(name), "-"),
            linewidth=1.6,
            label=str(title),
            marker="o" if len(steps) == 1 else None,
        )
    log_scale(ax)
    whole_numbers(ax)
    ax.set_xlabel("steps ahead K")
    ax.set_ylabel(HORIZON_LABELS[score])
    legend_below(ax)
    return figure, ax


def plot_training(
    history: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw the course of training (figs 4.9, 4.10): loss, and MSE and MAE, over epochs.

    Parameters
    ----------
    history
        Over ``epoch``: ``loss``, ``validation_loss``, ``mse``, ``mae``; what is absent is left
        out.
    axes
        As many as there is to draw: one for the loss, and one each for MSE and MAE if they are
        there; new ones if absent.

    Returns
    -------
    Figure and axes ``(1 to 3,)``. Errors have a logarithmic axis. The loss, a negative evidence
    lower bound, has one too as long as it stays above 0, else one that is linear from -1 to 1 and
    logarithmic on both sides. Where single steps leave the usual range by far it leaves the axis.
    """
    told = {"mse": "MSE (4.2)", "mae": "MAE (4.3)"}
    there = [name for name in told if name in history and np.isfinite(history[name]).any()]
    figure, grid = new_grid(axes, 1, 1 + len(there), SIZES[len(there)])
    epochs = history["epoch"].to_numpy()
    loss, *errors = grid[0]
    for name, title, style in (
        ("loss", "training", "-"),
        ("validation_loss", "validation", "--"),
    ):
        if name in history and np.isfinite(history[name]).any():
            colour = colour_of("") if name == "loss" else colour_of("constant-velocity")
            known = np.isfinite(history[name].to_numpy())
            loss.plot(
                epochs[known],
                history[name].to_numpy()[known],
                style,
                color=colour,
                linewidth=1.5,
                label=title,
                # A line through so few would not be seen.
                marker="o" if known.sum() < FEW else None,
            )
    lowest = min((float(np.nanmin(line.get_ydata())) for line in loss.lines), default=np.inf)
    top = _usual_top(history["loss"].to_numpy()) if "loss" in history else np.inf
    if np.isfinite(top):
        loss.set_ylim(lowest - 0.05 * (top - lowest), top)
    elif lowest > 0:
        log_scale(loss)
    else:
        loss.set_yscale("symlog", linthresh=1.0)
        loss.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    loss.set_ylabel("loss (nats per coordinate)")
    loss.legend(frameon=False, fontsize=8)
    for ax, name in zip(errors, there, strict=True):
        ax.plot(epochs, history[name], color=colour_of(""), linewidth=1.5, label="training")
        if (history[name] > 0).any():
            log_scale(ax)
        ax.set_ylabel(told[name])
    for ax in grid[0]:
        ax.set_xlabel("epoch")
        whole_numbers(ax)
    return figure, grid[0]


def _usual_top(loss: npt.NDArray[np.float64]) -> float:
    """Return where an axis has to end so that spikes do not hide the course of a loss.

    Infinite if there are no spikes: no loss is far above the first and nine tenths of the others.
    """
    known = loss[np.isfinite(loss)]
    if not known.size:
        return np.inf
    low, usual = float(known.min()), max(float(known[0]), float(np.quantile(known, 0.9)))
    return usual + 0.1 * (usual - low) if known.max() - low > SPIKE * (usual - low) else np.inf


def _finite(values: xr.DataArray) -> npt.NDArray[np.float64]:
    """Return numbers with NaN in place of infinity."""
    array = values.to_numpy().astype(np.float64)
    return np.where(np.isfinite(array), array, np.nan)
