"""Figure of a recovery study: the error of each parameter against what was varied."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from swarmssm.analysis.diagnostics.recovery.table import factor_curve, gains_of
from swarmssm.analysis.plots.style import INDIVIDUALS, log_scale, new_grid
from swarmssm.errors import InputError
from swarmssm.inference.parameter_labels import short_names

__all__ = ["plot_recovery", "varied_factors"]

TITLES = {
    "individuals": "individuals",
    "density": "individuals in a unit of area at the start",
    "radius": "radius of perception",
    "noise": "tracking noise",
    "frames": "frames of each trial",
    "trials": "trials",
}
COLUMNS = 3
GREY = "#7f7f7f"


def plot_recovery(
    recovery: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw the median relative error of each gain against each factor that was varied.

    Beside each line stands, thin and dotted, half the 90 % interval: what a single fit says of its
    own error. The dashed grey line is the tolerance.

    Parameters
    ----------
    recovery
        ``data`` of :func:`swarmssm.analysis.recovery`. For a grid each panel has the medians
        over all combinations with the same value of its factor.
    axes
        As many as factors; new ones if absent.

    Returns
    -------
    Figure and axes ``(row, column)``; both scales are logarithmic, a value of 0 is left out.

    Raises
    ------
    InputError
        If nothing was varied.
    """
    factors = varied_factors(recovery)
    if not factors:
        raise InputError("recovery: no factor was varied; there is nothing to draw.")
    in_grid = "grid" in recovery["factor"].values
    shape = () if axes is None else np.asarray(axes).shape
    columns = shape[-1] if shape else min(COLUMNS, len(factors))
    rows = -(-len(factors) // columns)
    figure, grid = new_grid(axes, rows, columns, (3.6 * columns + 1.9, 3.0 * rows), sharey=True)
    tolerance = float(recovery.attrs["tolerance"])
    names = gains_of(recovery)
    for ax, factor in zip(grid.flat, factors, strict=False):
        curve = _over_grid(recovery, factor) if in_grid else factor_curve(recovery, factor)
        _draw(ax, curve, factor, names)
        ax.axhline(tolerance, color=GREY, linestyle="--", linewidth=1.0)
    for place, ax in enumerate(grid.flat):
        if place >= len(factors):
            ax.set_axis_off()
        elif place % columns == 0:
            ax.set_ylabel("relative error (median)")
    if axes is None:
        handles, _ = grid.flat[0].get_legend_handles_labels()
        handles.append(Line2D([], [], color=GREY, linestyle=":", label="half the 90 % interval"))
        handles.append(
            Line2D([], [], color=GREY, linestyle="--", label=f"{100 * tolerance:.0f} % asked for")
        )
        figure.legend(
            handles=handles, loc="outside right center", frameon=False, fontsize=8, handlelength=1.8
        )
    return figure, grid


def varied_factors(recovery: xr.Dataset) -> list[str]:
    """Return the factors of which there is more than one value.

    Parameters
    ----------
    recovery
        ``data`` of :func:`swarmssm.analysis.recovery`.
    """
    varied = dict.fromkeys(str(name) for name in recovery["factor"].values)
    if "grid" in varied:
        return [name for name in TITLES if len(np.unique(recovery[name].dropna("design"))) > 1]
    return [name for name in varied if name != "base"]


def _over_grid(recovery: xr.Dataset, factor: str) -> xr.Dataset:
    """Return the medians over all designs that have the same value of a factor."""
    values = recovery[factor].to_numpy()
    known = np.unique(values[np.isfinite(values)])
    medians = {}
    for name in ("error", "width"):
        own = recovery[name].transpose("design", "parameter").to_numpy()
        rows = [own[values == value] for value in known]
        medians[name] = (
            (factor, "parameter"),
            [[_median(column) for column in one.T] for one in rows],
        )
    return xr.Dataset(medians, {factor: known, "parameter": recovery["parameter"].values})


def _median(values: npt.NDArray[np.float64]) -> float:
    """Return the median of what is known, NaN if nothing is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def _draw(ax: Axes, curve: xr.Dataset, factor: str, names: list[str]) -> None:
    """Draw one panel."""
    values = curve[factor].to_numpy()
    short = short_names(names)
    for index, name in enumerate(names):
        one = curve.sel(parameter=name)
        colour = INDIVIDUALS[index % len(INDIVIDUALS)]
        error, width = (np.where(one[n] > 0, one[n], np.nan) for n in ("error", "width"))
        ax.plot(values, error, "o-", color=colour, markersize=4, label=short[name])
        ax.plot(values, width, ":", color=colour, linewidth=1.0)
    ax.set_xscale("log")
    log_scale(ax)
    ax.set_xticks(values, [f"{value:.3g}" for value in values])
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel(TITLES[factor], fontsize=9)
    ax.tick_params(labelsize=8)
