"""Hold springs and charges to motions known in closed form, and to what they must conserve."""

import json
import math

import numpy as np
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.simulate import Charged, Springs, dynamics_of, simulate_charged, simulate_springs
from swarmssm.tracks import states_of, validate_tracks

BOTH = {"springs": simulate_springs, "charged": simulate_charged}
both = pytest.mark.parametrize("name", BOTH)
PAIR = [[0, 1], [1, 0]]


def values(tracks, name):
    """Return a variable as (trial, time, individual, space)."""
    return tracks[name].transpose("trial", "time", "individual", "space").to_numpy()


def test_two_on_a_spring_swing_as_in_the_textbook():
    """Distance cos(sqrt(2 k) t) and a centre that goes straight on.

    Leapfrog of step h lags behind by a phase of (w h) ** 2 / 24 in w t, here 9e-7 for h = 0.01.
    """
    k = 0.1
    start = {"initial_position": [[1.0, 0], [-1, 0]], "initial_velocity": [[0, 0.2], [0, 0.2]]}
    tracks = simulate_springs(2, 101, strength=k, substeps=10, springs=PAIR, **start)
    t = tracks["time"].to_numpy()
    w = math.sqrt(2 * k)
    place, speed = values(tracks, "position")[0], values(tracks, "velocity")[0]
    bound = (w * 0.01) ** 2 / 24 * w * t[-1] * 1.01
    np.testing.assert_allclose(place[:, 0, 0], np.cos(w * t), rtol=0, atol=bound)
    np.testing.assert_allclose(speed[:, 0, 0], -w * np.sin(w * t), rtol=0, atol=2 * bound)
    np.testing.assert_allclose(place[:, :, 1], np.stack([0.2 * t] * 2, 1), rtol=0, atol=1e-12)
    force = tracks["force"].sel(term="spring", space="x").isel(trial=0)
    np.testing.assert_allclose(force, -2 * k * place[..., 0], rtol=0, atol=1e-12)


def test_two_charges_repel_and_attract_as_in_the_textbook():
    """Energy k q q / r + v ** 2 (both of mass 1, speed v) is kept, and momentum is 0."""
    start = {"initial_position": [[0.5, 0], [-0.5, 0]], "initial_velocity": np.zeros((2, 2))}
    for charges, sign in (([1, 1], 1), ([-1, -1], 1), ([1, -1], -1)):
        steps = 11 if sign > 0 else 4
        tracks = simulate_charged(2, steps, charges=charges, half_width=50.0, **start)
        place, speed = values(tracks, "position")[0], values(tracks, "velocity")[0]
        r = np.linalg.norm(place[:, 0] - place[:, 1], axis=-1)
        assert (np.sign(np.diff(r)) == sign).all()
        energy = sign / r + (speed[:, 0] ** 2).sum(-1)
        # Of order (h / tau) ** 2 with the shortest time scale tau = sqrt(r ** 3 / 2) met.
        bound = 0.001**2 / (r.min() ** 3 / 2) * abs(1 / r).max()
        np.testing.assert_allclose(energy, sign * 1.0, rtol=0, atol=bound)
        np.testing.assert_allclose(speed.sum(1), 0, rtol=0, atol=1e-12)
        assert (tracks["edge_type"].values[0, 0] == (np.array(PAIR) if sign > 0 else 0)).all()


def test_walls_reflect():
    """Alone at speed 1 in a box of 2: back and forth as a triangle wave."""
    start = {"initial_position": [[0.5, 0.0]], "initial_velocity": [[1.0, 0.0]]}
    tracks = simulate_springs(1, 81, half_width=1.0, **start)
    t = tracks["time"].to_numpy()
    x = values(tracks, "position")[0, :, 0, 0]
    triangle = 1 - np.abs((0.5 + t + 1) % 4 - 2)
    np.testing.assert_allclose(x, triangle, rtol=0, atol=1e-12)
    np.testing.assert_allclose(abs(values(tracks, "velocity")[..., 0]), 1.0, rtol=0, atol=0)


