"""The interaction graph, true and predicted, and how well it is predicted."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from swarmssm.analysis.plots.style import (
    LINE_STYLES,
    colour_of,
    dot_size,
    individual_colours,
    label_axes,
    legend_below,
    new_axes,
    new_grid,
)

__all__ = ["plot_edge_accuracy", "plot_graphs"]

EDGE = "#7f7f7f"
#: More edges than this are drawn faint, and as pixels inside a vector figure.
MANY_EDGES = 500


def plot_graphs(
    graphs: xr.Dataset, axes: npt.NDArray[Any] | None = None, *, threshold: float = 0.5
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw true graphs above those predicted from the frame before (fig. 4.5).

    Parameters
    ----------
    graphs
        With ``position (snapshot, individual, space)``, ``true`` and ``probability (snapshot,
        individual, neighbor)``.
    axes
        Two a snapshot; new ones if absent.
    threshold
        Probability from which on an edge is drawn.

    Returns
    -------
    Figure and axes ``(2, snapshot)``. An arrow from i to j: i sees j.
    """
    count = graphs.sizes["snapshot"]
    figure, grid = new_grid(axes, 2, count, (3.1 * count, 6.2))
    for column in range(count):
        frame = graphs.isel(snapshot=column)
        seconds = float(frame["snapshot"])
        with np.errstate(invalid="ignore"):
            predicted = frame["probability"].to_numpy() >= threshold
        for ax, edges, word in (
            (grid[0, column], frame["true"].to_numpy(), "true"),
            (grid[1, column], predicted, "predicted"),
        ):
            _draw_graph(ax, frame["position"], edges, graphs.attrs)
            ax.set_title(f"{word}, {seconds:.3g} s", fontsize=9)
    return figure, grid


def plot_edge_accuracy(
    edges: xr.Dataset, ax: Axes | None = None, *, score: str = "accuracy"
) -> tuple[Figure, Axes]:
    """Draw a score of the next graph at each step (figs 4.6, 4.13), mean over trials.

    Parameters
    ----------
    edges
        With ``score (predictor, trial, time)`` and the coordinate ``title (predictor)``.
    ax
        Where to draw; new axes if absent.
    score
        ``"accuracy"``, ``"precision"``, ``"recall"`` or ``"auc"``.

    Returns
    -------
    Figure and axes, one line a predictor; steps of which nothing is known are gaps.
    """
    figure, ax = new_axes(ax)
    known = edges[score].notnull()
    total = edges[score].fillna(0.0).sum("trial")
    mean = (total / known.sum("trial").where(known.any("trial"))).transpose("predictor", "time")
    seconds = edges["time"].to_numpy() - float(edges["time"][0])
    for name, title, line in zip(
        edges["predictor"].values, edges["title"].values, mean.to_numpy(), strict=True
    ):
        ax.plot(
            seconds,
            line,
            color=colour_of(str(name)),
            linestyle=LINE_STYLES.get(str(name), "-"),
            linewidth=1.5,
            label=str(title),
        )
    ax.set_xlabel("time (s)")
    ax.set_ylabel("AUC" if score == "auc" else f"edge {score}")
    ax.set_ylim(-0.03, 1.03)
    legend_below(ax)
    return figure, ax


def _draw_graph(
    ax: Axes, position: xr.DataArray, edges: npt.NDArray[Any], attributes: Mapping[str, Any]
) -> None:
    """Draw one graph: a line where both see each other, an arrow where one sees the other."""
    place = position.transpose("individual", "space").to_numpy()[:, :2]
    seen = np.isfinite(place).all(axis=-1)
    there = edges.astype(bool) & seen[:, None] & seen[None, :]
    there &= ~np.eye(len(place), dtype=bool)
    mutual = np.argwhere(np.triu(there & there.T))
    one_way = np.argwhere(there & ~there.T)
    many = len(mutual) + len(one_way) > MANY_EDGES
    alpha = 0.2 if many else 0.7
    lines = LineCollection(
        list(place[mutual]),
        colors=EDGE,
        linewidths=0.8,
        alpha=alpha,
        zorder=1,
        rasterized=many,
    )
    ax.add_collection(lines)
    if len(one_way):
        start = place[one_way[:, 0]]
        arrow = place[one_way[:, 1]] - start
        ax.quiver(
            start[:, 0],
            start[:, 1],
            arrow[:, 0],
            arrow[:, 1],
            color=EDGE,
            alpha=alpha,
            rasterized=many,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.004,
            zorder=1,
        )
    colours = np.array(individual_colours(len(place)))[seen]
    size = dot_size(len(place), 32.0)
    ax.scatter(place[seen, 0], place[seen, 1], c=colours, s=size, linewidths=0, zorder=2)
    label_axes(ax, position["space"].to_numpy(), attributes)
