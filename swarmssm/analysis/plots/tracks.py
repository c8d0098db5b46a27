"""A group at one time: who is where, looks where, comes from where, and sees whom."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarmssm.analysis.plots.frames import FramePicture
from swarmssm.analysis.plots.scenes.scene import box_of, scenes_of
from swarmssm.analysis.plots.style import new_axes
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule

__all__ = ["TAIL", "plot_tracks"]

#: Frames of path behind each individual.
TAIL = 25


def plot_tracks(
    tracks: xr.Dataset,
    ax: Axes | None = None,
    *,
    at: float | None = None,
    trial: str | None = None,
    individuals: Sequence[str] | None = None,
    tail: int = TAIL,
    edges: bool | str | GraphRule = True,
    title: str | None = None,
) -> tuple[Figure, Axes]:
    """Draw the group at one time: a dart along each heading, the path behind it, and the graph.

    Parameters
    ----------
    tracks
        Tracks.
    ax
        Where to draw; new axes if absent.
    at
        Seconds: the last frame that is not later. Default: the frame with the most individuals, the
        last of several.
    trial
        Label; default the first.
    individuals
        Labels of those to draw; default all.
    tail
        Frames of path behind each; 0 for none.
    edges
        Whether to draw the graph that the tracks carry, or the rule that makes one, such as
        ``"k-nearest:6"``.
    title
        Default: the time.

    Returns
    -------
    Figure and axes. Who has not moved yet, and so has no heading, is a disc. A line joins two who
    see each other; an arrow from i to j: i sees j. In 3-D the group is seen from above.

    Raises
    ------
    InputError
        If a label is unknown, the time lies outside of the tracks, or a number is out of range.
    """
    if tail < 0:
        raise InputError(f"tail: it must be at least 0, and it is {tail}.")
    (scene,) = scenes_of(tracks, trial=trial, individuals=individuals, edges=edges)
    if at is None:
        counts = np.isfinite(scene.position).all(axis=-1).sum(axis=-1)
        row = int(np.flatnonzero(counts == counts.max())[-1])
    else:
        (shown,) = scenes_of(tracks, trial=trial, start=at, edges=False)
        row = int(np.argmin(np.abs(scene.time - shown.time[0])))
    figure, ax = new_axes(ax, (4.6, 4.6))
    # As much of the place as the picture shows, not all where they ever were.
    drawn = replace(scene, position=scene.position[max(0, row - tail) : row + 1])
    box, _ = box_of([drawn])
    FramePicture(ax, scene, box, tail=tail).show(row)
    ax.set_title(f"{scene.time[row]:.4g} s" if title is None else title, fontsize=10)
    return figure, ax
