"""What is shown is what was tracked, and a prediction at the same times."""

import numpy as np
import pytest

from swarmssm.analysis.plots.scenes.scene import box_of, pace_of, scenes_of
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks


def walkers(frames=6, start=0.0, **more):
    """At 10 frames a second: a goes right by 1 a frame, b up by 2, c rests at (5, 5).

    c is not tracked in frame 2; a sees b, and b and c see each other.
    """
    position = np.zeros((frames, 3, 2))
    position[:, 0, 0] = np.arange(frames)
    position[:, 1, 1] = 2.0 * np.arange(frames)
    position[:, 2] = 5.0
    position[2:3, 2] = np.nan
    graph = np.zeros((frames, 3, 3))
    graph[:, 0, 1] = graph[:, 1, 2] = graph[:, 2, 1] = 1
    time = start + np.arange(frames) / 10.0
    return make_tracks(
        position, time=time, adjacency=graph, individuals=["a", "b", "c"], unit="cm", **more
    )


def test_a_scene_holds_places_headings_and_graph():
    tracks = walkers()
    (scene,) = scenes_of(tracks)
    np.testing.assert_array_equal(
        scene.position, tracks["position"].transpose("time", "individual", "space")
    )
    # Nobody has moved in the first frame, and c never does.
    np.testing.assert_allclose(scene.heading[1:, 0], 0.0)
    np.testing.assert_allclose(scene.heading[1:, 1], np.pi / 2)
    assert np.isnan(scene.heading[0]).all()
    assert np.isnan(scene.heading[:, 2]).all()
    expected = np.array([[0, 1, 0], [0, 0, 1], [0, 1, 0]], dtype=bool)
    np.testing.assert_array_equal(scene.adjacency[0], expected)
    # Nobody sees, or is seen by, who is not tracked.
    np.testing.assert_array_equal(scene.adjacency[2], [[0, 1, 0], [0, 0, 0], [0, 0, 0]])
    assert (scene.individuals, scene.unit, scene.rate) == (("a", "b", "c"), "cm", 10.0)
    assert scene.space == ("x", "y")
    assert not scene.flat


def test_frames_and_individuals_are_chosen():
    (scene,) = scenes_of(walkers(12), start=0.25, steps=6, every=3, individuals=["c", "a"])
    np.testing.assert_allclose(scene.time, [0.2, 0.5, 0.8])
    assert scene.individuals == ("a", "c")
    np.testing.assert_array_equal(scene.position[:, 0, 0], [2.0, 5.0, 8.0])
    # A heading comes from the frame before, not from the frame that is shown before.
    np.testing.assert_allclose(scene.heading[:, 0], 0.0)
    assert scene.adjacency.shape == (3, 2, 2)
    assert scene.rate == pytest.approx(10 / 3)


def test_without_an_end_it_stops_where_the_last_one_is_seen():
    tracks = walkers()
    tracks["position"][4:] = np.nan
    (scene,) = scenes_of(tracks)
    assert len(scene.time) == 4
    with pytest.raises(InputError, match=r"nobody is tracked after 0.3 s"):
        scenes_of(tracks, start=0.5)


def test_the_heading_of_who_rests_is_the_last_one():
    tracks = walkers()
    tracks["position"][3:, :, 0] = tracks["position"][2, :, 0]
    (scene,) = scenes_of(tracks)
    np.testing.assert_allclose(scene.heading[1:, 0], 0.0)


def test_a_rule_makes_the_graph_and_none_is_none():
    (scene,) = scenes_of(walkers(), edges="radius:2.5")
    # In frame 1 a is at (1, 0), b at (0, 2): sqrt(5) apart; then they part.
    assert scene.adjacency[1, 0, 1]
    assert not scene.adjacency[3].any()
    assert scenes_of(walkers(), edges=False)[0].adjacency is None
    assert scenes_of(walkers().drop_vars("adjacency"))[0].adjacency is None


