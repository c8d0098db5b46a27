"""What all neural baselines keep to: gaps, shapes, seeds, draws, and no look into the future."""

import pickle

import numpy as np
import pytest
import torch

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.dcrnn import (
    DCRNN,
    DCRNNDirect,
)
from swarmssm.baselines.dygrencoder import DyGrEncoder, DyGrEncoderDirect
from swarmssm.baselines.knode import KNODE
from swarmssm.baselines.lstm import LSTM
from swarmssm.baselines.neural import NeuralBaseline, StepNetwork
from swarmssm.baselines.swarmnet import SwarmNet
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.tracks import make_tracks

FPS = 10.0
RULE = GraphRule.parse("radius:2.0")
KINDS = (
    LSTM,
    DCRNN,
    DCRNNDirect,
    DyGrEncoder,
    DyGrEncoderDirect,
    SwarmNet,
    KNODE,
)


def walks(trials=2, frames=60, individuals=4, space=2, seed=0):
    """Random walks with inertia about the origin, positions and velocities agreeing."""
    generator = np.random.default_rng(seed)
    states = np.empty((trials, frames, individuals, 2 * space))
    position = generator.standard_normal((trials, individuals, space))
    velocity = generator.standard_normal((trials, individuals, space))
    for frame in range(frames):
        states[:, frame] = np.concatenate([position, velocity], axis=-1)
        push = generator.standard_normal(velocity.shape)
        velocity = 0.9 * velocity - 0.1 * position + 0.2 * push
        position = position + velocity / FPS
    return states


def fitted(kind, states=None, epochs=1, seed=0, validation=None, rule=RULE):
    short = type(kind.__name__, (kind,), {"epochs": epochs, "rows": 40})
    baseline = short()
    baseline.fit_states(
        walks() if states is None else states, FPS, Training(validation, rule, None, seed)
    )
    return baseline


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: kind.name)
def baseline(request):
    return fitted(request.param)


def test_shapes_and_labels(baseline):
    states = walks(seed=1)
    predicted = baseline.one_step(states, FPS)
    assert predicted.shape == states.shape
    assert predicted.dtype == np.float64
    assert np.isnan(predicted[:, 0]).all()
    assert np.isfinite(predicted[:, 1:]).all()
    path = baseline.predict(states, 3, FPS)
    assert path.shape == (2, 3, 4, 4)
    assert np.isfinite(path).all()
    tracks = make_tracks(states[..., :2], velocity=states[..., 2:], fps=FPS)
    forecast = baseline.forecast(tracks, 3, draws=2)
    assert forecast["position"].shape == (2, 2, 3, 2, 4)
    assert baseline.num_parameters == sum(part.numel() for part in baseline.network.parameters())


def test_leading_dimensions_are_folded_and_change_nothing(baseline):
    states = walks(trials=4, frames=30, seed=2)
    folded = states.reshape(2, 2, *states.shape[1:])
    for whole, parts in (
        (baseline.one_step(states, FPS), baseline.one_step(folded, FPS)),
        (baseline.predict(states, 4, FPS), baseline.predict(folded, 4, FPS)),
        (baseline.predict(states, 4, FPS)[2], baseline.predict(states[2], 4, FPS)),
    ):
        np.testing.assert_allclose(parts.reshape(whole.shape), whole, rtol=1e-4, atol=1e-4)


def test_one_step_is_the_forecast_from_the_frames_before(baseline):
    states = walks(trials=1, frames=18, seed=3)[0]
    predicted = baseline.one_step(states, FPS)
    for frame in (1, 2, 7):
        path = baseline.predict(states[:frame], 1, FPS)
        np.testing.assert_allclose(predicted[frame], path[0], rtol=1e-4, atol=1e-4)


def test_nothing_is_taken_from_the_future(baseline):
    states = walks(frames=50, seed=4)
    changed = states.copy()
    changed[:, 33:] += 3.0
    first, second = (baseline.one_step(some, FPS)[:, :34] for some in (states, changed))
    np.testing.assert_array_equal(first, second)


