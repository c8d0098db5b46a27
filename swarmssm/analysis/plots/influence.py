"""Who moves whom: a network of arrows, a matrix, and a ranking with its uncertainty."""

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from swarmssm.analysis.plots.style import colour_of, legend_below, new_axes, new_grid, paint_ground
from swarmssm.analysis.scoring.table import format_unit

__all__ = ["plot_influence", "plot_influence_matrix", "plot_influence_network", "plot_leadership"]

COLOURS = "viridis"
ARROW = "#7f7f7f"
#: Ink on what is light in any page: plain black would become the page's own ink, light in the dark.
DARK = "#111111"
#: Cells of pairs that were never seen together, and of one with itself.
UNKNOWN = "#c8c8c8"
#: Names of the variables with pairs, and how their strength is called beside a colour bar.
PAIRS = {
    "influence": "influence",
    "position_part": "influence by position",
    "velocity_part": "influence by velocity",
    "pair_weight": "weight",
}
#: Arrows weaker than this share of the strongest are left out, and so are all but so many.
FAINTEST, MOST_ARROWS = 0.05, 120
WIDEST = 4.0
#: Beyond so many individuals labels would hide each other.
MANY = 30


def plot_influence_network(
    influence: xr.Dataset, ax: Axes | None = None, *, strength: str = "influence"
) -> tuple[Figure, Axes]:
    """Draw individuals on a circle, with an arrow from each to those whom it moves.

    Parameters
    ----------
    influence
        What :func:`swarmssm.analysis.interpretation.influence.influence` returned.
    ax
        Where to draw; new axes if absent.
    strength
        ``"influence"``, ``"position_part"``, ``"velocity_part"`` or ``"pair_weight"``, at its
        posterior median.

    Returns
    -------
    Figure and axes. The wider an arrow, the stronger; the lighter an individual, the more it moves
    the others. Arrows below a twentieth of the strongest are left out, and beyond 120 the weakest.
    """
    figure, ax = new_axes(ax, (5.4, 4.6))
    pairs = _middle(influence, strength)
    sending = _outgoing(pairs)
    names = [str(name) for name in influence["individual"].values]
    number = len(names)
    angle = 0.5 * np.pi - 2.0 * np.pi * np.arange(number) / number
    place = np.stack([np.cos(angle), np.sin(angle)], -1)
    shades = Normalize(*_range(sending))
    painter = ScalarMappable(shades, COLOURS)
    radius = min(0.13, 2.0 / number)
    strongest = float(np.nanmax(pairs, initial=0.0))
    order = np.argsort(np.where(np.isnan(pairs), -1.0, pairs), axis=None)
    for flat in order[max(0, len(order) - MOST_ARROWS) :]:
        moved, mover = divmod(int(flat), number)
        share = pairs[moved, mover] / strongest if strongest > 0 else 0.0
        if not share >= FAINTEST:
            continue
        ax.add_patch(
            FancyArrowPatch(
                tuple(place[mover]),
                tuple(place[moved]),
                connectionstyle="arc3,rad=0.12",
                arrowstyle=f"-|>,head_length={3 + 3 * share:.2f},head_width={1.2 + 2 * share:.2f}",
                shrinkA=0.0,
                shrinkB=220.0 * radius * 0.5,
                linewidth=0.3 + (WIDEST - 0.3) * share,
                color=ARROW,
                alpha=0.3 + 0.6 * share,
                zorder=1.0 + share,
            )
        )
    for spot, name, value in zip(place, names, sending, strict=True):
        known = np.isfinite(value)
        colour = painter.to_rgba(value) if known else (0.7, 0.7, 0.7, 1.0)
        ax.scatter(spot[0], spot[1], s=(150 * radius) ** 2, color=[colour], zorder=3, linewidths=0)
        if number <= MANY:
            ax.annotate(
                name,
                spot,
                ha="center",
                va="center",
                fontsize=9,
                zorder=4,
                color=DARK if known and shades(value) > 0.6 else "white",
                parse_math=False,
            )
    ax.set_xlim(-1.25, 1.25)
    ax.set_ylim(-1.25, 1.25)
    ax.set_aspect("equal")
    ax.set_axis_off()
    bar = figure.colorbar(painter, ax=ax, shrink=0.75)
    _label(bar.ax, "y", f"mean {PAIRS[strength]} on another", influence[strength])
    return figure, ax


def plot_influence_matrix(
    influence: xr.Dataset, ax: Axes | None = None, *, strength: str = "influence"
) -> tuple[Figure, Axes]:
    """Draw the matrix of who (column) moves whom (row).

    Parameters
    ----------
    influence, ax, strength
        As in :func:`plot_influence_network`.

    Returns
    -------
    Figure and axes. A dot marks what is less than 0.2 of the mean over pairs with 95 % of the
    posterior: hardly any influence.
    """
    figure, ax = new_axes(ax, (5.0, 4.4))
    pairs = _middle(influence, strength)
    names = [str(name) for name in influence["individual"].values]
    paint_ground(ax, UNKNOWN)
    image = ax.imshow(pairs, cmap=COLOURS, vmin=0.0, origin="upper")
    high = influence[strength].sel(quantile=0.95).transpose("individual", "neighbor").to_numpy()
    mean = _mean(pairs)
    weak = np.argwhere(high < 0.2 * mean)
    ax.plot(weak[:, 1], weak[:, 0], linestyle="", marker=".", markersize=5, color="white")
    if len(names) <= MANY:
        ax.set_xticks(range(len(names)), names, parse_math=False)
        ax.set_yticks(range(len(names)), names, parse_math=False)
    ax.set_xlabel("who moves")
    ax.set_ylabel("who is moved")
    bar = figure.colorbar(image, ax=ax)
    _label(bar.ax, "y", PAIRS[strength], influence[strength])
    return figure, ax