def test_a_prediction_stands_at_the_same_times():
    tracks, predicted = walkers(), walkers(3, start=0.2)
    observed, other = scenes_of(tracks, predicted)
    np.testing.assert_array_equal(observed.time, other.time)
    assert np.isnan(other.position[[0, 1, 5]]).all()
    np.testing.assert_array_equal(other.position[2:5, 0, 0], [0.0, 1.0, 2.0])
    assert not other.adjacency[0].any()
    assert other.adjacency[2, 0, 1]
    # One that begins at 0 is put where it began.
    _, moved = scenes_of(tracks, walkers(3), predicted_start=0.2)
    np.testing.assert_array_equal(moved.position, other.position)
    # Half as many frames a second: each goes with the frames that are nearest in time.
    _, slow = scenes_of(walkers(5), predicted.isel(time=[0, 2]).assign_attrs(fps=5.0))
    np.testing.assert_array_equal(slow.position[1:, 0, 0], [0.0, 0.0, 0.0, 2.0])


def test_a_prediction_may_be_of_others():
    strangers = walkers().assign_coords(individual=["x", "b", "z"], neighbor=["x", "b", "z"])
    assert scenes_of(walkers(), strangers)[1].individuals == ("x", "b", "z")
    assert scenes_of(walkers(), strangers, individuals=["a", "b"])[1].individuals == ("b",)
    with pytest.raises(InputError, match="it has none of the individuals a"):
        scenes_of(walkers(), strangers, individuals=["a"])


def test_three_dimensions_are_seen_from_above():
    position = np.random.default_rng(0).normal(size=(4, 2, 3))
    tracks = make_tracks(position, fps=5)
    (scene,) = scenes_of(tracks)
    assert scene.flat
    np.testing.assert_array_equal(scene.position, position[..., :2])
    step = position[1:] - position[:-1]
    np.testing.assert_allclose(scene.heading[1:], np.arctan2(step[..., 1], step[..., 0]))


def test_the_box_holds_the_tracks_and_a_prediction_as_far_as_is_sensible():
    tracks = walkers()
    (scene,) = scenes_of(tracks)
    # x from 0 to 5, y from 0 to 10, and a margin of a twentieth of 10.
    assert box_of([scene]) == ((-0.5, 5.5, -0.5, 10.5), False)
    near, far = walkers(), walkers()
    near["position"][5, 0, 0] = 9.0
    far["position"][5, 0, 0] = 90.0
    assert box_of(scenes_of(tracks, near)) == ((-0.5, 9.5, -0.5, 10.5), False)
    assert box_of(scenes_of(tracks, far)) == ((-0.5, 10.5, -0.5, 10.5), True)
    (still,) = scenes_of(tracks, individuals=["c"])
    left, right, bottom, top = box_of([still])[0]
    assert left < 5.0 < right
    assert bottom < 5.0 < top


def test_it_is_shown_as_fast_as_it_was_if_one_can_see_that():
    (scene,) = scenes_of(walkers())
    assert pace_of(scene, None) == 10.0
    assert pace_of(scene, 3) == 3.0
    assert pace_of(scene, None, fastest=8.0) == 8.0
    (slow,) = scenes_of(walkers(), every=5)
    assert pace_of(slow, None) == 25.0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"every": 0}, "every: it must be at least 1, and it is 0"),
        ({"steps": 0}, "steps: it must be at least 1, and it is 0"),
        ({"start": 7.0}, "start: 7 s lies outside of the tracks, which run from 0 s to 0.5 s"),
        ({"start": -1.0}, "start: -1 s lies outside"),
        ({"trial": "z"}, "tracks: there is no trial 'z'; there are 0"),
        ({"individuals": ["a", "q"]}, "individuals: there is no 'q'; there are a, b, c"),
        ({"individuals": []}, "individuals: none is named; there are a, b, c"),
        ({"edges": "nearest"}, "graph: the kind 'nearest' is unknown"),
    ],
)
def test_mistakes_are_told(options, sentence):
    with pytest.raises(InputError, match=sentence):
        scenes_of(walkers(), **options)


def test_a_prediction_that_does_not_fit_is_refused():
    with pytest.raises(InputError, match=r"its times, 9 s to 9.5 s, have none in common"):
        scenes_of(walkers(), walkers(start=9.0))
    with pytest.raises(InputError, match="it holds 4 draws, and one path is to be shown"):
        scenes_of(walkers(), walkers().expand_dims(draw=4))
    with pytest.raises(InputError, match="fps_out: it must be a positive number, and it is -1"):
        pace_of(scenes_of(walkers())[0], -1)
    both = np.stack([np.full((4, 1, 2), np.nan), np.zeros((4, 1, 2))])
    with pytest.raises(InputError, match="in trial empty nobody is ever tracked"):
        scenes_of(make_tracks(both, fps=1, trials=["empty", "other"]))
