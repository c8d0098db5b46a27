"""Hold the Couzin model to hand-worked zones, to its limits of turning, and to its regimes."""

import math

import numpy as np
import pytest
import torch

from swarmssm.simulate import simulate_couzin
from swarmssm.simulate.directions import turn_towards

EAST, NORTH = (1.0, 0.0), (0.0, 1.0)


def values(tracks, name):
    """Return a variable as (trial, time, individual, space)."""
    return tracks[name].transpose("trial", "time", "individual", "space").to_numpy()


def one_step(places, headings, **changes):
    """Simulate a step without noise in which the turning rate is no limit, unless given."""
    settings = {
        "orientation_radius": 4.0,
        "attraction_radius": 10.0,
        "turning_rate": 1800.0,
        "process_noise": 0.0,
        "speed": 2.0,
        **changes,
    }
    return simulate_couzin(
        len(places), 2, initial_position=places, initial_velocity=headings, **settings
    )


def felt(tracks):
    """Return repulsion, orientation and attraction of the first individual in the first frame."""
    force = tracks["force"].isel(trial=0, time=0, individual=0)
    return force.transpose("term", "space").to_numpy()


def heard(tracks):
    """Return whom the first individual reacts to in the first frame."""
    return set(np.flatnonzero(tracks["adjacency"].values[0, 0, 0]))


def heading(tracks):
    """Return the heading of the first individual in the second frame."""
    return values(tracks, "velocity")[0, 1, 0] / 2.0


def test_repulsion_wins_over_the_other_zones():
    """One too near at (0.6, 0.8) / 2; others to align with and to go to do not count."""
    tracks = one_step([[0, 0], [0.3, 0.4], [2, 0], [0, 7]], [EAST, EAST, NORTH, EAST])
    np.testing.assert_allclose(felt(tracks), [[-0.6, -0.8], [0, 0], [0, 0]], rtol=0, atol=1e-15)
    assert heard(tracks) == {1}
    np.testing.assert_allclose(heading(tracks), [-0.6, -0.8], rtol=0, atol=1e-12)
    # Speed 2 for 0.1 s.
    position = values(tracks, "position")[0, 1, 0]
    np.testing.assert_allclose(position, [-0.12, -0.16], rtol=0, atol=1e-12)


def test_repulsion_adds_unit_vectors():
    """One at distance 0.5 along x and one at 0.9 along y push alike."""
    tracks = one_step([[0, 0], [0.5, 0], [0, 0.9]], [EAST] * 3)
    np.testing.assert_allclose(felt(tracks)[0], [-1, -1], rtol=0, atol=1e-15)


def test_orientation_alone():
    tracks = one_step([[0, 0], [2, 0], [3, 1]], [EAST, NORTH, NORTH])
    np.testing.assert_allclose(felt(tracks), [[0, 0], [0, 2], [0, 0]], rtol=0, atol=1e-15)
    np.testing.assert_allclose(heading(tracks), NORTH, rtol=0, atol=1e-12)


def test_attraction_alone():
    tracks = one_step([[0, 0], [3, 4], [0, 9]], [EAST, EAST, EAST])
    np.testing.assert_allclose(felt(tracks), [[0, 0], [0, 0], [0.6, 1.8]], rtol=0, atol=1e-15)


def test_orientation_and_attraction_share():
    """Half of each sum: v = (0, 1) and, at (3, 4) and (0, 9), (0.6, 1.8)."""
    tracks = one_step([[0, 0], [2, 0], [3, 4], [0, 9]], [EAST, NORTH, EAST, EAST])
    np.testing.assert_allclose(felt(tracks), [[0, 0], [0, 0.5], [0.3, 0.9]], rtol=0, atol=1e-15)
    assert heard(tracks) == {1, 2, 3}
    direction = np.array([0.3, 1.4]) / math.hypot(0.3, 1.4)
    np.testing.assert_allclose(heading(tracks), direction, rtol=0, atol=1e-12)


def test_borders_of_the_zones():
    """Repulsion below 1, orientation from 1 to below 4, attraction from 4 to 10."""
    for distance, term in ((0.99, 0), (1.0, 1), (3.99, 1), (4.0, 2), (10.0, 2), (10.01, None)):
        strength = abs(felt(one_step([[0, 0], [distance, 0]], [EAST, NORTH]))).sum(-1)
        assert strength.tolist() == [float(term == i) for i in range(3)]


def test_the_blind_volume_counts_for_the_outer_zones_only():
    """50 degrees off straight behind is blind for an angle of 110, and not for one of 90."""
    off = np.array([-math.cos(math.radians(50)), math.sin(math.radians(50))])
    for distance, term in ((2.0, 1), (8.0, 2)):
        places = [[0, 0], (distance * off).tolist()]
        assert heard(one_step(places, [EAST, NORTH], blind_angle=90.0)) == {1}
        blind = one_step(places, [EAST, NORTH], blind_angle=110.0)
        assert heard(blind) == set()
        assert not felt(blind)[term].any()
        np.testing.assert_allclose(heading(blind), EAST, rtol=0, atol=1e-12)
    near = one_step([[0, 0], (0.5 * off).tolist()], [EAST, NORTH], blind_angle=110.0)
    np.testing.assert_allclose(felt(near)[0], -off, rtol=0, atol=1e-15)


