"""Who was tracked when: a recording and its gaps."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from swarmssm.analysis.plots.style import MODEL_COLOUR, new_axes
from swarmssm.tracks import states_of, with_trials

__all__ = ["plot_presence"]

#: Columns at most; of longer recordings several frames share one.
COLUMNS = 1000
#: Individuals named at most on the axis.
NAMED = 40


def plot_presence(tracks: xr.Dataset, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw for each individual when it was tracked, trials after one another.

    Parameters
    ----------
    tracks
        Tracks.
    ax
        Where to draw; new axes if absent.

    Returns
    -------
    Figure and axes, with an image ``(individual, time)`` of the share of frames in which each was
    tracked, from 0 (blank) to 1. Lines part the trials; where there is one, time is in seconds.
    """
    tracks = with_trials(tracks)
    names = [str(name) for name in tracks["individual"].to_numpy()]
    height = 0.9 + 0.17 * min(max(len(names), 4), 24)
    figure, ax = new_axes(ax, (6.9, height))
    position = states_of(tracks)[..., : tracks.sizes["space"]]
    seen = np.isfinite(position).all(-1).astype(float)
    trials, frames = seen.shape[:2]
    whole = seen.transpose(2, 0, 1).reshape(len(names), -1)
    share = max(1, -(-whole.shape[1] // COLUMNS))
    starts = np.arange(0, whole.shape[1], share)
    columns = np.add.reduceat(whole, starts, axis=1) / np.diff(starts, append=whole.shape[1])
    red, green, blue = (int(MODEL_COLOUR[place : place + 2], 16) / 255 for place in (1, 3, 5))
    shades = ListedColormap([(red, green, blue, shade) for shade in np.linspace(0.0, 1.0, 11)])
    one = trials == 1
    step = 1.0 / float(tracks.attrs["fps"]) if one else 1.0
    first = float(tracks["time"].to_numpy()[0]) if one else 0.0
    extent = (first, first + whole.shape[1] * step, len(names) - 0.5, -0.5)
    ax.imshow(
        columns, cmap=shades, vmin=0.0, vmax=1.0, aspect="auto", interpolation="none", extent=extent
    )
    for trial in range(1, trials):
        ax.axvline(trial * frames, color="#7f7f7f", linewidth=0.8)
    ax.set_xlabel("time (s)" if one else f"frame, {trials} trials after one another")
    stride = -(-len(names) // NAMED)
    ax.set_yticks(range(0, len(names), stride), names[::stride], fontsize=8, parse_math=False)
    ax.set_ylabel("individual")
    return figure, ax
