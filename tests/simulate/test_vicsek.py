"""Hold the Vicsek model to hand-worked steps and to its limits of no noise and of all noise."""

import math

import numpy as np
import pytest

from swarmssm.simulate import simulate_vicsek

RIGHT_ANGLE = {
    "initial_position": [[0.0, 0.0], [0.5, 0.0], [2.5, 2.5]],
    "initial_velocity": [[1.0, 0.0], [0.0, 3.0], [-2.0, 0.0]],
}


def values(tracks, name):
    """Return a variable as (trial, time, individual, space)."""
    return tracks[name].transpose("trial", "time", "individual", "space").to_numpy()


def polarization(tracks):
    """Return the length of the mean heading, (trial, time)."""
    velocity = values(tracks, "velocity")
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    return np.linalg.norm((velocity / speed).mean(2), axis=-1)


def test_one_step_by_hand():
    """Headings of 0 and 90 degrees meet at 45, one far off keeps its own; old velocities carry."""
    tracks = simulate_vicsek(3, 2, dt=2.0, speed=0.1, process_noise=0.0, **RIGHT_ANGLE)
    half = 0.1 / math.sqrt(2)
    expected = [[half, half], [half, half], [-0.1, 0.0]]
    np.testing.assert_allclose(values(tracks, "velocity")[0, 1], expected, rtol=0, atol=1e-15)
    moved = [[0.2, 0.0], [0.5, 0.2], [2.3, 2.5]]
    np.testing.assert_allclose(values(tracks, "position")[0, 1], moved, rtol=0, atol=1e-15)
    force = tracks["force"].sel(term="alignment").isel(trial=0, time=0).transpose("individual", ...)
    turning = [[(half - 0.1) / 2, half / 2], [half / 2, (half - 0.1) / 2], [0.0, 0.0]]
    np.testing.assert_allclose(force, turning, rtol=0, atol=1e-15)


def test_opposite_headings_cancel_and_are_kept():
    start = {"initial_position": np.zeros((2, 2)), "initial_velocity": [[0.3, 0.4], [-0.3, -0.4]]}
    tracks = simulate_vicsek(2, 5, speed=0.5, process_noise=0.0, radius=2.5, **start)
    velocity = values(tracks, "velocity")[0]
    np.testing.assert_allclose(velocity, np.broadcast_to(velocity[0], velocity.shape), atol=1e-15)


def test_the_box_is_periodic_and_tracks_do_not_jump():
    """Two on both sides of a corner, in a box of 4, fly out along the diagonal of the box."""
    start = {"initial_position": [[3.9, 3.9], [0.1, 0.1]], "initial_velocity": [[1, 0], [0, 1]]}
    boxed = simulate_vicsek(2, 300, speed=0.03, box=4.0, process_noise=0.0, **start)
    assert boxed["adjacency"].values[..., 0, 1].all()
    np.testing.assert_allclose(polarization(boxed)[:, 1:], 1.0, rtol=0, atol=1e-12)
    steps = np.linalg.norm(np.diff(values(boxed, "position"), axis=1), axis=-1)
    np.testing.assert_allclose(steps, 0.03, rtol=0, atol=1e-12)
    assert values(boxed, "position").max() > 8  # twice around, not folded back
    open_space = simulate_vicsek(2, 300, speed=0.03, box=None, process_noise=0.0, **start)
    assert not open_space["adjacency"].any()
    np.testing.assert_allclose(polarization(open_space), math.sqrt(0.5), rtol=0, atol=1e-12)


@pytest.mark.parametrize("space", [2, 3])
def test_without_noise_all_fly_one_way(space):
    """In a box where everyone sees everyone, after one step; polarization is then 1."""
    tracks = simulate_vicsek(40, 4, 3, space=space, radius=1.0, box=None, process_noise=0.0,
                             initial_position=np.zeros((40, space)))  # fmt: skip
    order = polarization(tracks)
    assert order[:, 0].max() < 0.6
    np.testing.assert_allclose(order[:, 1:], 1.0, rtol=0, atol=1e-12)


