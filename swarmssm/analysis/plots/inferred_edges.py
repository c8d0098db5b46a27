"""Probable edges of each type, pair by pair."""

from typing import Any

import numpy.typing as npt
import xarray as xr
from matplotlib.figure import Figure

from swarmssm.analysis.plots.style import new_grid, paint_ground

__all__ = ["plot_edge_probabilities"]

#: Cells of pairs that were never there together, and of one with itself.
UNKNOWN = "#c8c8c8"
#: Beyond so many individuals labels would hide each other.
MANY = 30


def plot_edge_probabilities(
    edges: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw for each type that acts how probable it is for each pair, the mean over all frames.

    Parameters
    ----------
    edges
        What :func:`swarmssm.analysis.interpretation.inferred_edges.inferred_edges` returned.
    axes
        One for each type but ``"none"``; new ones if absent.

    Returns
    -------
    Figure and axes, in one row.
    """
    kinds = [str(kind) for kind in edges["edge_type"].values if kind != "none"]
    figure, grid = new_grid(axes, 1, len(kinds), (4.2 * len(kinds) + 0.6, 3.9))
    mean = edges["edge_probability"].mean(["trial", "time"])
    names = [str(name) for name in edges["individual"].values]
    for ax, kind in zip(grid[0], kinds, strict=True):
        values = mean.sel(edge_type=kind).transpose("individual", "neighbor").to_numpy()
        paint_ground(ax, UNKNOWN)
        image = ax.imshow(values, cmap="viridis", vmin=0.0, vmax=1.0, origin="upper")
        if len(names) <= MANY:
            ax.set_xticks(range(len(names)), names, parse_math=False)
            ax.set_yticks(range(len(names)), names, parse_math=False)
        ax.set_xlabel("who acts")
        ax.set_ylabel("on whom")
        ax.set_title(kind)
        figure.colorbar(image, ax=ax, label="probability")
    return figure, grid
