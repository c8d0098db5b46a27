"""The picture of a group at one time."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from swarmssm.analysis.plots.tracks import plot_tracks
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks


@pytest.fixture
def tracks():
    """Three go right by 1 a frame, at 10 frames a second; the third is lost after 0.6 s."""
    position = np.zeros((10, 3, 2))
    position[..., 0] = np.arange(10)[:, None]
    position[..., 1] = [0.0, 1.0, 2.0]
    position[7:, 2] = np.nan
    return make_tracks(position, fps=10, individuals=["a", "b", "c"], unit="m")


def centers_of(ax):
    bodies = [c for c in ax.collections if isinstance(c, PolyCollection)][-1]
    # The notch of a dart lies 0.2 of its length behind its middle: corners 0 to 3 are its outline.
    return [path.vertices[[0, 2]].mean(axis=0) for path in bodies.get_paths()]


def test_the_time_is_that_of_most_individuals_or_the_one_asked_for(tracks):
    figure, ax = plot_tracks(tracks, tail=3)
    assert isinstance(figure, Figure)
    assert ax.get_title() == "0.6 s"
    assert len(centers_of(ax)) == 3
    np.testing.assert_allclose([c[1] for c in centers_of(ax)], [0.0, 1.0, 2.0], atol=1e-12)
    (_, ax) = plot_tracks(tracks, at=0.84, individuals=["b", "c"], title="who")
    assert ax.get_title() == "who"
    ((_, height),) = centers_of(ax)
    assert height == pytest.approx(1.0)
    tails = next(c for c in ax.collections if isinstance(c, LineCollection))
    pieces = np.array(tails.get_segments())
    np.testing.assert_array_equal(pieces[pieces[:, 0, 1] == 1.0][:, 1, 0], np.arange(1, 9))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "y (m)")


def test_the_graph_is_that_of_the_tracks_or_of_a_rule(tracks):
    _, ax = plot_tracks(tracks)
    lines = [c for c in ax.collections if isinstance(c, LineCollection)]
    assert [len(c.get_segments()) for c in lines][1] == 0
    _, ax = plot_tracks(tracks, edges="radius:1.5", at=0.3)
    lines = [c for c in ax.collections if isinstance(c, LineCollection)]
    drawn = {tuple(np.ravel(one)) for one in lines[1].get_segments()}
    assert drawn == {(3.0, 0.0, 3.0, 1.0), (3.0, 1.0, 3.0, 2.0)}


def test_given_axes_are_used_and_mistakes_told(tracks):
    ax = Figure().add_subplot()
    assert plot_tracks(tracks, ax) == (ax.figure, ax)
    with pytest.raises(InputError, match="tail: it must be at least 0, and it is -1"):
        plot_tracks(tracks, tail=-1)
    with pytest.raises(InputError, match="start: 9 s lies outside"):
        plot_tracks(tracks, at=9.0)
