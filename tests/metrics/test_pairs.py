"""Two individuals whose places and headings are known."""

import numpy as np
import pytest

from swarmssm.errors import InputError
from swarmssm.metrics.pairs import (
    heading_differences,
    neighbor_positions,
    pair_distances,
    viewing_angles,
)

NAN = np.nan
#: The first heads north from the origin; the second, at (-1, 1), heads east.
PLACES = np.array([[[0.0, 0], [-1, 1]]])
VELOCITIES = np.array([[[0.0, 2], [3, 0]]])


def test_distances_and_headings_by_hand():
    np.testing.assert_allclose(pair_distances(PLACES), [[np.sqrt(2)]])
    np.testing.assert_allclose(heading_differences(VELOCITIES), [[np.pi / 2]])
    third = np.concatenate([PLACES, [[[3.0, 4]]]], axis=1)
    # (0, 1), (0, 2), (1, 2)
    np.testing.assert_allclose(pair_distances(third), [[np.sqrt(2), 5, 5]])


def test_who_is_where_in_whose_view_by_hand():
    found = neighbor_positions(PLACES, VELOCITIES)
    # For the first the other is 1 ahead and 1 to the left; for the second, which looks east, the
    # first is 1 ahead and 1 to the right.
    np.testing.assert_allclose(found[0, 0, 1], [1, 1], atol=1e-15)
    np.testing.assert_allclose(found[0, 1, 0], [1, -1], atol=1e-15)
    assert np.isnan(found[0, [0, 1], [0, 1]]).all()
    angles = viewing_angles(PLACES, VELOCITIES)
    np.testing.assert_allclose(angles[0, [0, 1], [1, 0]], [np.pi / 4] * 2)
    assert np.isnan(angles[0, 0, 0])


def test_a_turned_swarm_sees_the_same():
    rng = np.random.default_rng(1)
    places, velocities = rng.normal(size=(2, 4, 5, 2))
    turn = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    np.testing.assert_allclose(
        neighbor_positions(places @ turn.T + 3, velocities @ turn.T),
        neighbor_positions(places, velocities),
        atol=1e-12,
    )


def test_three_dimensions_agree_with_the_plane_but_for_the_side():
    rng = np.random.default_rng(2)
    places, velocities = rng.normal(size=(2, 4, 5, 2))
    deep = [np.concatenate([a, np.zeros((4, 5, 1))], -1) for a in (places, velocities)]
    flat, found = neighbor_positions(places, velocities), neighbor_positions(*deep)
    np.testing.assert_allclose(found[..., 0], flat[..., 0], atol=1e-12)
    np.testing.assert_allclose(found[..., 1], np.abs(flat[..., 1]), atol=1e-12)


def test_the_unknown_and_the_still_have_no_view():
    still = np.array([[[0.0, 0], [3, 0]]])
    angles = viewing_angles(PLACES, still)
    assert np.isnan(angles[0, 0, 1])
    np.testing.assert_allclose(angles[0, 1, 0], np.pi / 4)
    hidden = np.array([[[0.0, NAN], [-1, 1]]])
    assert np.isnan(viewing_angles(hidden, VELOCITIES)).all()
    assert np.isnan(heading_differences(still)).all()


def test_one_dimension_is_refused():
    with pytest.raises(InputError, match="space"):
        neighbor_positions(np.zeros((1, 2, 1)), np.zeros((1, 2, 1)))
