"""Pictures of what a fit is made of: the recording with its gaps, and the model as a graph."""

import numpy as np
import pytest
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.text import Text

from swarmssm import inference
from swarmssm.analysis.plots.model_graph import plot_model
from swarmssm.analysis.plots.presence import COLUMNS, plot_presence
from swarmssm.tracks import make_tracks


def recording(trials, frames, gaps=()):
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0.0, 0.1, (trials, frames, 3, 2)), axis=1)
    for place in gaps:
        path[place] = np.nan
    return make_tracks(path, fps=10.0, individuals=["ann", "bob", "cy"], unit="cm")


def test_gaps_are_blank_where_they_are():
    tracks = recording(1, 20, [(0, slice(5, 9), 1), (0, 19, 2)])
    _, ax = plot_presence(tracks)
    image = ax.images[0]
    expected = np.ones((3, 20))
    expected[1, 5:9] = expected[2, 19] = 0.0
    np.testing.assert_array_equal(image.get_array(), expected)
    assert image.get_extent() == [0.0, 2.0, 2.5, -0.5]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["ann", "bob", "cy"]


def test_trials_stand_after_one_another():
    _, ax = plot_presence(recording(3, 8, [(1, slice(None), 0)]))
    image = ax.images[0].get_array()
    assert image.shape == (3, 24)
    np.testing.assert_array_equal(np.flatnonzero(image[0] == 0), np.arange(8, 16))
    assert sorted(line.get_xdata()[0] for line in ax.lines) == [8, 16]


def test_frames_of_a_long_recording_share_columns():
    """Of 2500 frames three share one; the last column has but one."""
    _, ax = plot_presence(recording(1, 2500, [(0, 3, 0), (0, 2499, 0)]))
    image = ax.images[0].get_array()
    assert image.shape == (3, 834)
    assert image.shape[1] <= COLUMNS
    assert image[0, 1] == pytest.approx(2 / 3)
    assert image[0, -1] == 0.0
    assert image[0].sum() == pytest.approx(834 - 1 / 3 - 1)


def drawn(ax, kind):
    return [part for part in ax.get_children() if isinstance(part, kind)]


def words(ax):
    return " ".join(part.get_text() for part in drawn(ax, Text))


@pytest.fixture(scope="module")
def swarm():
    return recording(2, 30)


def test_a_state_space_model_is_drawn_with_its_priors(swarm):
    fit = inference.fit("boids", swarm, guide="markov", steps=1, model_options={"limits": False})
    _, ax = plot_model(fit)
    assert len(drawn(ax, Circle)) == 6
    # Three emissions, two transitions, two graphs, two from the transition's box, one from noise.
    assert len(drawn(ax, FancyArrowPatch)) == 10
    text = words(ax)
    assert "transition:\ncohesion_gain, separation_gain\nalignment_gain, wall_gain" in text
    assert "emission:\nnoise" in text
    shades = [circle.get_facecolor()[3] > 0 for circle in drawn(ax, Circle)]
    assert sum(shades) == 3


def test_without_priors_there_are_no_boxes(swarm):
    fit = inference.fit("graph-ssm", swarm, steps=1)
    _, ax = plot_model(fit)
    assert len(drawn(ax, FancyArrowPatch)) == 7
    assert "transition" not in words(ax)


def test_a_one_step_model_has_one_latent(swarm):
    fit = inference.fit("graph-vae", swarm, guide="encoder", epochs=1)
    _, ax = plot_model(fit)
    faces = [circle.get_facecolor()[3] > 0 for circle in drawn(ax, Circle)]
    assert faces == [True, False, True]
    styles = [arrow.get_linestyle() for arrow in drawn(ax, FancyArrowPatch)]
    assert styles == ["--", "-", "-"]


def test_a_picture_of_its_own_is_no_larger_than_what_is_drawn(swarm):
    fit = inference.fit("graph-vae", swarm, guide="encoder", epochs=1)
    figure, ax = plot_model(fit)
    width, height = figure.get_size_inches()
    across, up = np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())
    assert height / width == pytest.approx(up / across)
    given = figure.add_subplot()
    plot_model(fit, given)
    assert tuple(figure.get_size_inches()) == (width, height)
