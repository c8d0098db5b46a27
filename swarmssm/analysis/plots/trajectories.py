"""Paths of the individuals: whole, at some times, and from random starts."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarmssm.analysis.plots.style import (
    dot_size,
    individual_colours,
    label_axes,
    label_outer,
    new_axes,
    new_grid,
    set_box,
)
from swarmssm.errors import InputError

__all__ = ["plot_imitation", "plot_random_starts", "plot_snapshots", "plot_trajectories"]

#: Paths with more numbers than this are drawn thin, and as pixels inside a vector figure.
MANY_POINTS = 6000
MANY_ARROWS = 100


def plot_trajectories(
    position: xr.Dataset | xr.DataArray,
    ax: Axes | None = None,
    *,
    attributes: Mapping[str, Any] | None = None,
    title: str = "",
    **line: Any,
) -> tuple[Figure, Axes]:
    """Draw each individual's path, a dot where it ends.

    Parameters
    ----------
    position
        Tracks without trials, or positions ``(time, individual, space)`` in any order; in 3-D the
        first two coordinates are drawn.
    ax
        Where to draw; new axes if absent.
    attributes
        ``unit`` of length and ``y_axis``, as ``tracks.attrs`` have them. Default: those of tracks.
    title
        Title of the axes.
    **line
        Passed on to :meth:`matplotlib.axes.Axes.plot`.

    Returns
    -------
    Figure and axes.
    """
    figure, ax = new_axes(ax, (4.2, 4.2))
    if isinstance(position, xr.Dataset):
        attributes = position.attrs if attributes is None else attributes
        position = position["position"]
    attributes = attributes or {}
    if "trial" in position.dims:
        raise InputError("position: it has trials. Choose one: tracks.isel(trial=0).")
    paths = position.transpose("time", "individual", "space").to_numpy()
    many = paths.size > MANY_POINTS
    style = {"linewidth": 0.6 if many else 1.0, "alpha": 0.8, "rasterized": many} | line
    colours = individual_colours(paths.shape[1])
    ends = np.full((paths.shape[1], 2), np.nan)
    for index, colour in enumerate(colours):
        path = paths[:, index, :2]
        ax.plot(path[:, 0], path[:, 1], color=colour, **style)
        seen = np.flatnonzero(np.isfinite(path).all(axis=-1))
        if seen.size:
            ends[index] = path[seen[-1]]
    ended = np.isfinite(ends[:, 0])
    dots = np.array(colours)[ended]
    ax.scatter(
        ends[ended, 0], ends[ended, 1], c=dots, s=dot_size(len(dots), 12.0), linewidths=0, zorder=3
    )
    label_axes(ax, position["space"].to_numpy(), attributes)
    ax.set_title(title, fontsize=10)
    return figure, ax


def plot_imitation(
    imitation: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw true paths beside those imitated, all to the same limits (figs 4.1, 4.2).

    Parameters
    ----------
    imitation
        With ``true``, ``one_step`` and ``free_run`` ``(time, individual, space)``.
    axes
        Three axes; new ones if absent.

    Returns
    -------
    Figure and axes ``(3,)``.
    """
    figure, grid = new_grid(axes, 1, 3, (9.6, 3.7))
    titles = {
        "true": "true",
        "one_step": "imitated, one step at a time",
        "free_run": "imitated, running freely",
    }
    for ax, (name, title) in zip(grid[0], titles.items(), strict=True):
        plot_trajectories(imitation[name], ax, attributes=imitation.attrs, title=title)
    _same_limits(grid[0], [imitation[name] for name in titles])
    label_outer(grid)
    return figure, grid[0]


