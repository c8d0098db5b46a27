"""Hold what the simulators share: truth of each step, seeds, noise, and refusals."""

import json
import math

import numpy as np
import pytest
import torch

from swarmssm import graphs
from swarmssm.errors import InputError, WorkError
from swarmssm.simulate import (
    Boids,
    Couzin,
    Vicsek,
    dynamics_of,
    simulate_boids,
    simulate_couzin,
    simulate_vicsek,
)
from swarmssm.tracks import states_of, validate_tracks

SIMULATORS = {
    "boids": simulate_boids,
    "velocity": lambda *sizes, **kw: simulate_boids(*sizes, form="velocity", **kw),
    "regulated": lambda *sizes, **kw: simulate_boids(*sizes, relaxation_gain=0.5, **kw),
    "vicsek": simulate_vicsek,
    "couzin": simulate_couzin,
}
every = pytest.mark.parametrize("name", SIMULATORS)
TERMS = {
    "boids": ["cohesion", "separation", "alignment", "wall"],
    "velocity": ["cohesion", "separation", "alignment"],
    "regulated": ["cohesion", "separation", "alignment", "wall", "speed_regulation"],
    "vicsek": ["alignment"],
    "couzin": ["repulsion", "orientation", "attraction"],
}


def run(name, individuals=7, steps=12, trials=3, **changes):
    return SIMULATORS[name](individuals, steps, trials, **changes)


def values(tracks, name):
    """Return a variable as (trial, time, individual, space)."""
    return tracks[name].transpose("trial", "time", "individual", "space").to_numpy()


@every
@pytest.mark.parametrize("space", [2, 3])
def test_what_is_recorded(name, space):
    tracks = run(name, space=space)
    assert dict(tracks.sizes) == {
        "trial": 3,
        "time": 12,
        "space": space,
        "individual": 7,
        "neighbor": 7,
        "term": len(TERMS[name]),
    }
    assert tracks["force"].dims == ("trial", "time", "term", "space", "individual")
    assert tracks["term"].values.tolist() == TERMS[name]
    assert not tracks.isnull().any().to_array().any()
    validate_tracks(tracks)
    dynamics = dynamics_of(tracks)
    assert tracks.attrs["fps"] == 1 / dynamics.dt
    np.testing.assert_allclose(np.diff(tracks["time"]), dynamics.dt, rtol=0, atol=1e-12)


@every
def test_without_noise_the_next_state_is_the_true_one(name):
    tracks = run(name, process_noise=0.0)
    for quantity in ("position", "velocity"):
        now, foretold = values(tracks, quantity), values(tracks, f"next_{quantity}")
        np.testing.assert_array_equal(foretold[:, :-1], now[:, 1:])


@every
def test_with_noise_the_next_state_is_that_of_the_law(name):
    """Step by hand from every recorded state: force, graph and next state are those recorded."""
    tracks = run(name)
    dynamics = dynamics_of(tracks)
    position = torch.from_numpy(values(tracks, "position"))
    velocity = torch.from_numpy(values(tracks, "velocity"))
    force, graph = dynamics.forces(position, velocity)
    foretold = dynamics.move(position, velocity, force)
    # The same sums, in batches of another shape.
    close = {"rtol": 0, "atol": 1e-12}
    np.testing.assert_allclose(force.mT, tracks["force"], **close)
    np.testing.assert_array_equal(graph, tracks["adjacency"])
    np.testing.assert_allclose(foretold[0], values(tracks, "next_position"), **close)
    np.testing.assert_allclose(foretold[1], values(tracks, "next_velocity"), **close)
    assert (values(tracks, "next_velocity")[:, :-1] != values(tracks, "velocity")[:, 1:]).any()


@every
def test_one_seed_one_recording(name):
    assert run(name, seed=4).identical(run(name, seed=4))
    generator = torch.Generator().manual_seed(4)
    drawn = run(name, seed=generator)
    np.testing.assert_array_equal(drawn["position"], run(name, seed=4)["position"])
    assert json.loads(drawn.attrs["simulation"])["seed"] is None
    again = run(name, seed=generator)
    for other in (run(name, seed=5), again):
        assert (other["position"].values != drawn["position"].values).all()


