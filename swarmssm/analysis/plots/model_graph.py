"""A model as a directed graph: what is drawn given what, and what is seen of it."""

from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch
from matplotlib.text import Text

from swarmssm.analysis.plots.style import new_axes
from swarmssm.inference import Fit
from swarmssm.models import InferredEdges, LatentEdges, OneStepModel, StateSpaceModel
from swarmssm.models.edges import DynamicRelationalEdges
from swarmssm.models.parameters import priors_of

__all__ = ["plot_model"]

INK = "#000000"
SEEN = "#7f7f7f"
#: Names of parameters on one line, and lines in one box, at most.
NAMES_A_LINE = 2
LINES = 4
RADIUS = 0.3
#: Length of a unit on paper.
INCHES = 0.78


@dataclass(frozen=True)
class _Node:
    """A variable at its place; ``seen`` if it is observed, ``square`` if it is a graph."""

    name: str
    x: float
    y: float
    seen: bool = False
    square: bool = False


def plot_model(fit: Fit, ax: Axes | None = None) -> tuple[Figure, Axes]:
    """Draw a fitted model as a directed graphical model.

    Circles are variables of an individual, squares graphs between individuals, boxes parameters
    with a prior. What is shaded is observed; an arrow leads from what a variable is drawn given.

    Parameters
    ----------
    fit
        A fit; of a model of the user's own that is neither a
        :class:`~swarmssm.models.StateSpaceModel` nor a :class:`~swarmssm.models.OneStepModel` only
        its name is drawn.
    ax
        Where to draw; new axes if absent.

    Returns
    -------
    Figure and axes.
    """
    own = ax is None
    figure, ax = new_axes(ax)
    ax.set_axis_off()
    ax.set_aspect("equal")
    if isinstance(fit.model, StateSpaceModel):
        _state_space(ax, fit.model)
    elif isinstance(fit.model, OneStepModel):
        _one_step(ax)
    else:
        ax.text(0.0, 0.0, fit.settings.model, ha="center", va="center", parse_math=False)
        ax.set_xlim(-1, 1)
        ax.set_ylim(-0.5, 0.5)
    if own:
        # No more paper than is drawn on.
        (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
        figure.set_size_inches(INCHES * (right - left), INCHES * (high - low))
    return figure, ax


def _state_space(ax: Axes, model: StateSpaceModel) -> None:
    """Draw three steps of a state-space model."""
    times = ("t-1", "t", "t+1")
    exact = model.emission.is_exact
    hidden = isinstance(model.edges, LatentEdges | InferredEdges)
    of_states = isinstance(model.edges, LatentEdges | DynamicRelationalEdges)
    states, graphs, seen = [], [], []
    for place, time in enumerate(times):
        x = 2.0 * place
        states.append(_Node(f"$x_{{{time}}}$", x, 0.0, seen=exact))
        graphs.append(_Node(f"$A_{{{time}}}$", x + 0.7, 1.25, seen=not hidden, square=True))
        seen.append(_Node(f"$y_{{{time}}}$", x, -1.35, seen=True))
    for place in range(3):
        _draw(ax, states[place])
        if not exact:
            _draw(ax, seen[place])
            _arrow(ax, states[place], seen[place])
        if place == 2:
            continue
        _draw(ax, graphs[place])
        _arrow(ax, states[place], states[place + 1])
        _arrow(ax, graphs[place], states[place + 1])
        if of_states:
            _arrow(ax, states[place], graphs[place])
    names = priors_of(model)
    moves = [name.partition(".")[2] for name in names if name.startswith("transition.")]
    shows = [name.partition(".")[2] for name in names if name.startswith("emission.")]
    others = [name for name in names if not name.startswith(("transition.", "emission."))]
    if moves:
        _box(ax, "transition", moves, (2.0, 2.75), states[1:])
    if shows:
        _box(ax, "emission", shows, (5.85, -1.35), seen[2:])
    if others:
        _box(ax, "also with a prior", others, (5.85, 0.6), [])
    _plate(ax, (-0.75, -2.05), (4.75, 0.75), "individuals")
    ax.set_xlim(-1.0, 6.8 if shows or others else 5.0)
    ax.set_ylim(-2.2, 3.6 if moves else 1.9)


def _one_step(ax: Axes) -> None:
    """Draw a model that predicts each frame from the one before."""
    before = _Node("$x_t, A_t$", 0.0, 0.0, seen=True)
    latent = _Node("$z_t$", 2.2, 0.0)
    after = _Node("$x_{t+1}$", 4.4, 0.55, seen=True)
    graph = _Node("$A_{t+1}$", 4.4, -0.75, seen=True, square=True)
    for node in (before, latent, after, graph):
        _draw(ax, node)
    _arrow(ax, before, latent, dashed=True)
    _arrow(ax, latent, after)
    _arrow(ax, latent, graph)
    ax.text(1.1, 0.18, "guide", ha="center", fontsize=9, color=INK)
    ax.text(3.2, 0.62, "decoder", ha="center", fontsize=9, color=INK)
    ax.text(2.2, 0.5, "N(0, I)", ha="center", fontsize=9, color=INK)
    ax.set_xlim(-0.8, 5.2)
    ax.set_ylim(-1.2, 1.05)


def _draw(ax: Axes, node: _Node) -> None:
    """Draw a variable."""
    style: dict[str, Any] = {"edgecolor": INK, "linewidth": 1.2, "zorder": 2}
    face = (*_rgb(SEEN), 0.35) if node.seen else "none"
    if node.square:
        corner = (node.x - RADIUS + 0.05, node.y - RADIUS + 0.05)
        side = 2 * RADIUS - 0.1
        square = FancyBboxPatch(corner, side, side, boxstyle="square,pad=0.05", **style)
        square.set_facecolor(face)
        ax.add_patch(square)
    else:
        wide = RADIUS if "," not in node.name else 1.6 * RADIUS
        ax.add_patch(Circle((node.x, node.y), wide, facecolor=face, **style))
    ax.text(node.x, node.y, node.name, ha="center", va="center", fontsize=11, color=INK, zorder=3)


def _rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue."""
    red, green, blue = (int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5))
    return red, green, blue


def _arrow(ax: Axes, source: _Node, target: _Node, *, dashed: bool = False) -> None:
    """Draw an arrow from edge to edge of two variables."""
    ends = [(node.x, node.y) for node in (source, target)]
    (x, y), (to_x, to_y) = ends
    length = ((to_x - x) ** 2 + (to_y - y) ** 2) ** 0.5
    along = ((to_x - x) / length, (to_y - y) / length)
    widths = [
        (1.6 if "," in node.name else 1.2 if node.square else 1.0) * RADIUS + 0.06
        for node in (source, target)
    ]
    start = (x + widths[0] * along[0], y + widths[0] * along[1])
    end = (to_x - widths[1] * along[0], to_y - widths[1] * along[1])
    _straight(ax, start, end, dashed=dashed)


def _straight(
    ax: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    *,
    dashed: bool = False,
    of: Text | None = None,
) -> None:
    """Draw an arrow between two points, or from the border of a text in a box."""
    ax.add_patch(
        FancyArrowPatch(
            start,
            end,
            arrowstyle="-|>",
            mutation_scale=11,
            patchA=None if of is None else of.get_bbox_patch(),
            shrinkA=0 if of is None else 3,
            shrinkB=0,
            color=INK,
            linewidth=1.1,
            linestyle="--" if dashed else "-",
            zorder=1,
        )
    )


def _box(
    ax: Axes, title: str, names: list[str], place: tuple[float, float], targets: list[_Node]
) -> None:
    """Draw parameters with a prior, and arrows to what they govern."""
    lines = [
        ", ".join(names[first : first + NAMES_A_LINE])
        for first in range(0, len(names), NAMES_A_LINE)
    ]
    if len(lines) > LINES:
        left = len(names) - (LINES - 1) * NAMES_A_LINE
        lines = [*lines[: LINES - 1], f"and {left} more"]
    text = "\n".join([f"{title}:", *lines])
    style = {"boxstyle": "round,pad=0.35", "facecolor": "none", "edgecolor": INK}
    box = ax.text(
        *place, text, ha="center", va="center", fontsize=8.5, color=INK, bbox=style, zorder=3
    )
    for target in targets:
        above = target.y < place[1]
        end = (
            (target.x + 0.35 * RADIUS, target.y + RADIUS + 0.05)
            if above
            else (target.x + RADIUS + 0.06, target.y)
        )
        _straight(ax, place, end, of=box)


def _plate(ax: Axes, low: tuple[float, float], high: tuple[float, float], text: str) -> None:
    """Draw a frame around what there is once for each individual."""
    (left, bottom), (right, top) = low, high
    ax.add_patch(
        FancyBboxPatch(
            low,
            right - left,
            top - bottom,
            boxstyle="round,pad=0.0,rounding_size=0.15",
            facecolor="none",
            edgecolor=SEEN,
            linewidth=1.0,
            zorder=0,
        )
    )
    ax.text(right - 0.1, bottom + 0.08, text, ha="right", va="bottom", fontsize=8.5, color=SEEN)
