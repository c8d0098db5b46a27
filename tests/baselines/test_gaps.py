"""Gaps in histories, against paths that constant velocity makes exactly."""

import numpy as np

from swarmssm.baselines.gaps import fill_gaps

FPS = 10.0


def straight(num_times=8):
    """One individual from (0, 1) at (3, -2) a second, ``(time, 1, 4)``."""
    seconds = np.arange(num_times)[:, None] / FPS
    position = np.array([0.0, 1.0]) + seconds * np.array([3.0, -2.0])
    velocity = np.broadcast_to([3.0, -2.0], position.shape)
    return np.concatenate([position, velocity], axis=-1)[:, None]


def test_a_straight_path_is_filled_exactly_before_and_within():
    truth = straight()
    states = truth.copy()
    states[[0, 1, 3, 5, 6]] = np.nan
    np.testing.assert_allclose(fill_gaps(states, FPS), truth, rtol=0, atol=1e-12)


def test_what_comes_after_the_last_known_frame_stays_unknown():
    states = straight()
    states[5:] = np.nan
    np.testing.assert_array_equal(fill_gaps(states, FPS), states)


def test_who_is_never_known_stays_unknown():
    states = np.concatenate([straight(), np.full((8, 1, 4), np.nan)], axis=1)
    states[2, 0] = np.nan
    filled = fill_gaps(states, FPS)
    assert np.isnan(filled[:, 1]).all()
    np.testing.assert_allclose(filled[:, :1], straight(), rtol=0, atol=1e-12)


def test_between_two_velocities_both_ends_count_by_nearness():
    states = np.full((4, 1, 2), np.nan)
    states[0, 0], states[3, 0] = [0.0, 10.0], [9.0, 40.0]
    # Forward from 0 at 1 a frame: 1, 2. Back from 9 at 4 a frame: 1, 5. Weights 1/3 and 2/3.
    expected = [[0.0, 10.0], [1.0, 20.0], [(2.0 + 2 * 5.0) / 3.0, 30.0], [9.0, 40.0]]
    np.testing.assert_allclose(fill_gaps(states, FPS)[:, 0], expected, rtol=0, atol=1e-12)


def test_a_position_that_is_known_without_its_velocity_is_kept():
    states = straight()
    states[0] = [[7.0, 7.0, np.nan, np.nan]]
    np.testing.assert_allclose(fill_gaps(states, FPS)[0, 0], [7.0, 7.0, 3.0, -2.0])


def test_leading_axes_are_kept():
    states = np.stack([straight(), straight() + 1.0])[None]
    states[0, 1, 3] = np.nan
    filled = fill_gaps(states, FPS)
    assert filled.shape == states.shape
    np.testing.assert_allclose(filled[0, 1, :, :, 2:], states[0, 1, :1, :, 2:].repeat(8, axis=0))
