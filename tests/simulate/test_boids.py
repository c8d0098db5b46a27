"""Hold simulated boids to hand-worked steps, to an independent simulation, and to being a flock."""

import json
import math

import numpy as np
import pytest
import torch

from swarmssm.simulate import dynamics_of, simulate_boids

PAIR = {
    "initial_position": [[0.0, 0.0], [2.0, 0.0]],
    "initial_velocity": [[1.0, 0.0], [0.0, 0.8]],
}


def values(tracks, name):
    """Return a variable as (trial, time, individual, space)."""
    return tracks[name].transpose("trial", "time", "individual", "space").to_numpy()


def test_one_step_as_acceleration_by_hand():
    """Two, 2 apart: C = (2, 0), S = -(2, 0) / 4, mean v_j - v_i = (-1, 0.8), and the opposite.

    Times gains 0.5, 0.3, 0.2: 1 - 0.15 - 0.2 = 0.65 along x, 0.16 along y.
    """
    tracks = simulate_boids(2, 2, process_noise=0.0, **PAIR)
    force = tracks["force"].isel(trial=0, time=0).transpose("term", "individual", "space")
    expected = {
        "cohesion": [[1.0, 0.0], [-1.0, 0.0]],
        "separation": [[-0.15, 0.0], [0.15, 0.0]],
        "alignment": [[-0.2, 0.16], [0.2, -0.16]],
        "wall": [[0.0, 0.0], [0.0, 0.0]],
    }
    for term, value in expected.items():
        np.testing.assert_allclose(force.sel(term=term), value, rtol=0, atol=1e-15)
    velocity = np.array([[1.065, 0.016], [-0.065, 0.784]])
    np.testing.assert_allclose(values(tracks, "velocity")[0, 1], velocity, rtol=0, atol=1e-15)
    position = np.array([[0.1065, 0.0016], [1.9935, 0.0784]])
    np.testing.assert_allclose(values(tracks, "position")[0, 1], position, rtol=0, atol=1e-15)


def test_one_step_as_velocity_by_hand():
    """(3.19): v' = 0.5 C + 0.3 S + 0.5 v_j, the own velocity forgotten."""
    tracks = simulate_boids(2, 2, form="velocity", alignment_gain=0.5, process_noise=0.0, **PAIR)
    velocity = np.array([[0.85, 0.4], [-0.85 + 0.5, 0.0]])
    np.testing.assert_allclose(values(tracks, "velocity")[0, 1], velocity, rtol=0, atol=1e-15)
    position = np.array([[0.085, 0.04], [2.0 - 0.035, 0.0]])
    np.testing.assert_allclose(values(tracks, "position")[0, 1], position, rtol=0, atol=1e-15)
    total = tracks["force"].sum("term").transpose("trial", "time", "individual", "space")
    np.testing.assert_allclose(total[0, 0], velocity, rtol=0, atol=1e-15)


def test_wall_and_speed_regulation_by_hand():
    """Alone at (5, 0) with speed 2: wall -1 * 1, and regulation 0.5 * (1 - 2)."""
    tracks = simulate_boids(
        1,
        2,
        relaxation_gain=0.5,
        max_speed=9.0,
        process_noise=0.0,
        initial_position=[[5.0, 0.0]],
        initial_velocity=[[0.0, 2.0]],
    )
    np.testing.assert_allclose(values(tracks, "velocity")[0, 1], [[-0.1, 1.95]], rtol=0, atol=1e-15)


def test_speed_limits_by_hand():
    """Alone, without forces: too fast, too slow, and at rest."""
    still = {
        "process_noise": 0.0,
        "wall_gain": 0.0,
        "graph": "radius:0",
        "initial_position": [[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]],
    }
    fast = simulate_boids(3, 2, initial_velocity=[[3.0, 4.0], [0.0, -0.1], [0.0, 0.0]], **still)
    np.testing.assert_allclose(
        values(fast, "velocity")[0, 1], [[0.72, 0.96], [0.0, -0.6], [0.0, 0.0]], atol=1e-15
    )
    # In the velocity form nobody around means v' = 0: a least speed keeps the old direction.
    lone = simulate_boids(
        3,
        2,
        form="velocity",
        min_speed=0.5,
        initial_velocity=[[3.0, 4.0], [0.0, -0.1], [0.0, 0.0]],
        **still,
    )
    np.testing.assert_allclose(
        values(lone, "velocity")[0, 1], [[0.3, 0.4], [0.0, -0.5], [0.0, 0.0]], atol=1e-15
    )


