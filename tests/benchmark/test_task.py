"""What is given and what is scored, counted by hand."""

import pickle

import numpy as np
import pytest

from swarmssm.benchmark import make_task
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks, states_of
from swarmssm.tracks.splits import take

from .conftest import straight


def test_a_recording_is_cut_in_time_and_its_history_reaches_back():
    task = make_task(straight(200), origins=1000)
    # 70 % and 15 % of 200 frames before it: the test part is 170 to 199.
    (segment,) = task.split.test
    assert (segment.start, segment.stop) == (170, 200)
    # 49 frames before it are history and not scored.
    assert task.states.shape[1] == 49 + 30
    np.testing.assert_array_equal(np.flatnonzero(task.mask[0, :, 0]), np.arange(49, 79))
    trials, rows = task.forecast_origins
    # From the last frame that is not scored to the last but one.
    np.testing.assert_array_equal(rows, np.arange(48, 78))
    assert not trials.any()
    assert task.steps == (1, 2, 5, 10, 20)


def test_a_trial_that_is_all_test_begins_to_be_scored_after_a_history():
    task = make_task(straight(100, trials=4), split_by="trial")
    (segment,) = task.split.test
    assert (segment.start, segment.stop) == (0, 100)
    # A quarter of it, which is less than 49 frames.
    assert np.flatnonzero(task.mask[0, :, 0])[0] == 25
    longer = make_task(straight(400, trials=4), split_by="trial")
    assert np.flatnonzero(longer.mask[0, :, 0])[0] == 49


def test_what_comes_after_an_origin_is_the_truth():
    tracks = straight(200)
    task = make_task(tracks)
    trials, rows = task.forecast_origins
    ahead = task.scored.ahead(trials, rows, 3)
    whole = states_of(take(tracks, task.split.test))[0]
    np.testing.assert_allclose(ahead[0, 0], whole[rows[0] + 1 - 49])
    assert np.isnan(ahead[-1, 2]).all()


def test_scores_are_scaled_by_the_range_of_the_training_part():
    task = make_task(straight(200))
    scaled = task.scaler.transform(task.training)
    assert scaled[..., :2].min() == 0.0
    assert scaled[..., :2].max() == pytest.approx(1.0)


def test_the_rule_of_a_simulation_is_what_methods_are_given(flock):
    assert make_task(flock).graph == "radius:radius=2.5"
    assert make_task(straight()).graph == "complete"
    assert make_task(flock, graph="k-nearest:3").graph == "k-nearest:k=3"
    assert make_task(flock).exact
    assert not make_task(straight()).exact


def test_it_travels_to_another_process_and_tells_tasks_apart(flock):
    task = make_task(flock)
    again = pickle.loads(pickle.dumps(task))
    assert again.digest() == task.digest()
    np.testing.assert_array_equal(again.states, task.states)
    assert make_task(flock, seed=1).digest() != task.digest()
    assert make_task(flock.isel(individual=slice(4), neighbor=slice(4))).digest() != task.digest()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"origins": 0}, "origins: it must be at least 1, and it is 0"),
        ({"samples": 2}, "samples: it must be at least 10"),
        ({"horizons": (5, 1)}, r"horizons: give rising whole numbers .* not \[5, 1\]"),
        ({"horizons": (500,)}, "room for at most 30 steps ahead"),
        ({"fractions": (1.0, 0.0, 0.0)}, "the test part is empty"),
        ({"graph": "radius"}, "radius"),
    ],
)
def test_mistakes_are_told(options, said):
    with pytest.raises(InputError, match=said):
        _ = make_task(straight(200), **options).steps


def test_a_test_part_in_which_nobody_is_seen_twice_is_refused():
    position = straight(200)["position"].transpose("time", "individual", "space").to_numpy().copy()
    position[160:199:2] = np.nan
    position[199] = np.nan
    with pytest.raises(InputError, match="nobody is seen in two consecutive frames"):
        make_task(make_tracks(position, fps=10.0))
