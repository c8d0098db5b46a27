"""Turns, displacements and autocorrelations of motions known in the head."""

import numpy as np
import pytest

from swarmssm.errors import InputError
from swarmssm.metrics.memory import (
    heading_autocorrelation,
    mean_squared_displacement,
    turning_angles,
    velocity_autocorrelation,
)

NAN = np.nan


def circle(turn, frames=9, speed=2.0):
    """Return velocities ``(time, 1, 2)`` that turn by an angle in each frame."""
    angle = turn * np.arange(frames)
    return speed * np.stack([np.cos(angle), np.sin(angle)], -1)[:, None]


def test_turning_angles_have_a_sign_and_wrap():
    np.testing.assert_allclose(turning_angles(circle(0.5)), np.full((8, 1), 0.5))
    np.testing.assert_allclose(turning_angles(circle(-3.0)), np.full((8, 1), -3.0))
    # 4 radians to the left are 2 pi - 4 to the right.
    np.testing.assert_allclose(turning_angles(circle(4.0)), np.full((8, 1), 4.0 - 2 * np.pi))


def test_who_stands_still_does_not_turn():
    velocities = np.array([[[1.0, 0]], [[0, 0]], [[0, 1]], [[NAN, 1]], [[1, 1]]])
    assert np.isnan(turning_angles(velocities)).all()


def test_turning_angles_in_three_dimensions_have_no_sign():
    flat = circle(-0.5)
    tilted = np.concatenate([flat[..., :1], 0 * flat[..., :1], flat[..., 1:]], -1)
    np.testing.assert_allclose(turning_angles(tilted), np.full((8, 1), 0.5))


def test_displacement_of_straight_motion_grows_with_the_square():
    positions = np.outer(np.arange(10.0), [3.0, 4.0])[:, None]
    found = mean_squared_displacement(positions, [0, 1, 3, 9, 10])
    np.testing.assert_allclose(found, [0, 25, 225, 2025, NAN])


def test_displacement_skips_gaps():
    positions = np.array([[[0.0, 0]], [[NAN, 0]], [[5, 0]], [[6, 0]]])
    # One apart: (2, 3) alone; two apart: (0, 2) alone.
    np.testing.assert_allclose(mean_squared_displacement(positions, [1, 2]), [1, 25])


def test_autocorrelations_of_a_circle_are_cosines():
    lags = [0, 1, 2, 5]
    for function in (velocity_autocorrelation, heading_autocorrelation):
        np.testing.assert_allclose(function(circle(0.4), lags), np.cos(0.4 * np.array(lags)))


def test_speed_counts_in_one_and_not_in_the_other():
    velocities = np.array([[[1.0, 0]], [[3, 0]]])
    np.testing.assert_allclose(velocity_autocorrelation(velocities, [1]), [3 / 5])
    np.testing.assert_allclose(heading_autocorrelation(velocities, [1]), [1])


def test_a_mean_goes_over_runs_and_individuals():
    one, other = circle(0.3), circle(0.9)
    both = np.stack([one, other])  # two runs
    together = np.concatenate([one, other], axis=1)  # two individuals
    expected = (np.cos(0.3) + np.cos(0.9)) / 2
    for velocities in (both, together):
        np.testing.assert_allclose(heading_autocorrelation(velocities, [1]), [expected])


def test_a_negative_lag_is_refused():
    with pytest.raises(InputError, match="lags"):
        mean_squared_displacement(np.zeros((3, 1, 2)), [-1])