@pytest.mark.parametrize("form", ["acceleration", "velocity"])
@pytest.mark.parametrize("noise", ["additive", "multiplicative"])
def test_noise_has_its_size(form, noise):
    """Velocities differ from the next ones foretold by s sqrt(dt) or s |v|; no limits of speed."""
    tracks = simulate_boids(
        8,
        400,
        5,
        form=form,
        dt=0.2,
        noise=noise,
        process_noise=0.1,
        min_speed=0.0,
        max_speed=math.inf,
        relaxation_gain=0.3,
    )
    v = values(tracks, "velocity")
    error = v[:, 1:] - values(tracks, "next_velocity")[:, :-1]
    if noise == "additive":
        error = error / (0.1 * math.sqrt(0.2))
    else:
        error = error / (0.1 * np.linalg.norm(v[:, :-1], axis=-1, keepdims=True))
    assert abs((error**2).mean() - 1) < 6 * math.sqrt(2 / error.size)
    assert abs(error.mean()) < 6 / math.sqrt(error.size)
    # The position takes the noisy velocity along.
    p = values(tracks, "position")
    np.testing.assert_allclose(p[:, 1:], p[:, :-1] + 0.2 * v[:, 1:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        values(tracks, "next_position"), p + 0.2 * values(tracks, "next_velocity"), atol=1e-12
    )


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("boids", {}),
        ("boids_free", {"cohesion_gain": 1.0, "alignment_gain": 0.3, "wall_gain": 0.0}),
    ],
)
def test_reproduces_an_independent_simulation(shared_data, name, changes):
    """200 000 steps that other code has made, with noise 0.02 |v| before the clamp to [0.6, 1.2].

    Where the next speed lies between the limits the noise was not clamped. Divided by its standard
    deviation it has mean square 1 within 6 sqrt(2 / n); that only small enough noise was left
    unclamped takes away less than that. Where the foretold speed is at a limit and the next too,
    it is the same limit.
    """
    recording = np.load(shared_data / "boids_benchmark" / f"{name}.npz")
    told = json.loads(str(recording["params"]))
    dynamics = dynamics_of(simulate_boids(2, 2, radius=told["r"], **changes))
    assert (dynamics.cohesion_gain, dynamics.separation_gain, dynamics.alignment_gain) == (
        told["kc"],
        told["ks"],
        told["ka"],
    )
    assert (dynamics.min_speed, dynamics.max_speed, dynamics.process_noise, dynamics.dt) == (
        told["vmin"],
        told["vmax"],
        told["sd"],
        told["dt"],
    )
    states = torch.from_numpy(recording["X"].astype(np.float64))
    position, velocity = states.chunk(2, -1)
    force, graph = dynamics.forces(position, velocity)
    np.testing.assert_array_equal(graph.numpy(), recording["A"])

    _, foretold = dynamics.move(position, velocity, force)
    reached = velocity[:, 1:]
    drift = (velocity + dynamics.dt * force.sum(-3))[:, :-1]
    speed = reached.norm(dim=-1)
    free = (speed > 0.6 + 1e-5) & (speed < 1.2 - 1e-5)
    assert 0.5 < free.double().mean() < 0.99
    noise = ((reached - drift) / (0.02 * velocity[:, :-1].norm(dim=-1, keepdim=True)))[free]
    assert abs((noise**2).mean() - 1) < 6 * math.sqrt(2 / noise.numel())
    assert abs(noise.mean()) < 6 / math.sqrt(noise.numel())
    # The states are in float32, of positions up to 100.
    landed = position[:, :-1] + dynamics.dt * reached
    np.testing.assert_allclose(landed, position[:, 1:], rtol=0, atol=2e-5)
    limits = foretold[:, :-1].norm(dim=-1)
    assert limits.min() > 0.6 - 1e-9
    assert limits.max() < 1.2 + 1e-9


