"""How all figures look: one colour a method everywhere, readable to the colour-blind."""

import contextlib
import inspect
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter, MaxNLocator

from swarmssm.errors import InputError
from swarmssm.files import write_beside

__all__ = [
    "FIGURE_FORMATS",
    "LINE_STYLES",
    "MODEL_COLOUR",
    "colour_of",
    "dot_size",
    "individual_colours",
    "label_axes",
    "label_outer",
    "legend_below",
    "log_scale",
    "millimetres",
    "new_axes",
    "new_grid",
    "paint_ground",
    "save_figure",
    "set_box",
    "whole_numbers",
]

#: Formats of figures, and the least and the most width in millimetres.
FIGURE_FORMATS = ("pdf", "svg", "png")
LEAST_WIDTH, MOST_WIDTH = 20.0, 1000.0
#: Letters and lines do not get smaller, in points.
LEAST_LETTER, LEAST_LINE = 5.0, 0.4
#: Okabe and Ito's colours, darkened where they would fade on white; all but black, which a page in
#: the dark replaces by its own ink, are seen on black too.
COLOURS = {
    "truth": "#000000",
    "stay-put": "#b8860b",
    "constant-velocity": "#cc5f00",
    "noise-floor": "#009e73",
    "commoner": "#7f7f7f",
}
MODEL_COLOUR = "#2f86c6"
LINE_STYLES = {
    "truth": "-",
    "stay-put": ":",
    "constant-velocity": "--",
    "noise-floor": "-.",
    "commoner": (0, (1, 3)),
}
INDIVIDUALS = (
    "#2f86c6",
    "#cc5f00",
    "#009e73",
    "#c4679b",
    "#b8860b",
    "#5c7fb8",
    "#a0522d",
    "#6b8e23",
    "#8a6fc8",
    "#7f7f7f",
)


def colour_of(method: str) -> str:
    """Return the colour of a method, the same in every figure; the model has what is left."""
    return COLOURS.get(method, MODEL_COLOUR)


def dot_size(count: int, size: float) -> float:
    """Return the area of one of many dots, so that a crowd does not become one blot."""
    return max(2.0, size * min(1.0, 30 / max(count, 1)))


def individual_colours(count: int) -> list[str]:
    """Return a colour for each individual, repeated beyond ten."""
    return [INDIVIDUALS[index % len(INDIVIDUALS)] for index in range(count)]


def _new_figure(size: tuple[float, float]) -> Figure:
    """Return a figure without touching pyplot, but in a notebook one that the cell shows."""
    if "inline" in os.environ.get("MPLBACKEND", ""):
        import matplotlib.pyplot as plt

        if plt.isinteractive():
            return plt.figure(figsize=size, layout="constrained")
    return Figure(figsize=size, layout="constrained")


def new_axes(ax: Axes | None, size: tuple[float, float] = (6.4, 4.1)) -> tuple[Figure, Axes]:
    """Return the given axes with their figure, or new ones."""
    if ax is None:
        figure = _new_figure(size)
        return figure, figure.add_subplot()
    return figure_of(ax), ax


def new_grid(
    axes: npt.NDArray[Any] | None,
    rows: int,
    columns: int,
    size: tuple[float, float],
    **shared: Any,
) -> tuple[Figure, npt.NDArray[Any]]:
    """Return the given axes ``(rows, columns)`` with their figure, or new ones."""
    if axes is None:
        figure = _new_figure(size)
        return figure, figure.subplots(rows, columns, squeeze=False, **shared)
    given = np.asarray(axes, dtype=object)
    if given.size != rows * columns:
        raise InputError(f"axes: {rows * columns} are needed, and {given.size} are given.")
    given = given.reshape(rows, columns)
    return figure_of(given[0, 0]), given


def figure_of(ax: Axes) -> Figure:
    """Return the figure that axes belong to, also from within a sub-figure."""
    figure = ax.get_figure(root=True) if _knows_root() else ax.figure
    if not isinstance(figure, Figure):
        raise InputError("ax: these axes belong to no figure. Take those of a figure.")
    return figure


def _knows_root() -> bool:
    """Return whether this matplotlib can tell a sub-figure from its figure (3.10 and later)."""
    return "root" in inspect.signature(Axes.get_figure).parameters


def paint_ground(ax: Axes, colour: str) -> None:
    """Paint what lies behind all else; unlike the face of axes it stays in a transparent figure.

    Without it colours that let light through, and cells that hold nothing, would look otherwise in
    a page in the dark.
    """
    whole = Rectangle((0.0, 0.0), 1.0, 1.0, transform=ax.transAxes)
    whole.set(facecolor=colour, linewidth=0.0, zorder=-10.0)
    ax.add_artist(whole)


def label_axes(ax: Axes, coordinates: Iterable[Any], attributes: Mapping[str, Any]) -> None:
    """Label space axes, draw both to the same scale, and y downwards where it grows so.

    Parameters
    ----------
    ax
        The axes.
    coordinates
        Names of the coordinates.
    attributes
        ``unit`` of length and ``y_axis``, as tracks have them.
    """
    unit = str(attributes.get("unit", ""))
    first, second = (f"{name} ({unit})" if unit else name for name in list(coordinates)[:2])
    if attributes.get("y_axis") == "down":
        ax.yaxis.set_inverted(True)
    # A unit is the user's own text: a dollar in it is a dollar, not the start of a formula.
    ax.set_xlabel(first, parse_math=False)
    ax.set_ylabel(second, parse_math=False)
    ax.set_aspect("equal", adjustable="datalim")
    # Few, so that the labels of panels beside each other do not touch.
    ax.locator_params(nbins=5)


