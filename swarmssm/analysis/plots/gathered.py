"""Several sets side by side: shares of forces on one axis, log scores against the horizon."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from swarmssm.analysis.plots.forces import plot_force_shares
from swarmssm.analysis.plots.style import COLOURS, LINE_STYLES, legend_below, new_axes, new_grid
from swarmssm.analysis.scoring.summaries import score_table

__all__ = ["BASELINES", "plot_gathered_shares", "plot_log_scores"]

#: What simple rivals are called where the scores have no titles.
BASELINES = {
    "constant-velocity": "constant velocity",
    "stay-put": "stay put",
    "noise-floor": "true rule (noise floor)",
}

#: Of models, in turn, unlike those of the simple rivals.
MODELS = ("#2f86c6", "#c4679b", "#6b8e23", "#8a6fc8", "#a0522d", "#7f7f7f")
MARKERS = ("o", "s", "^", "D", "v", "P")
#: A curve may lie so many times as far below the best as the median does, and leaves the axes else.
FARTHEST = 6.0


def plot_gathered_shares(
    summaries: Mapping[str, xr.Dataset], axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw which share each force has, a panel for each set, with 90 % intervals.

    Parameters
    ----------
    summaries
        Name of the set -> what :func:`swarmssm.analysis.force_summary` returned.
    axes
        One for each set; new ones below each other if absent.

    Returns
    -------
    Figure and axes ``(set,)``, all with the same limits: shares have no unit.
    """
    count = len(summaries)
    figure, grid = new_grid(axes, count, 1, (5.6, 0.7 + 1.6 * count))
    own = grid[:, 0] if axes is None else grid.ravel()
    for ax, (name, summary) in zip(own, summaries.items(), strict=True):
        plot_force_shares(summary, ax)
        ax.set_title(name, fontsize=10, loc="left", parse_math=False)
    right = max(ax.get_xlim()[1] for ax in own)
    for index, ax in enumerate(own):
        ax.set_xlim(0.0, right)
        if index < count - 1:
            ax.set_xlabel("")
            ax.tick_params(labelbottom=False)
    return figure, own


def plot_log_scores(
    scores: xr.Dataset, ax: Axes | None = None, *, models: Sequence[str] | None = None
) -> tuple[Figure, Axes]:
    """Draw the log score of each model and rival against the number of steps ahead.

    Parameters
    ----------
    scores
        From ``score``; a coordinate ``title (model)`` has the names
        to be shown, if it is there.
    ax
        Where to draw; new axes if absent.
    models
        All models of several figures, so that each has one colour in all of them; absent, those of
        this one.

    Returns
    -------
    Figure and axes, higher being better. A score that is not finite is a gap; a curve far below the
    others may leave the axes.
    """
    figure, ax = new_axes(ax, (5.2, 4.1))
    names = [str(name) for name in scores["model"].to_numpy()]
    plain = [BASELINES.get(name, name) for name in names]
    titles = scores["title"].to_numpy() if "title" in scores.coords else plain
    learned = [name for name in (models or names) if name not in COLOURS]
    steps = scores["horizon"].to_numpy()
    means = score_table(scores).to_numpy()
    curves = np.where(np.isfinite(means), means, np.nan)
    for name, title, curve in zip(names, titles, curves, strict=True):
        if name in COLOURS:
            look: dict[str, Any] = {"color": COLOURS[name], "linestyle": LINE_STYLES[name]}
        else:
            place = learned.index(name)
            look = {"color": MODELS[place % len(MODELS)], "linewidth": 1.9}
            look |= {"marker": MARKERS[place % len(MARKERS)], "markersize": 5}
        ax.plot(steps, curve, label=str(title), **look)
    known = curves[np.isfinite(curves)]
    if known.size:
        top, middle, bottom = float(known.max()), float(np.median(known)), float(known.min())
        reach = (top - middle) or 1.0
        bottom = max(bottom, top - FARTHEST * reach)
        room = 0.06 * ((top - bottom) or 1.0)
        ax.set_ylim(bottom - room, top + room)
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(FixedLocator(list(steps)))
    ax.xaxis.set_major_formatter(FixedFormatter([f"{step:g}" for step in steps]))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xlabel("steps ahead")
    ax.set_ylabel("log score (nats per coordinate)")
    legend_below(ax)
    return figure, ax
