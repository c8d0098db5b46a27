"""The figure of a benchmark: how errors grow with how far ahead one looks."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarmssm.analysis.plots.scores import FITS
from swarmssm.analysis.plots.style import LINE_STYLES, colour_of, log_scale, new_axes

__all__ = ["plot_benchmark"]

OTHERS = "#a5a5a5"
#: Rivals that are drawn in a colour of their own, the best at the last step.
NAMED = 5
BASELINES = ("#cc5f00", "#b8860b", "#7a5195", "#a0522d", "#5c7fb8")


def plot_benchmark(
    errors: xr.DataArray,
    own: Sequence[str] = (),
    fps: float | None = None,
    ax: Axes | None = None,
) -> tuple[Figure, Axes]:
    """Draw the squared error of each method over how far ahead it forecasts.

    Named are this package's models, staying put, constant velocity, the noise floor and the five
    best of the others at the last step; the rest are grey.

    Parameters
    ----------
    errors
        ``squared_error (model, step)``, see :class:`swarmssm.benchmark.Results`.
    own
        Names of this package's models.
    fps
        Frames per second: then the axis is of seconds, else of steps.
    ax
        Axes; new ones if absent.

    Returns
    -------
    Figure and axes.
    """
    figure, ax = new_axes(ax, (7.6, 4.6))
    names = [str(name) for name in errors["model"].values]
    ahead = errors["step"].to_numpy() / (1.0 if fps is None else fps)
    last = {name: float(errors.sel(model=name)[-1]) for name in names}
    rivals = [name for name in names if name not in own and name not in LINE_STYLES]
    best = sorted(rivals, key=lambda name: np.nan_to_num(last[name], nan=np.inf))[:NAMED]
    for name in names:
        values = np.where(np.isfinite(errors.sel(model=name)), errors.sel(model=name), np.nan)
        label, width = name, 1.2
        style: Any = LINE_STYLES.get(name, "-")
        if name in LINE_STYLES:
            colour = colour_of(name)
        elif name in own:
            colour, width = FITS[list(own).index(name) % len(FITS)], 2.2
        elif name in best:
            colour = BASELINES[best.index(name)]
        else:
            colour, width, label = OTHERS, 0.8, "_other"
        ax.plot(
            ahead,
            values,
            linestyle=style,
            color=colour,
            linewidth=width,
            label=label,
            zorder=1.0 if colour == OTHERS else 3.0,
        )
    if len(rivals) > len(best):
        ax.plot([], [], color=OTHERS, linewidth=0.8, label=f"{len(rivals) - len(best)} others")
    finite = errors.to_numpy()[np.isfinite(errors.to_numpy())]
    if finite.size and finite.min() > 0.0:
        log_scale(ax)
    # What runs away would leave all others on the floor of the figure.
    ends = [value for value in last.values() if np.isfinite(value)]
    if len(ends) > 2:
        ax.set_ylim(top=min(ax.get_ylim()[1], 4.0 * float(np.quantile(ends, 0.75))))
    ax.set_xlabel("steps ahead" if fps is None else "time ahead (s)")
    ax.set_ylabel("squared error of scaled states")
    if names:
        ax.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure, ax