@both
@pytest.mark.parametrize("space", [2, 3])
def test_what_is_recorded(name, space):
    tracks = BOTH[name](4, 12, 3, space=space)
    validate_tracks(tracks)
    assert not tracks.isnull().any().to_array().any()
    assert tracks.attrs["fps"] == pytest.approx(10.0)
    for quantity in ("position", "velocity"):
        now, foretold = values(tracks, quantity), values(tracks, f"next_{quantity}")
        np.testing.assert_array_equal(foretold[:, :-1], now[:, 1:])
    kinds = tracks["edge_type"].to_numpy()
    assert (kinds == kinds[:, :1]).all()
    assert (kinds == kinds.swapaxes(-1, -2)).all()
    expected = kinds if name == "springs" else np.broadcast_to(1 - np.eye(4), kinds.shape)
    np.testing.assert_array_equal(tracks["adjacency"], expected)
    speed = np.linalg.norm(values(tracks, "velocity")[:, 0], axis=-1)
    np.testing.assert_allclose(speed, 0.5, rtol=1e-12)


@both
def test_the_law_goes_on_from_any_state(name):
    """Of one trial; of several with other edges there is no one dynamics."""
    tracks = BOTH[name](5, 12, 3, seed=2, start_spread=1.0)
    with pytest.raises(InputError, match="differ between trials or frames"):
        dynamics_of(tracks)
    one = tracks.isel(trial=[1])
    dynamics = dynamics_of(one)
    assert isinstance(dynamics, {"springs": Springs, "charged": Charged}[name])
    assert type(dynamics).from_dict(json.loads(json.dumps(dynamics.to_dict()))) == dynamics
    position, velocity = (torch.from_numpy(values(one, q)) for q in ("position", "velocity"))
    force, graph = dynamics.forces(position, velocity)
    np.testing.assert_allclose(force.mT, one["force"], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(graph, one["adjacency"])
    moved = dynamics.move(position, velocity, force)
    for found, quantity in zip(moved, ("next_position", "next_velocity"), strict=True):
        np.testing.assert_allclose(found, values(one, quantity), rtol=0, atol=1e-10)
    with pytest.raises(InputError, match="no variable edge_type"):
        dynamics_of(one.drop_vars("edge_type"))
    with pytest.raises(InputError, match="Give the dynamics their edge_type"):
        type(dynamics).from_dict(dynamics.to_dict()).forces(position, velocity)


def test_half_of_the_pairs_have_a_spring_and_half_repel():
    """Share of n independent pairs; two pairs of three charges are independent, hence one each."""
    n = 4000
    kinds = simulate_springs(3, 2, n, substeps=1)["edge_type"].to_numpy()[:, 0]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert abs(kinds[:, i, j].mean() - 0.5) < 6 * 0.5 / math.sqrt(n)
    few = simulate_springs(3, 2, n, substeps=1, edge_probability=0.1)["edge_type"].to_numpy()
    assert abs(few[:, 0, 0, 1].mean() - 0.1) < 6 * 0.3 / math.sqrt(n)
    kinds = simulate_charged(3, 2, n, substeps=1)["edge_type"].to_numpy()[:, 0]
    assert abs(kinds[:, 0, 1].mean() - 0.5) < 6 * 0.5 / math.sqrt(n)
    # Of three charges two are alike: either all three pairs repel, or one does.
    assert set(kinds.sum((1, 2)).tolist()) == {2, 6}


@both
def test_edges_switch_and_the_motion_goes_on(name):
    """Every seven frames, burn-in counted; in between each frame follows from the one before."""
    tracks = BOTH[name](5, 40, 600, switch_every=7, burn_in=3, substeps=2)
    kinds = tracks["edge_type"].to_numpy()
    changed = (kinds[:, 1:] != kinds[:, :-1]).any((0, 2, 3))
    assert np.flatnonzero(changed).tolist() == [3, 10, 17, 24, 31, 38]
    for quantity in ("position", "velocity"):
        now, foretold = values(tracks, quantity), values(tracks, f"next_{quantity}")
        np.testing.assert_array_equal(foretold[:, :-1], now[:, 1:])
    calm = dynamics_of(tracks.isel(trial=[550], time=slice(4, 11)))
    state = [
        torch.from_numpy(values(tracks, quantity)[550, 4:11])
        for quantity in ("position", "velocity")
    ]
    moved = calm.move(*state, calm.forces(*state)[0])[0]
    np.testing.assert_allclose(moved, values(tracks, "next_position")[550, 4:11], atol=1e-10)


@both
def test_trials_do_not_depend_on_how_many_move_together(name):
    """The 600th of 600, which are flown in two lots, as if it were alone."""
    tracks = BOTH[name](4, 5, 600, substeps=3)
    start = {f"initial_{q}": values(tracks, q)[599, 0] for q in ("position", "velocity")}
    kinds = tracks["edge_type"].to_numpy()[599, 0]
    given = {"springs": kinds}
    if name == "charged":
        given = {"charges": [1.0, *(2.0 * kinds[0, 1:] - 1.0)]}
    alone = BOTH[name](4, 5, substeps=3, **start, **given)
    np.testing.assert_array_equal(alone["edge_type"][0, 0], kinds)
    np.testing.assert_allclose(
        values(alone, "position")[0], values(tracks, "position")[599], rtol=0, atol=1e-12
    )


@both
def test_one_seed_one_recording_and_noise(name):
    exact = BOTH[name](4, 30, 40, seed=4, substeps=2)
    assert exact.identical(BOTH[name](4, 30, 40, seed=4, substeps=2))
    assert (BOTH[name](4, 30, 40, seed=5, substeps=2)["position"] != exact["position"]).any()
    sd = 0.1
    noisy = BOTH[name](4, 30, 40, seed=4, substeps=2, observation_noise=sd)
    assert "velocity" not in noisy
    for quantity in ("position", "velocity"):
        np.testing.assert_array_equal(noisy[f"true_{quantity}"], exact[quantity])
    error = (noisy["position"] - noisy["true_position"]).values
    assert abs((error**2).mean() - sd**2) < 6 * sd**2 * math.sqrt(2 / error.size)
    assert states_of(noisy).shape == (40, 30, 4, 4)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("springs", {"individuals": 0}, "individuals: it must be a whole number from 1"),
        ("springs", {"steps": 1}, "steps"),
        ("springs", {"substeps": 0}, "substeps"),
        ("springs", {"dt": 0.0}, "dt: it must be a number above 0"),
        ("springs", {"space": 4}, "space: there can be 2 or 3"),
        ("springs", {"strength": -1.0}, "strength"),
        ("springs", {"edge_probability": 1.5}, "edge_probability: .* at most 1"),
        ("springs", {"switch_every": 0}, "switch_every"),
        ("springs", {"springs": np.zeros((5, 5)), "switch_every": 2}, "the pairs are given"),
        ("springs", {"springs": np.eye(5)}, "springs: each entry must be 0 or 1, the same"),
        ("springs", {"springs": np.zeros((4, 4))}, r"springs: its shape must be \(5, 5\)"),
        ("springs", {"observation_noise": -1.0}, "observation_noise"),
        ("springs", {"initial_position": np.full((5, 2), 6.0)}, "outside the box"),
        ("charged", {"positive_probability": -0.1}, "positive_probability"),
        ("charged", {"charges": [1, 1, 1, 1, 0]}, "charges: each must be 1 or -1"),
        ("charged", {"charges": [1, 1]}, r"charges: its shape must be \(5,\)"),
        ("charged", {"half_width": 0.0}, "half_width"),
    ],
)
def test_wrong_parameters_are_named(name, change, message):
    with pytest.raises(InputError, match=message):
        BOTH[name](**{"individuals": 5, "steps": 5, **change})
