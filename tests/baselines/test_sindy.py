"""Sparse regression on boids whose law is known, with and without noise."""

import numpy as np
import pytest

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.library import monomials, polynomial_terms, sparse_coefficients
from swarmssm.baselines.ridge_boids import RidgeBoids
from swarmssm.baselines.sindy import SindyBoids, SindyGeneric
from swarmssm.baselines.sindy_oracle import BoidsForms, SindyOracle
from swarmssm.baselines.sindy_pi import SindyPI
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.simulate import simulate_boids, simulate_vicsek
from swarmssm.tracks import make_tracks, states_of

FPS = 10.0
RULE = GraphRule.parse("radius:2.5")
FREE = {"wall_gain": 0.0, "min_speed": 0.0, "max_speed": np.inf, "process_noise": 0.0}


def boids(**settings):
    return simulate_boids(**{"individuals": 8, "steps": 60, "trials": 4, "seed": 5, **settings})


@pytest.mark.parametrize("space", [2, 3])
def test_noise_free_boids_are_found_exactly(space):
    baseline = SindyBoids().fit(boids(space=space, **FREE), graph="radius:2.5")
    assert baseline.terms == [(index,) for index in range(3 * space)]
    expected = np.concatenate([gain * np.eye(space) for gain in (0.5, 0.3, 0.2)], axis=1)
    np.testing.assert_allclose(baseline.coefficients, expected, rtol=1e-8, atol=1e-12)
    assert baseline.num_parameters == 3 * space


def test_told_the_forms_walls_and_limits_do_not_bias_the_gains():
    tracks = boids(process_noise=0.0, steps=120)
    baseline = SindyOracle().fit(tracks)
    expected = np.concatenate([gain * np.eye(2) for gain in (0.5, 0.3, 0.2, 1.0)], axis=1)
    np.testing.assert_allclose(baseline.coefficients, expected, rtol=1e-8, atol=1e-12)
    assert baseline.forms == BoidsForms(2.5, 4.0, 0.6, 1.2, 1.0)
    assert baseline.knows_true_form
    assert baseline.num_parameters == 8
    # Forecasts, the clamp included, are the simulation itself.
    states = states_of(tracks)
    path = baseline.predict(states[:, :100], 20, FPS)
    np.testing.assert_allclose(path, states[:, 100:], rtol=0, atol=1e-6)


def test_equations_are_written_out():
    baseline = SindyOracle(BoidsForms(2.5))
    baseline.fit(boids(**FREE))
    assert baseline.equations(3) == [
        "dvx/dt = +0.5 Cx +0.3 Sx +0.2 Ax",
        "dvy/dt = +0.5 Cy +0.3 Sy +0.2 Ay",
    ]


def test_where_the_true_forms_are_unknown_it_says_so():
    states = states_of(boids())
    recorded = make_tracks(states[..., :2], fps=FPS)
    with pytest.raises(InputError, match="only run where the true forms are known"):
        SindyOracle().fit(recorded)
    with pytest.raises(InputError, match="follow another law"):
        SindyOracle().fit(simulate_vicsek(individuals=5, steps=20))
    with pytest.raises(InputError, match="Give it BoidsForms"):
        SindyOracle().fit_states(states, FPS, Training())


def test_the_generic_library_finds_a_group_that_pulls_as_one():
    # Everybody sees everybody and is drawn to the mean of the others, without separation.
    tracks = boids(**FREE, graph="complete", separation_gain=0.0)
    baseline = SindyGeneric().fit(tracks)
    expected = np.concatenate([0.5 * np.eye(2), 0.2 * np.eye(2)], axis=1)
    assert baseline.terms == [(4,), (5,), (6,), (7,)]
    np.testing.assert_allclose(baseline.coefficients, expected, rtol=1e-8, atol=1e-12)


def test_ridge_on_boids_terms_finds_noise_free_gains():
    states = states_of(boids(**FREE))
    baseline = RidgeBoids()
    baseline.fit_states(states, FPS, Training(graph=RULE))
    weights = baseline.force.weights
    social = np.concatenate([gain * np.eye(2) for gain in (0.5, 0.3, 0.2)], axis=1)
    np.testing.assert_allclose(weights[:, :6], social, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(weights[:, 6:], 0.0, rtol=0, atol=1e-5)
    assert baseline.num_parameters == 26


def test_beyond_what_was_learned_a_rollout_stays_within_bounds():
    states = states_of(boids(steps=40))
    baseline = SindyBoids()
    baseline.fit_states(states, FPS, Training(graph=RULE))
    far = states[:, -1:] + np.array([100.0, -100.0, 5.0, -5.0])
    path = baseline.predict(far, 200, FPS)
    assert np.isfinite(path).all()


class Drag(SindyPI):
    """A smaller library, for time's sake."""

    degree = 1


def dragged(num_times, seed):
    """One whose drag is a ratio: a = -v / (1 + 2 |v|^2), with dt = 0.1."""
    random = np.random.default_rng(seed)
    position, velocity = np.zeros((1, 2)), random.uniform(-2.0, 2.0, (1, 2))
    states = []
    for _ in range(num_times):
        states.append(np.concatenate([position, velocity], axis=-1))
        squared = (velocity**2).sum(axis=-1, keepdims=True)
        velocity = velocity - 0.1 * velocity / (1.0 + 2.0 * squared)
        position = position + 0.1 * velocity
    return np.stack(states)


def test_sindy_pi_finds_a_ratio_from_many_trajectories_of_different_length():
    lengths = (30, 45, 60, 38, 52)
    states = np.full((5, 60, 1, 4), np.nan)
    for trial, length in enumerate(lengths):
        states[trial, :length] = dragged(length, trial)
    baseline = Drag()
    baseline.fit_states(states, FPS, Training(states))
    for axis, equation in enumerate(baseline.equations(4)):
        coordinate = "xy"[axis]
        assert equation == f"dv{coordinate}/dt = (-1 v{coordinate}) / (+1 +2 |v|^2)"
    for ratio in baseline.ratios:
        assert ratio.denominator[1] == pytest.approx(2.0, rel=1e-6)
    path = baseline.predict(dragged(60, 9)[:20], 40, FPS)
    np.testing.assert_allclose(path, dragged(60, 9)[20:], rtol=0, atol=1e-6)


def test_products_of_variables():
    variables = np.array([[2.0, 3.0], [5.0, -1.0]])
    terms = polynomial_terms([0, 1], 2)
    assert terms == [(), (0,), (1,), (0, 0), (0, 1), (1, 1)]
    expected = [[1, 2, 3, 4, 6, 9], [1, 5, -1, 25, -5, 1]]
    np.testing.assert_array_equal(monomials(variables, terms), expected)


def test_small_terms_go_and_the_rest_is_least_squares():
    random = np.random.default_rng(0)
    inputs = random.standard_normal((200, 4))
    target = inputs @ np.array([[2.0], [0.0], [-1.0], [0.0]])
    target = target + 0.01 * random.standard_normal((200, 1))
    found = sparse_coefficients(np.concatenate([inputs, target], axis=1), 1, 0.1)[0]
    kept = np.linalg.lstsq(inputs[:, [0, 2]], target, rcond=None)[0][:, 0]
    np.testing.assert_allclose(found[[0, 2]], kept, rtol=1e-9)
    np.testing.assert_array_equal(found[[1, 3]], 0.0)