def plot_snapshots(
    imitation: xr.Dataset, axes: npt.NDArray[Any] | None = None, *, count: int = 4
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw the true group and the freely running one at some times (figs 4.3, 4.4).

    Parameters
    ----------
    imitation
        With ``true``, ``free_run`` and their velocities, ``(time, individual, space)``.
    axes
        ``2 * count`` axes; new ones if absent.
    count
        How many times, spread evenly from the first frame to the last.

    Returns
    -------
    Figure and axes ``(2, count)``: true above, imitated below. Arrows point along velocities.
    """
    num_times = imitation.sizes["time"]
    rows = np.unique(np.linspace(0, num_times - 1, min(count, num_times)).round().astype(int))
    figure, grid = new_grid(axes, 2, len(rows), (2.4 * len(rows), 5.0))
    for line, (name, word) in zip(grid, (("true", "true"), ("free_run", "free run")), strict=True):
        for ax, row in zip(line, rows, strict=True):
            seconds = float(imitation["time"][row])
            _draw_headings(
                ax,
                imitation[name].isel(time=row),
                imitation[f"{name}_velocity"].isel(time=row),
                imitation.attrs,
            )
            ax.set_title(f"{word}, {seconds:.3g} s", fontsize=9)
        _same_limits(line, [imitation[name].isel(time=rows) for name in ("true", "free_run")])
    label_outer(grid)
    return figure, grid


def plot_random_starts(
    runs: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw free runs from random starts (fig. 4.14): paths, and headings at the end.

    Parameters
    ----------
    runs
        With ``position`` and ``velocity (run, time, individual, space)``.
    axes
        One a run; new ones if absent.

    Returns
    -------
    Figure and axes ``(run,)``.
    """
    count = runs.sizes["run"]
    figure, grid = new_grid(axes, 1, count, (2.5 * count, 3.0))
    for index, ax in enumerate(grid[0]):
        run = runs.isel(run=index)
        title = f"start {index + 1}"
        plot_trajectories(run["position"], ax, attributes=runs.attrs, title=title, alpha=0.6)
        ax.plot(
            run["position"].isel(time=0, space=0),
            run["position"].isel(time=0, space=1),
            linestyle="",
            marker="x",
            markersize=4,
            color="#7f7f7f",
            label="start",
        )
    _same_limits(grid[0], [runs["position"]])
    label_outer(grid)
    return figure, grid[0]


def _draw_headings(
    ax: Axes, position: xr.DataArray, velocity: xr.DataArray, attributes: Mapping[str, Any]
) -> None:
    """Draw each individual with an arrow along its velocity."""
    place = position.transpose("individual", "space").to_numpy()[:, :2]
    speed = velocity.transpose("individual", "space").to_numpy()[:, :2]
    length = np.linalg.norm(speed, axis=-1)
    seen = np.isfinite(place).all(axis=-1)
    colours = np.array(individual_colours(len(place)))
    ax.scatter(
        place[seen, 0], place[seen, 1], c=colours[seen], s=dot_size(len(place), 14.0), linewidths=0
    )
    moving = seen & (length > 0)
    crowd = len(place) > MANY_ARROWS
    if moving.any():
        heading = speed[moving] / length[moving, None]
        ax.quiver(
            place[moving, 0],
            place[moving, 1],
            heading[:, 0],
            heading[:, 1],
            color=colours[moving],
            angles="xy",
            scale=22 if crowd else 11,
            width=0.006 if crowd else 0.012,
            rasterized=crowd,
        )
    label_axes(ax, position["space"].to_numpy(), attributes)


def _same_limits(axes: Sequence[Axes], arrays: Sequence[xr.DataArray]) -> None:
    """Give axes the limits of all the data, a little wider."""
    values = np.concatenate(
        [a.transpose(..., "space").to_numpy().reshape(-1, a.sizes["space"])[:, :2] for a in arrays]
    )
    values = values[np.isfinite(values).all(axis=-1)]
    if not len(values):
        return
    low, high = values.min(axis=0), values.max(axis=0)
    half = 0.6 * max(float((high - low).max()), 1e-9)
    middle = (low + high) / 2
    for ax in axes:
        set_box(ax, (middle[0] - half, middle[0] + half, middle[1] - half, middle[1] + half))