def set_box(ax: Axes, box: tuple[float, float, float, float]) -> None:
    """Set the limits ``(left, right, bottom, top)``; an axis of y that points down still does."""
    left, right, bottom, top = box
    is_down = ax.yaxis.get_inverted()
    ax.set_xlim(left, right)
    ax.set_ylim((top, bottom) if is_down else (bottom, top))
    ax.set_aspect("equal", adjustable="box")


def legend_below(ax: Axes, columns: int = 3) -> None:
    """Put the legend below the axes, where it hides nothing."""
    below = (0.5, -0.16)
    ax.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=below, ncols=columns)


def label_outer(grid: npt.NDArray[Any]) -> None:
    """Label only the left and the lowest of axes that have the same limits."""
    for row, line in enumerate(grid):
        for column, ax in enumerate(line):
            ax.tick_params(labelleft=column == 0, labelbottom=row == len(grid) - 1)
            if column:
                ax.set_ylabel("")
            if row < len(grid) - 1:
                ax.set_xlabel("")


def log_scale(ax: Axes) -> None:
    """Give the y axis a logarithmic scale with plain numbers, also within less than a decade."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(_PlainLogFormatter())
    ax.yaxis.set_minor_formatter(_PlainLogFormatter(minor_thresholds=(1.5, 0.5)))


class _PlainLogFormatter(LogFormatter):
    """Labels where its parent has some, and writes 0.02 rather than 2e-02."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the label of a tick."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def whole_numbers(ax: Axes) -> None:
    """Let the x axis have ticks at whole numbers only."""
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))


def save_figure(figure: Figure, path: Path | str, width: float | str | None = None) -> None:
    """Write a figure to a file as a paper wants it.

    Text stays text: of TrueType fonts in PDF, of the page's fonts in SVG.

    Parameters
    ----------
    figure
        What any ``plot_`` function returned first.
    path
        Ends in ``.pdf``, ``.svg`` or ``.png`` (300 dots per inch). A file of that name is replaced.
    width
        In millimetres, ``85`` or ``"85mm"``; the height follows. Letters and lines shrink with the
        figure, letters to 5 points at the least. Default: the figure's own.

    Raises
    ------
    InputError
        If the format or the width is none of these, or the figure has no room in the width.
    WorkError
        If the file cannot be written.
    """
    target = Path(path)
    format = target.suffix.lower().removeprefix(".")
    if format not in FIGURE_FORMATS:
        raise InputError(f"{target}: figures are written as {', '.join(FIGURE_FORMATS)}.")
    if width is not None:
        _resize(figure, millimetres(width) / 25.4)
    with (
        _no_room(target),
        mpl.rc_context({"pdf.fonttype": 42, "svg.fonttype": "none"}),
        write_beside(target, overwrite=True) as temporary,
    ):
        figure.savefig(temporary, format=format, dpi=300)


def _resize(figure: Figure, inches: float) -> None:
    """Give a figure another width, its letters and lines with it where it shrinks."""
    width, height = figure.get_size_inches()
    ratio = inches / width
    figure.set_size_inches(inches, height * ratio)
    if ratio >= 1.0:
        return
    for ax in figure.get_axes():
        for axis in (ax.xaxis, ax.yaxis):
            for label in axis.get_ticklabels()[:1]:
                # Ticks are made anew when the figure is drawn.
                axis.set_tick_params(labelsize=max(LEAST_LETTER, ratio * label.get_fontsize()))
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_fontsize(max(LEAST_LETTER, min(ratio * text.get_fontsize(), text.get_fontsize())))
    for line in figure.findobj(Line2D):
        assert isinstance(line, Line2D)
        line.set_linewidth(max(LEAST_LINE, ratio * line.get_linewidth()))
        line.set_markersize(ratio * line.get_markersize())


@contextlib.contextmanager
def _no_room(target: Path) -> Iterator[None]:
    """Refuse a figure whose axes have no room beside their labels."""
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*collapsed to zero")
        try:
            yield
        except UserWarning as warning:
            raise InputError(
                f"{target}: the figure has no room for its labels. Give a larger width."
            ) from warning


def millimetres(width: float | str) -> float:
    """Return a width in millimetres from ``85``, ``"85mm"``, ``"8.5cm"`` or ``"3.3in"``.

    Raises
    ------
    InputError
        If it is no width.
    """
    text = str(width).strip().lower()
    factor = 1.0
    for ending, scale in (("mm", 1.0), ("cm", 10.0), ("in", 25.4)):
        if text.endswith(ending):
            text, factor = text.removesuffix(ending), scale
    try:
        value = factor * float(text)
    except ValueError:
        value = 0.0
    if not LEAST_WIDTH <= value <= MOST_WIDTH:
        raise InputError(
            f"width: {width!r} is no width from {LEAST_WIDTH:g} to {MOST_WIDTH:g} mm. Write 85mm, "
            "8.5cm or 3.3in."
        )
    return value