def test_where_the_sum_vanishes_one_goes_straight_on():
    tracks = one_step([[0, 0], [0, 2], [0, -2]], [EAST, NORTH, (0.0, -1.0)])
    np.testing.assert_allclose(heading(tracks), EAST, rtol=0, atol=1e-12)
    alone = one_step([[0, 0]], [(0.6, 0.8)])
    np.testing.assert_allclose(heading(alone), [0.6, 0.8], rtol=0, atol=1e-12)


def test_turning_is_limited():
    """40 degrees per second for 0.1 s: 4 degrees towards who is at 90 degrees."""
    tracks = one_step([[0, 0], [0, 8]], [EAST, EAST], turning_rate=40.0)
    angle = math.radians(4)
    np.testing.assert_allclose(heading(tracks), [math.cos(angle), math.sin(angle)], atol=1e-12)
    # One at 3 degrees is reached at once.
    aim = [math.cos(math.radians(3)), math.sin(math.radians(3))]
    close = one_step([[0, 0], [8 * aim[0], 8 * aim[1]]], [EAST, EAST], turning_rate=40.0)
    np.testing.assert_allclose(heading(close), aim, rtol=0, atol=1e-12)


@pytest.mark.parametrize("space", [2, 3])
def test_nobody_ever_turns_faster_or_changes_speed(space):
    tracks = simulate_couzin(20, 500, space=space, process_noise=0.5)
    velocity = values(tracks, "velocity")
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=-1), 3.0, rtol=0, atol=1e-12)
    unit = velocity / 3.0
    chord = np.linalg.norm(np.diff(unit, axis=1), axis=-1)
    angle = np.degrees(2 * np.arcsin(chord / 2))
    assert angle.max() <= 4 + 1e-9
    assert angle.max() > 4 - 1e-6


@pytest.mark.parametrize("space", [2, 3])
def test_the_error_of_direction_has_its_size(space):
    """Alone and free to turn, the squared error of n headings is space - 1 tangent Gaussians.

    Its mean is (space - 1) s ** 2, with a standard error of s ** 2 sqrt(2 (space - 1) / n).
    """
    sd = 0.2
    tracks = simulate_couzin(
        1, 200, 100, space=space, process_noise=sd, turning_rate=4000.0, blind_angle=0.0
    )
    unit = values(tracks, "velocity") / 3.0
    chord = np.linalg.norm(np.diff(unit, axis=1), axis=-1)
    square = (2 * np.arcsin(chord / 2)) ** 2
    expected = (space - 1) * sd**2
    assert abs(square.mean() - expected) < 6 * sd**2 * math.sqrt(2 * (space - 1) / square.size)


def test_a_target_straight_behind_is_turned_to():
    """The turn has the allowed angle whatever the side, in the plane and in space."""
    for rows in (np.eye(2), np.eye(3), [[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]]):
        directions = torch.tensor(rows, dtype=torch.float64)
        turned = turn_towards(directions, -directions, 0.3)
        cosine = (turned * directions).sum(-1)
        torch.testing.assert_close(cosine, torch.full_like(cosine, math.cos(0.3)))
        norm = turned.norm(dim=-1)
        torch.testing.assert_close(norm, torch.ones_like(norm))


def in_space(vectors):
    """Give vectors of the plane a third coordinate of 0."""
    return np.pad(vectors, [(0, 0)] * (vectors.ndim - 1) + [(0, 3 - vectors.shape[-1])])


def orders(tracks):
    """Return polarization and rotation order, each (trial, time)."""
    position, velocity = values(tracks, "position"), values(tracks, "velocity")
    unit = velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
    arm = position - position.mean(2, keepdims=True)
    arm = arm / np.linalg.norm(arm, axis=-1, keepdims=True)
    rotation = np.cross(in_space(arm), in_space(unit)).mean(2)
    return np.linalg.norm(unit.mean(2), axis=-1), np.linalg.norm(rotation, axis=-1)


@pytest.mark.parametrize(("width", "regime"), [(0.0, "swarm"), (2.0, "torus"), (4.0, "parallel")])
def test_the_regimes_of_the_paper(width, regime):
    """With a wider zone of orientation the group goes from a swarm to a torus to a parallel group.

    In three dimensions and with the values of the paper. States are told apart as by Tunstrom and
    others (2013, PLoS Comput. Biol. 9:e1002915): an order above 0.65 while the other is below
    0.35 names the state, and both below 0.35 is a swarm.
    """
    tracks = simulate_couzin(
        30,
        100,
        4,
        space=3,
        burn_in=800,
        orientation_radius=1.0 + width,
        attraction_radius=15.0,
    )
    polarized, rotating = (values.mean() for values in orders(tracks))
    assert (polarized > 0.65) == (regime == "parallel")
    assert (rotating > 0.65) == (regime == "torus")
    assert (polarized < 0.35) == (regime != "parallel")
    assert (rotating < 0.35) == (regime != "torus")


def test_the_default_is_a_mill():
    polarized, rotating = orders(simulate_couzin(40, 100, 3, burn_in=500))
    assert rotating.mean() > 0.65
    assert polarized.mean() < 0.35
