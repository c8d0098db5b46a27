"""One frame of a scene on axes: tails, edges and individuals, to be moved on frame by frame."""

import math

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.colors import to_rgba

from swarmssm.analysis.plots.scenes.scene import Box, Scene
from swarmssm.analysis.plots.style import individual_colours, label_axes, set_box
from swarmssm.tracks import Array

__all__ = ["FramePicture", "length_of"]

EDGE = "#7f7f7f"
#: More edges than this are drawn faint.
MANY_EDGES = 500
#: Length of an individual as a share of the longer side of the box, and how it shrinks in a crowd.
LENGTH, CROWD = 0.028, 25
#: An individual that looks along the first axis: tip, wing, notch, wing; of length 1, its middle
#: at the origin. One whose heading is not known is a disc.
DART = np.array([[0.6, 0.0], [-0.4, 0.3], [-0.2, 0.0], [-0.4, -0.3]])
_TURN = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
DISC = 0.3 * np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)


def length_of(box: Box, count: int) -> float:
    """Return the length of an individual of so many, in the unit of the box."""
    left, right, bottom, top = box
    shrunk = math.sqrt(min(1.0, CROWD / max(count, 1)))
    return LENGTH * max(right - left, top - bottom) * shrunk


class FramePicture:
    """Draws a scene on axes, one frame at a time.

    Parameters
    ----------
    ax
        Where to draw; its limits become those of the box.
    scene
        What to draw.
    box
        ``(left, right, bottom, top)``.
    tail
        Frames of path behind each individual.
    edges
        Whether to draw the graph, if there is one.

    Attributes
    ----------
    tails, edges, bodies
        The collections. A tail is a line from frame to frame, fainter the longer ago; an edge is
        a line where both see each other, else an arrow from i to j: i sees j.
    """

    def __init__(
        self, ax: Axes, scene: Scene, box: Box, *, tail: int = 25, edges: bool = True
    ) -> None:
        self.scene, self.tail = scene, tail
        count = max(len(scene.individuals), 1)
        self.length = length_of(box, count)
        self._colours = np.array([to_rgba(colour) for colour in individual_colours(count)])
        self._graph = scene.adjacency if edges else None
        self.tails = LineCollection([], linewidths=1.1, capstyle="round", zorder=1)
        self.edges = LineCollection([], colors=EDGE, linewidths=0.8, zorder=2)
        self.arrows = PolyCollection([], facecolors=EDGE, linewidths=0, zorder=2)
        self.bodies = PolyCollection([], linewidths=0, zorder=3)
        for collection in self._artists():
            ax.add_collection(collection, autolim=False)
        label_axes(ax, scene.space, {"unit": scene.unit, "y_axis": scene.y_axis})
        set_box(ax, box)

    def show(self, row: int) -> list[Collection]:
        """Draw that frame, and return what was moved."""
        place, angle = self.scene.position[row], self.scene.heading[row]
        seen = np.flatnonzero(np.isfinite(place).all(axis=-1))
        self._draw_tails(row)
        if self._graph is not None:
            self._draw_edges(place, self._graph[row])
        self.bodies.set_verts([self._body(place[one], angle[one]) for one in seen])
        self.bodies.set_facecolor([tuple(colour) for colour in self._colours[seen]])
        return self._artists()

    def _artists(self) -> list[Collection]:
        return [self.tails, self.edges, self.arrows, self.bodies]

    def _draw_tails(self, row: int) -> None:
        first = max(0, row - self.tail)
        path = self.scene.position[first : row + 1]
        pieces = np.stack([path[:-1], path[1:]], axis=2)
        there = np.isfinite(pieces).all(axis=(-1, -2))
        age, who = np.nonzero(there)
        colours = self._colours[who]
        # The newest piece is the last of the path.
        colours[:, 3] = 0.75 * (age + 1 + self.tail - len(pieces)) / max(self.tail, 1)
        self.tails.set_segments(list(pieces[there]))
        self.tails.set_color(list(colours))

    def _draw_edges(self, place: Array, graph: npt.NDArray[np.bool_]) -> None:
        mutual = np.argwhere(np.triu(graph & graph.T))
        one_way = np.argwhere(graph & ~graph.T)
        alpha = 0.15 if len(mutual) + len(one_way) > MANY_EDGES else 0.45
        self.edges.set_segments(list(place[mutual]))
        self.edges.set_alpha(alpha)
        self.arrows.set_verts(self._arrows(place[one_way[:, 0]], place[one_way[:, 1]]))
        self.arrows.set_alpha(alpha)

    def _body(self, place: Array, angle: float) -> Array:
        """Return the outline of an individual."""
        if not np.isfinite(angle):
            return place + self.length * DISC
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        outline: Array = place + self.length * DART @ turn
        return outline

    def _arrows(self, start: Array, end: Array) -> list[Array]:
        """Return arrows: thin shafts with heads that end short of who is seen."""
        along = end - start
        distance = np.linalg.norm(along, axis=-1)
        far = distance > 0
        start, along, distance = start[far], along[far], distance[far, None]
        unit = along / distance
        across = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
        reach = np.maximum(distance - 0.5 * self.length, 0.5 * distance)
        head = np.minimum(0.5 * self.length, 0.5 * reach)
        thin, wide = 0.04 * self.length, 0.35 * head
        neck, tip = start + (reach - head) * unit, start + reach * unit
        corners = (
            start + thin * across,
            neck + thin * across,
            neck + wide * across,
            tip,
            neck - wide * across,
            neck - thin * across,
            start - thin * across,
        )
        return list(np.stack(corners, axis=1))