@every
def test_trials_are_independent(name):
    """They begin differently, and each goes on as if it were alone."""
    tracks = run(name)
    first = values(tracks, "position")[:, 0]
    assert (first[0] != first[1]).all()
    start = {f"initial_{q}": values(tracks, q)[:, 0] for q in ("position", "velocity")}
    together = run(name, process_noise=0.0, **start)
    for k in range(3):
        one = {q: value[k] for q, value in start.items()}
        alone = run(name, trials=1, process_noise=0.0, **one)
        np.testing.assert_allclose(
            values(alone, "position")[0], values(together, "position")[k], rtol=0, atol=1e-10
        )


@every
def test_noise_differs_between_trials_and_individuals(name):
    """From one state in every trial, the noise of each trial and individual is another one.

    Fish that turn as fast as they want, as else the limit of turning hides the noise.
    """
    agile = {"turning_rate": 4000.0} if name == "couzin" else {}
    tracks = run(name, steps=2, trials=1)
    start = {f"initial_{q}": values(tracks, q)[0, 0] for q in ("position", "velocity")}
    disturbed = run(name, steps=2, **start, **agile)
    error = (values(disturbed, "velocity")[:, 1] - values(disturbed, "next_velocity")[:, 0])[..., 0]
    assert len(np.unique(error)) == error.size


@every
def test_burn_in_is_what_comes_before(name):
    whole, late = run(name, steps=30), run(name, steps=20, burn_in=10)
    np.testing.assert_array_equal(whole["position"][:, 10:], late["position"])
    assert late["time"][0] == 0


@every
def test_observation_noise_hides_the_truth(name):
    """The mean square of n Gaussian errors has a standard error of s ** 2 * sqrt(2 / n)."""
    sd, exact = 0.3, run(name, steps=200)
    noisy = run(name, steps=200, observation_noise=sd)
    assert "velocity" not in noisy
    assert "true_position" not in exact
    for quantity in ("position", "velocity"):
        np.testing.assert_array_equal(noisy[f"true_{quantity}"], exact[quantity])
    for variable in ("force", "adjacency", "next_position", "next_velocity"):
        np.testing.assert_array_equal(noisy[variable], exact[variable])
    error = (noisy["position"] - noisy["true_position"]).values
    assert abs((error**2).mean() - sd**2) < 6 * sd**2 * math.sqrt(2 / error.size)
    assert abs(error.mean()) < 6 * sd / math.sqrt(error.size)
    # What a reader takes for the velocity is then the difference of noisy positions.
    differenced = states_of(noisy)[:, 1:, :, 2:]
    expected = np.diff(values(noisy, "position"), axis=1) * noisy.attrs["fps"]
    np.testing.assert_allclose(differenced, expected)


@every
def test_the_law_is_read_back(name):
    tracks = run(name, seed=3, observation_noise=0.1, burn_in=2)
    dynamics = dynamics_of(tracks)
    assert isinstance(dynamics, {"vicsek": Vicsek, "couzin": Couzin}.get(name, Boids))
    assert type(dynamics).from_dict(json.loads(json.dumps(dynamics.to_dict()))) == dynamics
    settings = json.loads(tracks.attrs["simulation"])
    assert {**dynamics.to_dict(), "dynamics": dynamics.name}.items() <= settings.items()
    assert [settings[k] for k in ("seed", "observation_noise", "burn_in")] == [3, 0.1, 2]


def test_the_graph_rule_is_kept_with_the_graph():
    rule = graphs.rule_of(run("boids", radius=1.5))
    assert rule == graphs.GraphRule("radius", radius=1.5)
    rule = graphs.rule_of(run("vicsek", radius=0.5, box=3.0))
    assert rule == graphs.GraphRule("radius", radius=0.5, box=3.0)
    assert graphs.rule_of(run("couzin")) is None


def test_tracks_that_are_not_simulated_have_no_law():
    tracks = run("boids")
    for attrs, message in (
        ({}, "no attribute simulation"),
        ({"simulation": "boids"}, "cannot be read"),
        ({"simulation": '{"dynamics": "gas"}'}, "cannot be read"),
        ({"simulation": '{"dynamics": "vicsek", "dt": 1.0}'}, "cannot be read"),
    ):
        tracks.attrs = attrs
        with pytest.raises(InputError, match=message):
            dynamics_of(tracks)