def plot_leadership(
    influence: xr.Dataset, ax: Axes | None = None, *, by: str = "auto"
) -> tuple[Figure, Axes]:
    """Draw individuals in the order of how much they move others, with 90 % intervals.

    Parameters
    ----------
    influence
        What :func:`swarmssm.analysis.interpretation.influence.influence` returned.
    ax
        Where to draw; new axes if absent.
    by
        ``"outgoing"`` influence along the path, ``"weight"`` of individuals, or ``"auto"``: weights
        if there are any.

    Returns
    -------
    Figure and axes; beside a dot and interval for each individual the probability that it ranks
    first, and, hollow, how much it is moved by others.
    """
    figure, ax = new_axes(ax, (5.4, 3.9))
    if by == "auto":
        by = "weight" if "weight" in influence else "outgoing"
    back, ranks = {
        "weight": ("responsiveness", "weight_rank_probability"),
        "outgoing": ("incoming", "rank_probability"),
    }[by]
    out = _interval(influence[by])
    order = np.argsort(np.where(np.isnan(out[1]), -np.inf, out[1]))
    names = np.array([str(name) for name in influence["individual"].values])
    first = influence[ranks].sel(rank=1).to_numpy()
    rows = np.arange(len(names))
    if back in influence:
        received = _interval(influence[back])[:, order]
        _draw_intervals(ax, received, rows - 0.22, "#7f7f7f", "how much it is moved", hollow=True)
    _draw_intervals(ax, out[:, order], rows, colour_of(""), "how much it moves another")
    if by == "weight":
        ax.axvline(1.0, color="#7f7f7f", linewidth=0.8, linestyle=":")
    if len(names) <= MANY:
        ax.set_yticks(rows, names[order], parse_math=False)
        for row, chance in zip(rows, first[order], strict=True):
            if chance >= 0.005:
                ax.annotate(
                    f"{100 * chance:.0f} %",
                    (1.01, row),
                    xycoords=("axes fraction", "data"),
                    fontsize=8,
                    va="center",
                )
        ax.annotate(
            "first",
            (1.01, 1.01),
            xycoords="axes fraction",
            fontsize=8,
            va="bottom",
        )
    else:
        ax.set_yticks([])
    ax.set_ylim(-0.8, len(names) - 0.4)
    ax.set_xlim(left=0.0)
    _label(ax, "x", "weight, mean of all = 1" if by == "weight" else "mean influence",
           influence[by])  # fmt: skip
    legend_below(ax)
    return figure, ax


def plot_influence(
    influence: xr.Dataset, axes: npt.NDArray[Any] | None = None
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw network, matrix and ranking side by side.

    Parameters
    ----------
    influence
        What :func:`swarmssm.analysis.interpretation.influence.influence` returned.
    axes
        Three axes; new ones if absent.

    Returns
    -------
    Figure and axes ``(3,)``. Where the model has weights of individuals the ranking is that of
    these, and the others are of influence along the path.
    """
    figure, grid = new_grid(axes, 1, 3, (15.6, 4.2))
    plot_influence_network(influence, grid[0, 0])
    plot_influence_matrix(influence, grid[0, 1])
    plot_leadership(influence, grid[0, 2])
    return figure, grid[0]


def _middle(influence: xr.Dataset, strength: str) -> npt.NDArray[np.float64]:
    """Return posterior medians ``(individual, neighbor)``."""
    pairs = influence[strength].sel(quantile=0.5).transpose("individual", "neighbor")
    values: npt.NDArray[np.float64] = pairs.to_numpy().astype(np.float64)
    return values


def _outgoing(pairs: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the mean over who is moved, NaN for one never seen with others."""
    known = np.isfinite(pairs)
    count = known.sum(0)
    total = np.where(known, pairs, 0.0).sum(0)
    mean: npt.NDArray[np.float64] = np.full(len(pairs), np.nan)
    np.divide(total, count, out=mean, where=count > 0)
    return mean


def _mean(values: npt.NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else 0.0


def _range(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Return limits of a scale that begins at 0."""
    known = values[np.isfinite(values)]
    highest = float(known.max()) if known.size else 0.0
    return 0.0, highest if highest > 0 else 1.0


def _interval(draws: xr.DataArray) -> npt.NDArray[np.float64]:
    """Return low, middle and high over draws, ``(3, individual)``."""
    values = draws.transpose(..., "individual").to_numpy()
    found: npt.NDArray[np.float64] = np.quantile(values, [0.05, 0.5, 0.95], axis=0)
    return found


def _draw_intervals(
    ax: Axes,
    interval: npt.NDArray[np.float64],
    rows: npt.NDArray[Any],
    colour: str,
    label: str,
    *,
    hollow: bool = False,
) -> None:
    """Draw a dot with an interval in each row."""
    low, middle, high = interval
    ax.hlines(rows, low, high, color=colour, linewidth=1.2 if hollow else 2.2)
    ax.plot(
        middle,
        rows,
        linestyle="",
        marker="o",
        markersize=4 if hollow else 6,
        color=colour,
        markerfacecolor="none" if hollow else colour,
        label=label,
    )


def _label(ax: Axes, axis: str, text: str, variable: xr.DataArray) -> None:
    """Label an axis, with the unit if there is one."""
    unit = format_unit(str(variable.attrs.get("units", "")))
    text = f"{text} ({unit})" if unit else text
    (ax.set_xlabel if axis == "x" else ax.set_ylabel)(text, parse_math=False)
