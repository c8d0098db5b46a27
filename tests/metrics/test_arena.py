"""Distances and angles to walls that stand where everybody can see."""

import numpy as np
import pytest

from swarmssm.errors import InputError
from swarmssm.metrics.arena import Arena, wall_angles, wall_distances

NAN = np.nan
BOX = Arena.box([0, 0], [10, 4])


def test_distances_in_a_box_by_hand():
    places = np.array([[[5.0, 1], [9, 2], [11, 2], [NAN, 1], [5, 2]]])
    np.testing.assert_allclose(wall_distances(places, BOX), [[1, 1, -1, NAN, 2]])


def test_angles_in_a_box_by_hand():
    place = np.array([[[5.0, 1]] * 5])  # the wall below is the nearest
    velocity = np.array([[[0.0, -2], [3, 0], [0, 1], [1, -1], [0, 0]]])
    expected = [[0, np.pi / 2, np.pi, np.pi / 4, NAN]]
    np.testing.assert_allclose(wall_angles(place, velocity, BOX), expected, atol=1e-7)


def test_corners_in_any_order_make_the_box():
    corners = [[10, 4], [0, 0], [10, 0], [0, 4], [5, 2], [NAN, 1]]
    hull = Arena.around(corners, "corners")
    assert len(hull.offsets) == 4
    assert hull.source == "corners"
    places = np.random.default_rng(0).uniform(-1, 11, size=(3, 7, 2))
    np.testing.assert_allclose(wall_distances(places, hull), wall_distances(places, BOX))
    two = Arena.around([[10, 0], [0, 4]])
    np.testing.assert_allclose(wall_distances(places, two), wall_distances(places, BOX))


def test_a_polygon_of_many_sides_is_a_disc():
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    disc = Arena.around(3 * np.stack([np.cos(angle), np.sin(angle)], -1))
    places = np.array([[[0.0, 0], [2, 0], [0, -1]]])
    # A side of an inscribed polygon is cos(pi / 720) of the radius from the centre.
    np.testing.assert_allclose(wall_distances(places, disc), [[3, 1, 2]], atol=3e-5)
    velocity = np.array([[[1.0, 0], [0, 1], [0, -1]]])
    angles = wall_angles(places, velocity, disc)[0, 1:]
    np.testing.assert_allclose(angles, [np.pi / 2, 0], atol=0.01)


def test_a_box_in_three_dimensions():
    cube = Arena.box([0, 0, 0], [2, 2, 2])
    np.testing.assert_allclose(wall_distances(np.array([[[1.0, 1, 1.5]]]), cube), [[0.5]])


@pytest.mark.parametrize(
    "corners", [[[0, 0], [1, 1], [2, 2]], [[0, 0]], [1.0, 2.0], [[0, 0], [0, 1]]]
)
def test_what_encloses_nothing_is_refused(corners):
    with pytest.raises(InputError, match="arena"):
        Arena.around(corners)


def test_other_dimensions_are_refused():
    with pytest.raises(InputError, match="2 dimensions, and the positions have 3"):
        wall_distances(np.zeros((1, 1, 3)), BOX)