@every
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"individuals": 0}, "individuals: it must be a whole number from 1 upwards, not 0"),
        ({"individuals": 2.5}, "individuals"),
        ({"steps": 1}, "steps: it must be a whole number from 2"),
        ({"trials": 0}, "trials"),
        ({"trials": True}, "trials"),
        ({"burn_in": -1}, "burn_in"),
        ({"dt": 0.0}, "dt: it must be a number above 0, not 0.0"),
        ({"dt": math.nan}, "dt"),
        ({"dt": "fast"}, "dt: it must be a number above 0, not 'fast'"),
        ({"space": 4}, "space: there can be 2 or 3 dimensions, not 4"),
        ({"process_noise": -0.1}, "process_noise"),
        ({"process_noise": math.inf}, "process_noise"),
        ({"observation_noise": -0.1}, "observation_noise"),
        ({"seed": -1}, "seed"),
        ({"seed": "x"}, "seed"),
        ({"initial_position": np.zeros((3, 2))}, r"initial_position: .*\(7, 2\).* is \(3, 2\)"),
        ({"initial_position": np.full((7, 2), np.nan)}, "initial_position: every entry"),
        ({"initial_velocity": "fast"}, "initial_velocity"),
    ],
)
def test_wrong_sizes_are_named(name, change, message):
    with pytest.raises(InputError, match=message):
        run(name, **change)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("boids", {"form": "jerk"}, "form: 'jerk' is unknown; choose one of acceleration, vel"),
        ("boids", {"noise": "pink"}, "noise: 'pink' is unknown; choose one of additive, mult"),
        ("boids", {"radius": -1.0}, "radius: it must be a number from 0 upwards"),
        ("boids", {"radius": 1.0, "graph": "complete"}, "graph: it takes the place of radius"),
        ("boids", {"graph": "round"}, "graph: the kind 'round'"),
        ("boids", {"graph": "visual"}, "graph: a visual graph needs two dim.* its body_length"),
        ("boids", {"graph": "visual:1", "space": 3}, "graph: a visual graph needs two"),
        ("boids", {"cohesion_gain": -1.0}, "cohesion_gain"),
        ("boids", {"exponent": -1.0}, "exponent"),
        ("boids", {"half_width": 0.0}, "half_width"),
        ("boids", {"min_speed": 2.0}, "min_speed: it is 2 and must not be above max_speed.* 1.2"),
        ("boids", {"max_speed": 0.0}, "max_speed"),
        ("boids", {"preferred_speed": 0.0}, "preferred_speed"),
        ("boids", {"relaxation_gain": -1.0}, "relaxation_gain"),
        ("vicsek", {"speed": 0.0}, "speed"),
        ("vicsek", {"radius": -1.0}, "radius"),
        ("vicsek", {"radius": 3.0}, "radius: in a periodic box of side 5 .* at most 2.5"),
        ("vicsek", {"box": 0.0}, "box"),
        ("vicsek", {"process_noise": 7.0}, "process_noise: .* at most 6.28319, not 7.0"),
        ("vicsek", {"initial_velocity": np.zeros((7, 2))}, "initial_velocity: each needs a dir"),
        ("couzin", {"turning_rate": 0.0}, "turning_rate"),
        ("couzin", {"blind_angle": 360.0}, "blind_angle: it must be below 360 degrees"),
        ("couzin", {"orientation_radius": 0.5}, "orientation_radius: it is 0.5 and must not be"),
        ("couzin", {"attraction_radius": 2.0}, "attraction_radius: .* below orientation_radius"),
        ("couzin", {"initial_velocity": np.zeros((7, 2))}, "initial_velocity: each needs a dir"),
    ],
)
def test_wrong_parameters_are_named(name, change, message):
    with pytest.raises(InputError, match=message):
        run(name, **change)


def test_an_explosion_names_the_step_and_a_remedy():
    """Each step multiplies the distance of two by 1 - 2 * 100 * 0.1 = -19.

    Half of 19 ** 9 is 1.6e11, and half of 19 ** 10 is beyond the 1e12 that a position may have.
    """
    start = {"initial_position": [[0.0, 0], [1, 0]], "initial_velocity": np.zeros((2, 2))}
    with pytest.raises(WorkError, match=r"simulate boids: in step 10 of 40 .* smaller dt"):
        simulate_boids(
            2,
            40,
            form="velocity",
            cohesion_gain=100.0,
            separation_gain=0.0,
            alignment_gain=0.0,
            process_noise=0.0,
            graph="complete",
            **start,
        )
