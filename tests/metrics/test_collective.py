"""Scores of a group: by hand, against full distance matrices, and by the symmetries they have."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from swarmssm import metrics
from swarmssm.errors import InputError
from swarmssm.metrics import collective

NAN = np.nan


def test_amd_by_hand():
    line = np.array([[[0.0, 0], [1, 0], [4, 0]]] * 3)
    line[1, 1] = NAN
    line[2, 1:] = NAN
    np.testing.assert_allclose(metrics.amd(line), [(1 + 1 + 3) / 3, 4, NAN])
    np.testing.assert_allclose(
        metrics.nearest_neighbor_distance(line), [[1, 1, 3], [4, NAN, 4], [NAN, NAN, NAN]]
    )


def test_avd_by_hand():
    velocities = np.array([[[0, 0], [3, 4], [0, 0]], [[0, 0], [NAN, 4], [5, 12]]])
    # Three unordered pairs, of 5, 0 and 5; then the one that is left.
    np.testing.assert_allclose(metrics.avd(velocities), [10 / 3, 13])


def test_two_at_one_place_have_distance_zero(monkeypatch):
    heap = np.zeros((1, 3, 2))
    assert metrics.amd(heap) == [0.0]
    monkeypatch.setattr(collective, "MAX_DENSE", 0)
    assert metrics.amd(heap) == [0.0]


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("dense", [0, 1000])
def test_pairs_agree_with_a_full_distance_matrix(monkeypatch, space, dense):
    monkeypatch.setattr(collective, "MAX_DENSE", dense)
    monkeypatch.setattr(collective, "CHUNK", 2000)  # several chunks
    rng = np.random.default_rng(3)
    values = rng.normal(size=(2, 5, 30, space))
    values[rng.random(values.shape[:-1]) < 0.3] = NAN
    nearest, mean_pair = np.full((2, 5, 30), NAN), np.zeros((2, 5))
    for trial, time in np.ndindex(2, 5):
        there = np.flatnonzero(~np.isnan(values[trial, time, :, 0]))
        distance = cdist(values[trial, time, there], values[trial, time, there])
        mean_pair[trial, time] = distance[np.triu_indices(len(there), 1)].mean()
        np.fill_diagonal(distance, np.inf)
        nearest[trial, time, there] = distance.min(axis=1)
    np.testing.assert_allclose(metrics.nearest_neighbor_distance(values), nearest, rtol=1e-12)
    np.testing.assert_allclose(metrics.amd(values), np.nanmean(nearest, axis=-1), rtol=1e-12)
    np.testing.assert_allclose(metrics.avd(values), mean_pair, rtol=1e-12)


@pytest.mark.parametrize("dense", [0, 1000])
def test_scores_of_a_group_of_nobody_or_one_are_nan(monkeypatch, dense):
    monkeypatch.setattr(collective, "MAX_DENSE", dense)
    for lonely in (np.ones((4, 1, 2)), np.full((4, 3, 2), NAN), np.ones((4, 0, 2))):
        assert np.isnan(metrics.amd(lonely)).all()
        assert np.isnan(metrics.avd(lonely)).all()
        assert metrics.amd(lonely).shape == (4,)


def test_speeds_by_hand():
    velocities = np.array([[[3.0, 4.0], [NAN, 1.0]]])
    np.testing.assert_array_equal(metrics.speeds(velocities), [[5, NAN]])
    np.testing.assert_array_equal(metrics.speeds([[[2.0, 3.0, 6.0]]]), [[7]])


def test_polarization_by_hand():
    velocities = np.array(
        [
            [[1, 0], [5, 0], [0.1, 0]],  # one heading, whatever the speed
            [[1, 0], [-2, 0], [0, 0]],  # opposed; the third stands still and has none
            [[1, 0], [0, 3], [NAN, 0]],  # at a right angle: |(1/2, 1/2)|
            [[0, 0], [0, 0], [NAN, NAN]],  # nobody moves
        ]
    )
    expected = [1, 0, np.sqrt(0.5), NAN]
    np.testing.assert_allclose(metrics.polarization(velocities), expected, atol=1e-15)


def test_rotation_by_hand():
    square = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    turning = np.array([[0.0, 1], [-1, 0], [0, -1], [1, 0]])  # from x towards y
    positions = np.stack([square] * 4) + np.array([10.0, -3.0])
    velocities = np.stack([turning, -2 * turning, square, turning])
    velocities[3, 0] = 0  # stands still: three of three turn
    signed = metrics.rotation(positions, velocities, signed=True)
    np.testing.assert_allclose(signed, [1, -1, 0, 1], atol=1e-15)
    np.testing.assert_allclose(metrics.rotation(positions, velocities), [1, 1, 0, 1], atol=1e-15)


def test_rotation_leaves_out_the_unknown_and_who_has_no_direction():
    positions = np.array([[[1.0, 0], [-1, 0], [0, 0], [0, 0], [NAN, 0], [7, 7]]])
    velocities = np.array([[[0.0, 1], [0, 1], [1, 0], [0, 0], [5, 5], [NAN, 0]]])
    # The first four are known, with centroid (0, 0). The third and fourth sit on it; the first
    # turns one way and the second the other.
    np.testing.assert_allclose(metrics.rotation(positions, velocities), [0], atol=1e-15)
    velocities[0, 1] = 0  # stands still: the first alone is left, the centroid is as before
    np.testing.assert_allclose(metrics.rotation(positions, velocities), [1])
    assert np.isnan(metrics.rotation(positions[:, 2:], velocities[:, 2:])).all()


def test_rotation_in_three_dimensions_is_that_in_the_plane_wherever_it_lies():
    rng = np.random.default_rng(4)
    positions, velocities = rng.normal(size=(2, 6, 9, 2))
    flat = [np.concatenate([a, np.zeros((6, 9, 1))], axis=-1) for a in (positions, velocities)]
    tilt = Rotation.random(rng=5).as_matrix()
    np.testing.assert_allclose(
        metrics.rotation(flat[0] @ tilt.T, flat[1] @ tilt.T),
        metrics.rotation(positions, velocities),
        rtol=1e-9,
    )


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda x: metrics.amd(x[0]), r"positions: its shape is \(3, 2\); it must be \(..., time"),
        (lambda x: metrics.amd(np.where(x == 0, np.inf, x)), r"positions: the entry at \(0, 0, 0"),
        (lambda x: metrics.avd(np.where(x == 0, np.inf, x)), r"velocities: the entry at \(0, 0, 0"),
        (lambda x: metrics.rotation(x, x[:1]), r"velocities: its shape \(1, 3, 2\) differs"),
        (lambda x: metrics.rotation(x[..., :1], x[..., :1]), "rotation needs 2 or 3 coordinates"),
        (
            lambda x: metrics.rotation(x[..., [0, 0, 1]], x[..., [0, 0, 1]], signed=True),
            "signed: a rotation in three dimensions has an axis",
        ),
    ],
)
def test_what_group_scores_refuse(call, words):
    with pytest.raises(InputError, match=words):
        call(np.arange(12.0).reshape(2, 3, 2))


@st.composite
def groups(draw):
    """Positions and velocities (time, individual, space) with holes, and a random motion."""
    shape = (draw(st.integers(1, 3)), draw(st.integers(2, 7)), draw(st.integers(2, 3)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    positions, velocities = rng.normal(size=(2, *shape))
    holes = draw(hnp.arrays(bool, shape[:2]))
    positions[holes] = velocities[holes] = NAN
    turn = np.linalg.qr(rng.normal(size=(shape[2], shape[2])))[0]  # a rotation or a reflection
    return positions, velocities, turn, rng


@given(groups())
def test_scores_do_not_depend_on_who_is_who(group):
    positions, velocities, _, rng = group
    order = rng.permutation(positions.shape[1])
    for score, arrays in (
        (metrics.amd, (positions,)),
        (metrics.avd, (velocities,)),
        (metrics.polarization, (velocities,)),
        (metrics.rotation, (positions, velocities)),
    ):
        np.testing.assert_allclose(
            score(*(a[:, order] for a in arrays)), score(*arrays), rtol=1e-9, atol=1e-12
        )


@given(groups())
def test_scores_do_not_depend_on_where_the_group_is_and_how_it_is_turned(group):
    positions, velocities, turn, rng = group
    shift = rng.normal(size=positions.shape[-1])
    moved, turned = positions @ turn + shift, velocities @ turn
    close = {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(metrics.amd(moved), metrics.amd(positions), **close)
    # AVD is also blind to a drift that all share, and polarization to the unit of speed.
    np.testing.assert_allclose(metrics.avd(turned + shift), metrics.avd(velocities), **close)
    np.testing.assert_allclose(
        metrics.polarization(3.0 * turned), metrics.polarization(velocities), **close
    )
    np.testing.assert_allclose(
        metrics.rotation(moved, turned), metrics.rotation(positions, velocities), **close
    )


@given(groups())
def test_an_individual_that_is_unknown_changes_nothing(group):
    positions, velocities, _, _ = group
    nobody = np.full_like(positions[:, :1], NAN)
    more = [np.concatenate([a, nobody], axis=1) for a in (positions, velocities)]
    for score, arrays, fewer in (
        (metrics.amd, more[:1], (positions,)),
        (metrics.avd, more[1:], (velocities,)),
        (metrics.polarization, more[1:], (velocities,)),
        (metrics.rotation, more, (positions, velocities)),
    ):
        np.testing.assert_allclose(score(*arrays), score(*fewer), rtol=1e-12, atol=1e-15)
