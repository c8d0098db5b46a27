"""Which latent carries which force, and how well each source tells the forces."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from swarmssm.analysis.plots.style import legend_below, new_axes, paint_ground

__all__ = ["plot_latents", "plot_rotated_axes", "plot_sources"]

#: A cell is marked if chance gives as much somewhere in the table no more often than this.
LEVEL = 0.05
#: Latents that are drawn.
MOST = 24
COLOURS = ("#2f86c6", "#cc5f00", "#009e73", "#c4679b", "#b8860b", "#8a6fc8")
UNTRAINED = "#7f7f7f"
#: Ink on what is light in any page, and lines that are faint on light and dark ones.
DARK, FAINT = "#111111", "#7f7f7f"
#: Cells without a number.
UNKNOWN = "#c8c8c8"


def plot_latents(
    alignment: xr.Dataset, ax: Axes | None = None, *, probe: str = "linear", most: int = MOST
) -> tuple[Figure, Axes]:
    """Draw a heat map of how well each latent by itself tells each component of each force.

    Parameters
    ----------
    alignment
        What :func:`swarmssm.analysis.latent_force_alignment` returned.
    ax
        Where to draw; new axes if absent.
    probe
        ``"linear"`` or ``"kernel"``.
    most
        How many latents to draw: of more, those that tell most, in their own order.

    Returns
    -------
    Figure and axes. A cell with a dot has a family-wise p-value of at most 0.05: in no more than
    one table of 20 chance alone would put even one dot. What is below 0 is drawn as 0.
    """
    r2 = alignment["latent_r2"].sel(probe=probe)
    p = alignment["latent_family_p"].sel(probe=probe)
    values, chance = (_by_component(one) for one in (r2, p))
    best = np.max(np.nan_to_num(values, nan=-np.inf), axis=1)
    chosen = np.sort(np.argsort(-best, kind="stable")[:most])
    names = [str(name) for name in alignment["latent"].values[chosen]]
    columns = [str(name) for name in alignment["component"].values]
    figure, ax = new_axes(ax, (0.62 * len(columns) + 2.6, 0.26 * len(names) + 1.6))
    _heat(figure, ax, values[chosen], names, columns)
    for row, column in np.argwhere(chance[chosen] <= LEVEL):
        shade = "white" if values[chosen][row, column] > 0.5 else DARK
        ax.plot(column, row, ".", color=shade, markersize=4)
    left = len(best) - len(chosen)
    title = f"{probe} probe of one latent" + (
        f", best {len(chosen)} of {len(best)}" if left else ""
    )
    ax.set_title(title, fontsize=10)
    return figure, ax


def plot_sources(
    alignment: xr.Dataset, ax: Axes | None = None, *, probe: str = "linear"
) -> tuple[Figure, Axes]:
    """Draw how well each source tells each force, trained and untrained.

    Parameters
    ----------
    alignment
        What :func:`swarmssm.analysis.latent_force_alignment` returned.
    ax
        Where to draw; new axes if absent.
    probe
        ``"linear"`` or ``"kernel"``.

    Returns
    -------
    Figure and axes: a row a source, with the number of its features; a filled dot a force, an open
    one where chance does as well in more than 5 %; an upright line for each initialisation of the
    untrained model. What is below -0.1 is drawn there.
    """
    sources = [str(name) for name in alignment["source"].values]
    figure, ax = new_axes(ax, (6.8, 0.42 * len(sources) + 1.8))
    terms = [str(term) for term in alignment["term"].values]
    part = alignment.sel(probe=probe)
    for place, term in enumerate(terms):
        colour = COLOURS[place % len(COLOURS)]
        rows = np.arange(len(sources)) + 0.7 * ((place + 0.5) / len(terms) - 0.5)
        r2 = part["source_vector_r2"].sel(term=term).to_numpy()
        sure = part["source_p"].sel(term=term).to_numpy() <= LEVEL
        shown = np.clip(r2, -0.1, None)
        ax.plot(shown[sure], rows[sure], "o", color=colour, markersize=5, label=term)
        ax.plot(shown[~sure], rows[~sure], "o", color=colour, markersize=5, markerfacecolor="none")
        before = part["untrained_r2"].sel(term=term).to_numpy()
        for one in before:
            ax.plot(np.clip(one, -0.1, None), rows, "|", color=colour, markersize=8)
    if alignment.sizes.get("initialization", 0):
        ax.plot([], [], "|", color=UNTRAINED, markersize=7, label="before training")
    sizes = alignment["source_size"].to_numpy()
    labels = [f"{name} ({size})" for name, size in zip(sources, sizes, strict=True)]
    ax.set_yticks(np.arange(len(sources)), labels)
    ax.set_ylim(len(sources) - 0.5, -0.5)
    ax.set_xlim(-0.13, 1.03)
    ax.axvline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    for line in np.arange(len(sources) - 1) + 0.5:
        ax.axhline(line, color=FAINT, alpha=0.3, linewidth=0.8, zorder=0)
    ax.set_xlabel(f"cross-validated R² of the force ({probe} probe)")
    legend_below(ax)
    return figure, ax


def plot_rotated_axes(
    alignment: xr.Dataset, ax: Axes | None = None, *, group: str = "latents"
) -> tuple[Figure, Axes]:
    """Draw how well each rotated axis alone tells each component of a force.

    Parameters
    ----------
    alignment
        What :func:`swarmssm.analysis.latent_force_alignment` returned.
    ax
        Where to draw; new axes if absent.
    group
        Which latents were rotated.

    Returns
    -------
    Figure and axes; an axis is pure if its row has but one dark cell, that on the diagonal.
    """
    names = [str(name) for name in alignment["axis"].values]
    figure, ax = new_axes(ax, (0.62 * len(names) + 2.6, 0.34 * len(names) + 1.6))
    values = alignment["axis_r2"].sel(group=group).to_numpy()
    _heat(figure, ax, values, [f"axis of {name}" for name in names], names)
    ax.set_title(f"rotated {group}", fontsize=10)
    return figure, ax


def _by_component(values: xr.DataArray) -> npt.NDArray[np.float64]:
    """Return ``(latent, term and space)``."""
    array = values.transpose("latent", "term", "space").to_numpy()
    return array.reshape(len(array), -1)


def _heat(
    figure: Figure,
    ax: Axes,
    values: npt.NDArray[np.float64],
    rows: list[str],
    columns: list[str],
) -> None:
    """Draw a matrix of R^2 between 0 and 1 with names; grey where there is none."""
    paint_ground(ax, UNKNOWN)
    shown = np.ma.masked_invalid(np.clip(values, 0.0, 1.0))
    image = ax.imshow(shown, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_yticks(np.arange(len(rows)), rows, fontsize=8)
    slanted: dict[str, Any] = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
    ax.set_xticks(np.arange(len(columns)), columns, fontsize=8, **slanted)
    figure.colorbar(image, ax=ax, label="cross-validated R²")
