"""Figure of a recovery study: the error of each parameter against what was varied."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from swarmssm.analysis.calibration.parameter_names import short_name
from swarmssm.analysis.plots.style import INDIVIDUALS, log_scale, new_grid
from swarmssm.analysis.recovery.table import factor_curve, gains_of
from swarmssm.errors import InputError

__all__ = ["plot_recovery"]

TITLES = {
    "individuals": "individuals",
    "density": "individuals in a unit of area at the start",
    "radius": "radius of perception",
    "noise": "tracking noise",
    "frames": "frames of each trial",
    "trials": "trials",
}
COLUMNS = 3


def plot_recovery(
    recovery: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw the median relative error of each gain against each factor that was varied.

    Beside each line stands, thin and dotted, half the 90 % interval: what a single fit says of its
    own error. The dashed grey line is the tolerance.

    Parameters
    ----------
    recovery
        From :func:`swarmssm.analysis.recovery_study`, one factor at a time.
    axes
        As many as factors; new ones if absent.

    Returns
    -------
    Figure and axes ``(row, column)``; both scales are logarithmic, a value of 0 is left out.

    Raises
    ------
    InputError
        If nothing was varied on its own.
    """
    varied = list(dict.fromkeys(str(name) for name in recovery["factor"].values))
    factors = [name for name in varied if name not in ("base", "grid")]
    if not factors:
        raise InputError("recovery: no factor was varied on its own; there is nothing to draw.")
    shape = () if axes is None else np.asarray(axes).shape
    columns = shape[-1] if shape else min(COLUMNS, len(factors))
    rows = -(-len(factors) // columns)
    figure, grid = new_grid(axes, rows, columns, (3.6 * columns + 1.6, 3.0 * rows), sharey=True)
    tolerance = float(recovery.attrs["tolerance"])
    names = gains_of(recovery)
    for ax, factor in zip(grid.flat, factors, strict=False):
        curve = factor_curve(recovery, factor)
        _draw(ax, curve, factor, names)
        ax.axhline(tolerance, color="#7f7f7f", linestyle="--", linewidth=1.0)
    for place, ax in enumerate(grid.flat):
        if place >= len(factors):
            ax.set_axis_off()
        elif place % columns == 0:
            ax.set_ylabel("relative error (median)")
    if axes is None:
        handles, labels = grid.flat[0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside right center", frameon=False, fontsize=8, handlelength=1.4
        )
    return figure, grid


def _draw(ax: Axes, curve: xr.Dataset, factor: str, names: list[str]) -> None:
    """Draw one panel."""
    values = curve[factor].to_numpy()
    for index, name in enumerate(names):
        one = curve.sel(parameter=name)
        colour = INDIVIDUALS[index % len(INDIVIDUALS)]
        error, width = (np.where(one[n] > 0, one[n], np.nan) for n in ("error", "width"))
        ax.plot(values, error, "o-", color=colour, markersize=4, label=short_name(name))
        ax.plot(values, width, ":", color=colour, linewidth=1.0)
    ax.set_xscale("log")
    log_scale(ax)
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}".rstrip()))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_xticks(values, [f"{value:.3g}" for value in values])
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel(TITLES[factor], fontsize=9)
    ax.tick_params(labelsize=8)