def scatter(tracks):
    """Return each one's distance from the middle of the group, (trial, time, individual)."""
    position = values(tracks, "position")
    return np.linalg.norm(position - position.mean(2, keepdims=True), axis=-1)


def polarization(tracks):
    """Return the length of the mean heading, (trial, time)."""
    velocity = values(tracks, "velocity")
    heading = velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
    return np.linalg.norm(heading.mean(2), axis=-1)


def test_the_default_flock_stays_between_the_walls():
    """Nobody is far outside, few are alone, and the headings have an order.

    At the wall's slope 1 and speed 1.2 at most, a boid alone turns within 1.2 of the wall; the
    others may push it out by as much again. Ten headings without order have a mean length of
    0.886 / sqrt(10) = 0.28; twice that is asked for.
    """
    tracks = simulate_boids(steps=700, trials=10)
    assert abs(values(tracks, "position")).max() < 4 + 2 * 1.2
    assert (tracks["adjacency"].sum("neighbor") == 0).mean() < 0.05
    assert polarization(tracks)[:, 300:].mean() > 0.56
    speed = np.linalg.norm(values(tracks, "velocity"), axis=-1)
    assert speed.min() > 0.6 - 1e-9
    assert speed.max() < 1.2 + 1e-9


@pytest.mark.parametrize("space", [2, 3])
def test_the_default_flock_of_the_velocity_form_holds_together_and_drifts(space):
    """Its size after 1000 steps is that after 100, nobody is lost, and it has gone far."""
    tracks = simulate_boids(10, 1000, 5, form="velocity", space=space)
    size = scatter(tracks)
    assert abs(size[:, -300:].mean() / size[:, 100:400].mean() - 1) < 0.1
    assert size[:, 100:].max() < 2.5
    assert (tracks["adjacency"].sum("neighbor") > 0).all()
    center = values(tracks, "position").mean(2)
    assert np.linalg.norm(center - center[:, :1], axis=-1).max() > 10
    # Twice the mean length without order.
    assert polarization(tracks)[:, 300:].mean() > 0.56


@pytest.mark.parametrize("individuals", [1, 2, 50])
def test_other_sizes_of_the_default_flock(individuals):
    tracks = simulate_boids(individuals, 300, 2)
    assert abs(values(tracks, "position")).max() < 4 + 2 * 1.2
    assert int(tracks["adjacency"].sum()) == 0 or individuals > 1


def test_another_graph_takes_the_place_of_the_radius():
    """With three neighbours each everyone has three; a visual graph is not symmetric."""
    nearest = simulate_boids(8, 50, graph="k-nearest:3")
    assert (nearest["adjacency"].sum("neighbor") == 3).all()
    visual = simulate_boids(8, 50, graph="visual:body_length=0.3,blind_angle=90")
    adjacency = visual["adjacency"].values
    assert (adjacency != adjacency.swapaxes(-1, -2)).any()
    assert json.loads(visual["adjacency"].attrs["rule"])["blind_angle"] == 90.0


def test_the_start_scales_with_the_radius_and_the_speeds():
    """One individual in (0.6 r) ** 2, speeds between the limits, which are uniform."""
    tracks = simulate_boids(
        400, 2, radius=100.0, half_width=1e4, min_speed=50.0, max_speed=70.0, trials=2
    )
    position, velocity = values(tracks, "position")[:, 0], values(tracks, "velocity")[:, 0]
    assert 590 < abs(position).max() < 600  # 0.5 * 60 * sqrt(400)
    speed = np.linalg.norm(velocity, axis=-1)
    assert 50 <= speed.min() < 51 < 69 < speed.max() <= 70
    confined = simulate_boids(400, 2, half_width=3.0)
    assert abs(values(confined, "position")[:, 0]).max() <= 3.0