def test_gaps_are_bridged_and_the_unknown_is_not_forecast(baseline):
    states = walks(frames=40, seed=5)
    states[:, 10:13, 0] = np.nan
    states[:, :38, 1] = np.nan
    states[:, 39, 2] = np.nan
    states[:, 20:, 3, 1] = np.nan
    known = np.isfinite(states).all(-1)
    predicted = baseline.one_step(states, FPS)
    np.testing.assert_array_equal(np.isfinite(predicted[:, 1:]).all(-1), known[:, :-1])
    assert (np.isfinite(predicted).all(-1) == np.isfinite(predicted).any(-1)).all()
    path = baseline.predict(states, 5, FPS)
    assert np.isfinite(path[:, :, :2]).all()
    assert np.isnan(path[:, :, 2:]).all()


def test_who_is_absent_moves_nobody(baseline):
    states = walks(frames=30, seed=6)
    states[:, :, 2] = np.nan
    without = np.delete(states, 2, axis=2)
    for whole, fewer in (
        (baseline.one_step(states, FPS), baseline.one_step(without, FPS)),
        (baseline.predict(states, 4, FPS), baseline.predict(without, 4, FPS)),
    ):
        np.testing.assert_allclose(np.delete(whole, 2, axis=2), fewer, rtol=1e-4, atol=1e-4)


def test_one_individual_alone(baseline):
    alone = walks(frames=30, individuals=1, seed=7)
    assert np.isfinite(baseline.predict(alone, 4, FPS)).all()
    assert np.isfinite(fitted(type(baseline).__bases__[0], alone).predict(alone, 4, FPS)).all()


def test_the_order_of_individuals_does_not_matter(baseline):
    states = walks(frames=30, seed=8)
    order = [2, 0, 3, 1]
    path = baseline.predict(states, 4, FPS)[:, :, order]
    permuted = baseline.predict(states[:, :, order], 4, FPS)
    np.testing.assert_allclose(permuted, path, rtol=1e-4, atol=1e-4)


def test_a_history_of_one_frame_and_a_long_one(baseline):
    states = walks(frames=60, seed=9)
    assert np.isfinite(baseline.predict(states[:, -1:], 2, FPS)).all()
    recent = baseline.predict(states[:, -baseline.order :], 2, FPS)
    np.testing.assert_allclose(baseline.predict(states, 2, FPS), recent, rtol=1e-5, atol=1e-6)
    assert np.isnan(baseline.one_step(states[:, :1], FPS)).all()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_three_dimensions(kind):
    states = walks(space=3)
    baseline = fitted(kind, states)
    assert baseline.predict(states, 2, FPS).shape == (2, 2, 4, 6)
    assert baseline.residual_covariance.shape == (6, 6)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_the_same_seed_gives_the_same_numbers_and_leaves_no_trace(kind):
    before = torch.get_rng_state()
    first, again, other = (fitted(kind, seed=seed) for seed in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), before)
    states = walks(seed=10)
    paths = [some.predict(states, 3, FPS) for some in (first, again, other)]
    np.testing.assert_array_equal(paths[0], paths[1])
    assert not np.allclose(paths[0], paths[2])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_pickle(kind):
    baseline = kind()
    baseline.epochs = 1
    baseline.fit_states(walks(), FPS, Training(None, RULE))
    copy = pickle.loads(pickle.dumps(baseline))
    states = walks(seed=11)
    np.testing.assert_array_equal(copy.predict(states, 3, FPS), baseline.predict(states, 3, FPS))
    draws = [some.predict(states, 3, FPS, np.random.default_rng(0)) for some in (copy, baseline)]
    np.testing.assert_array_equal(*draws)


def test_draws_spread_as_the_errors_do():
    baseline = fitted(LSTM)
    states = walks(trials=1, frames=25, seed=12)
    many = np.broadcast_to(states, (3000, *states.shape))
    draws = baseline.predict(many, 1, FPS, np.random.default_rng(1))
    assert draws.shape == (3000, 1, 1, 4, 4)
    expected = baseline.predict(states, 1, FPS)
    errors = (draws - expected).reshape(-1, 4)
    truth = baseline.residual_covariance
    # Var of a sample covariance of Gaussians: (s_ii s_jj + s_ij^2) / n.
    sd = np.sqrt((np.outer(np.diag(truth), np.diag(truth)) + truth**2) / len(errors))
    assert (np.abs(np.cov(errors, rowvar=False) - truth) < 6 * sd).all()
    assert (np.abs(errors.mean(0)) < 6 * np.sqrt(np.diag(truth) / len(errors))).all()