def test_without_noise_a_dense_box_comes_to_order():
    """With thirty neighbours each, and long enough to mix."""
    tracks = simulate_vicsek(250, 200, box=5.0, process_noise=0.0)
    assert polarization(tracks)[0, -1] > 0.999


@pytest.mark.parametrize("space", [2, 3])
def test_at_the_highest_noise_order_is_that_of_random_headings(space):
    """The mean of N random unit vectors has a mean square of 1 / N.

    Its variance is (1 - 1 / N) / N ** 2 in the plane, and less in space, since for independent
    unit vectors ``|sum|^2 - N`` is twice a sum over pairs of cosines, whose mean square is
    1 / space: the variance is 2 N (N - 1) / space / N ** 4. Frames are independent, as each draws
    headings anew.
    """
    n = 20
    tracks = simulate_vicsek(n, 400, 10, space=space, burn_in=1, process_noise=2 * math.pi)
    square = polarization(tracks) ** 2
    error = math.sqrt(2 * (1 - 1 / n) / space) / n / math.sqrt(square.size)
    assert abs(square.mean() - 1 / n) < 6 * error


def test_order_falls_with_noise():
    """The transition of the paper's second figure: from order to none, in a box of density 4."""
    order = [
        polarization(simulate_vicsek(100, 100, 4, burn_in=100, process_noise=eta)).mean()
        for eta in (0.5, 2.0, 3.5, 6.0)
    ]
    assert order == sorted(order, reverse=True)
    assert order[0] > 0.9
    assert order[-1] < 0.2


def test_the_error_is_uniform_in_the_plane():
    """Of width eta: never beyond eta / 2, mean square eta ** 2 / 12 +- eta ** 2 / sqrt(180 n)."""
    eta = 1.5
    tracks = simulate_vicsek(50, 400, process_noise=eta)
    turned = [
        np.arctan2(v[..., 1], v[..., 0])
        for v in (values(tracks, "velocity")[:, 1:], values(tracks, "next_velocity")[:, :-1])
    ]
    error = np.angle(np.exp(1j * (turned[0] - turned[1])))
    assert abs(error).max() <= eta / 2 + 1e-12
    bound = 6 * eta**2 / math.sqrt(180 * error.size)
    assert abs((error**2).mean() - eta**2 / 12) < bound
    assert abs(error.mean()) < 6 * eta / math.sqrt(12 * error.size)


def test_the_error_is_uniform_on_a_cap_in_space():
    """The cosine of the error is uniform from cos(eta / 2) to 1, and its azimuth all around."""
    eta = 1.5
    tracks = simulate_vicsek(50, 400, space=3, process_noise=eta)
    after = values(tracks, "velocity")[:, 1:] / 0.03
    mean = values(tracks, "next_velocity")[:, :-1] / 0.03
    cosine = (after * mean).sum(-1)
    least = math.cos(eta / 2)
    assert cosine.min() >= least - 1e-12
    width = 1 - least
    assert abs(cosine.mean() - (1 + least) / 2) < 6 * width / math.sqrt(12 * cosine.size)
    third = (cosine > least + 2 * width / 3).mean()
    assert abs(third - 1 / 3) < 6 * math.sqrt(2 / 9 / cosine.size)
    aside = after - cosine[..., None] * mean
    across = np.cross(mean, [0.0, 0.0, 1.0])
    assert abs(((aside * across).sum(-1) > 0).mean() - 0.5) < 6 * 0.5 / math.sqrt(cosine.size)


def test_speed_is_kept():
    speed = np.linalg.norm(values(simulate_vicsek(20, 500, 4), "velocity"), axis=-1)
    np.testing.assert_allclose(speed, 0.03, rtol=0, atol=1e-14)
