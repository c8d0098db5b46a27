"""Area and elongation of groups whose outline is known."""

import numpy as np
import pytest

from swarmssm.errors import InputError
from swarmssm.metrics.shape import elongation, group_area

NAN = np.nan


def test_area_of_a_square_with_somebody_inside():
    square = [[0.0, 0], [2, 0], [2, 2], [0, 2], [1, 1]]
    gone = [[0.0, 0], [2, 0], [2, 2], [NAN, 2], [1, 1]]  # a triangle is left, (1, 1) on its side
    line = [[0.0, 0], [1, 1], [2, 2], [3, 3], [4, 4]]
    two = [[0.0, 0], [1, 1], [NAN, NAN], [NAN, 0], [NAN, NAN]]
    np.testing.assert_allclose(group_area([square, gone, line, two]), [4, 2, 0, NAN])


def test_volume_of_a_box():
    corners = np.stack(np.meshgrid([0, 1], [0, 2], [0, 3]), -1).reshape(1, 8, 3)
    np.testing.assert_allclose(group_area(corners), [6])
    np.testing.assert_array_equal(group_area(corners[:, :3]), [NAN])


def test_leading_axes_stay():
    positions = np.random.default_rng(0).normal(size=(2, 3, 4, 5, 2))
    areas = group_area(positions)
    assert areas.shape == (2, 3, 4)
    assert areas[1, 2, 3] == group_area(positions[1, 2, 3][None])[0]


def test_elongation_of_an_ellipse_and_a_line():
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    # The standard deviations of its axes are as 3 to 1.
    ellipse = np.stack([3 * np.cos(angle), np.sin(angle)], -1)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    line = np.outer(np.arange(12.0), [1, 2])
    few = np.full((12, 2), NAN)
    few[:2] = [[0, 0], [1, 0]]
    frames = [ellipse, ellipse @ turn.T + 5, line, few]
    np.testing.assert_allclose(elongation(frames), [2 / 3, 2 / 3, 1, NAN], atol=1e-6)


def test_all_in_one_place_have_no_shape():
    assert np.isnan(elongation(np.ones((1, 5, 2)))).all()


@pytest.mark.parametrize("function", [group_area, elongation])
def test_too_few_axes_are_refused(function):
    with pytest.raises(InputError, match="individual"):
        function([1.0, 2.0])
