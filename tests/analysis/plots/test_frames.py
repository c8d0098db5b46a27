"""A frame is drawn where the tracks are: bodies, tails and edges."""

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from swarmssm.analysis.plots.frames import FramePicture, length_of
from swarmssm.analysis.plots.scenes import scenes_of
from swarmssm.analysis.plots.style import individual_colours
from swarmssm.tracks import make_tracks

BOX = (-10.0, 10.0, -10.0, 10.0)


def scene_of(position, graph=None):
    """One frame a second; nobody moves but along the given path."""
    return scenes_of(make_tracks(np.asarray(position, float), fps=1, adjacency=graph))[0]


@pytest.fixture
def ax():
    return Figure().add_subplot()


def test_a_dart_stands_where_it_is_and_points_where_it_goes(ax):
    # One goes up to (1, 3), another left to (-4, 0), a third rests at (5, 5), a fourth is away.
    before = [[1, 2], [-3, 0], [5, 5], [np.nan, np.nan]]
    after = [[1, 3], [-4, 0], [5, 5], [np.nan, np.nan]]
    picture = FramePicture(ax, scene_of([before, after]), BOX)
    picture.show(1)
    paths = [path.vertices for path in picture.bodies.get_paths()]
    assert len(paths) == 3
    up, left, still = paths
    far = picture.length
    np.testing.assert_allclose(up[np.argmax(up[:, 1])], [1.0, 3.0 + 0.6 * far], atol=1e-12)
    np.testing.assert_allclose(left[np.argmin(left[:, 0])], [-4.0 - 0.6 * far, 0.0], atol=1e-12)
    # A closed path repeats its first corner.
    np.testing.assert_allclose(still[:-1].mean(axis=0), [5.0, 5.0])
    np.testing.assert_allclose(np.linalg.norm(still[:-1] - 5.0, axis=1), 0.3 * far)
    colours = np.array([to_rgba(colour) for colour in individual_colours(3)])
    np.testing.assert_allclose(picture.bodies.get_facecolor(), colours)
    assert ax.get_xlim() == (-10.0, 10.0)
    assert ax.get_aspect() == 1.0


def test_a_tail_is_the_path_behind_and_fades(ax):
    path = np.arange(8.0)[:, None, None] * np.array([1.0, 0.5])
    path[3] = np.nan
    picture = FramePicture(ax, scene_of(path), BOX, tail=4)
    picture.show(7)
    # Frames 3 to 7, without the pieces to and from frame 3, which is not known.
    drawn = np.array(picture.tails.get_segments())
    expected = np.stack([[path[k, 0], path[k + 1, 0]] for k in (4, 5, 6)])
    np.testing.assert_array_equal(drawn, expected)
    alpha = picture.tails.get_colors()[:, 3]
    assert (np.diff(alpha) > 0).all()
    assert alpha[-1] == pytest.approx(0.75)
    picture.show(1)
    assert len(picture.tails.get_segments()) == 1
    picture.show(0)
    assert len(picture.tails.get_segments()) == 0


def test_edges_are_lines_where_mutual_and_arrows_where_not(ax):
    place = np.array([[[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [4.0, 4.0]]] * 2)
    graph = np.zeros((2, 4, 4))
    graph[:, 0, 1] = graph[:, 1, 0] = graph[:, 3, 2] = 1
    picture = FramePicture(ax, scene_of(place, graph), BOX)
    picture.show(0)
    (line,) = picture.edges.get_segments()
    np.testing.assert_array_equal(line, [[0.0, 0.0], [4.0, 0.0]])
    (arrow,) = picture.arrows.get_paths()
    # It begins at the fourth and ends short of the third, whom that one sees.
    corners = arrow.vertices
    assert corners[:, 0].max() == pytest.approx(4.0)
    assert corners[:, 0].min() == pytest.approx(0.5 * picture.length)
    np.testing.assert_allclose(corners[:-1, 1].mean(), 4.0)
    # Its head is at the end where it is seen: there it is widest.
    widest = corners[np.argmax(corners[:, 1])]
    assert widest[0] < 1.0
    bare = FramePicture(ax, scene_of(place, graph), BOX, edges=False)
    bare.show(0)
    assert not bare.edges.get_segments()
    assert not bare.arrows.get_paths()


def test_two_at_one_place_have_no_arrow(ax):
    graph = np.zeros((2, 2, 2))
    graph[:, 0, 1] = 1
    picture = FramePicture(ax, scene_of(np.ones((2, 2, 2)), graph), BOX)
    picture.show(0)
    assert not picture.arrows.get_paths()


def test_bodies_shrink_in_a_crowd():
    assert length_of(BOX, 5) == length_of(BOX, 25) == pytest.approx(0.028 * 20)
    assert length_of(BOX, 100) == pytest.approx(0.014 * 20)