def test_draws_go_on_from_what_was_drawn():
    baseline = fitted(KNODE)
    states = walks(trials=1, seed=13)
    many = np.broadcast_to(states, (2, *states.shape))
    draws = baseline.predict(many, 2, FPS, np.random.default_rng(1))
    again = baseline.predict(draws[:, 0, :1], 1, FPS)[:, 0]
    sd = np.sqrt(np.diag(baseline.residual_covariance))
    # One more error was drawn in the second step: 2 draws of 4 individuals.
    assert (np.abs(draws[:, 0, 1] - again) < 6 * sd).all()
    assert not np.allclose(draws[0], draws[1])


def test_a_repeated_history_gives_the_same_path_as_a_copied_one():
    baseline = fitted(DyGrEncoder)
    states = walks(trials=2, seed=14)
    many = np.broadcast_to(states, (3, *states.shape))
    paths = [baseline.predict(some, 3, FPS) for some in (many, many.copy())]
    np.testing.assert_allclose(*paths, rtol=1e-4, atol=1e-5)


class Counting(NeuralBaseline):
    """Follows one number: by how much everything moves on in a frame, in scaled units."""

    name = "counting"
    title = "counting"
    order = 3
    ahead = 2
    epochs = 40
    learning_rate = 0.1

    def build(self, setting):
        return Drift(setting.features)


class Drift(StepNetwork):
    def __init__(self, features):
        super().__init__()
        self.drift = torch.nn.Parameter(torch.zeros(features))

    def step(self, states, mask, graph, memory):
        return states + self.drift, memory


def drifting(frames=200, seed=0):
    """Positions that move by (0.3, -0.1) in a frame, with errors of 0.1; velocities at random."""
    generator = np.random.default_rng(seed)
    states = 0.1 * generator.standard_normal((3, frames, 2, 4))
    states[..., :2] = np.cumsum(states[..., :2] + [0.3, -0.1], axis=1)
    return states


def test_training_finds_the_minimum_and_the_best_weights_on_the_validation_part():
    baseline = Counting()
    baseline.fit_states(drifting(), FPS, Training(None, RULE))
    drift = baseline.network.drift.detach().numpy() * np.asarray(baseline.scaler.scale)
    # 3 * 199 * 2 steps of known error; the rate of learning ends at 0, so that what is left of
    # its noise is less than that of the mean.
    np.testing.assert_allclose(drift[:2], [0.3, -0.1], rtol=0, atol=6 * 0.1 / np.sqrt(1194))
    still = np.concatenate([drifting(9, seed=1)[..., :2] * 0.0, drifting(9)[..., 2:]], axis=-1)
    judged = Counting()
    judged.fit_states(drifting(), FPS, Training(still, RULE))
    early = judged.network.drift.detach().numpy() * np.asarray(judged.scaler.scale)
    # Nothing moves in the validation part: the earliest weights forecast it best.
    assert np.linalg.norm(early[:2]) < 0.7 * np.linalg.norm([0.3, -0.1])


def test_a_time_limit_ends_the_training():
    baseline = Counting()
    baseline.epochs = 10**9
    baseline.fit_states(drifting(), FPS, Training(None, RULE, seconds=1e-3))
    assert baseline.network is not None


def test_two_steps_are_enough_to_learn_from():
    states = np.full((1, 3, 2, 4), np.nan)
    states[0, :, 0] = np.arange(12).reshape(3, 4)
    for kind in KINDS:
        path = fitted(kind, states).predict(states, 2, FPS)
        assert np.isfinite(path[0, :, 0]).all()
        assert np.isnan(path[0, :, 1]).all()


def test_mistakes_are_told():
    with pytest.raises(InputError, match="lstm: fit it first"):
        LSTM().predict(walks(), 1, FPS)
    with pytest.raises(InputError, match="knode: fit it first"):
        KNODE().one_step(walks(), FPS)
    with pytest.raises(InputError, match="horizon: it must be at least 1"):
        fitted(Counting).predict(walks(), 0, FPS)
    with pytest.raises(TypeError, match="must define build"):
        NeuralBaseline().build(None)
    with pytest.raises(TypeError, match="must define step"):
        StepNetwork().step(None, None, None, {})
