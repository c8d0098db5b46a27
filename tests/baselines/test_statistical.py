"""What every baseline that is fitted by statistics has to keep to."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.autoregression import AR1, AR5
from swarmssm.baselines.interacting import InteractingModels
from swarmssm.baselines.kalman import KalmanVelocity
from swarmssm.baselines.ridge_boids import RidgeBoids
from swarmssm.baselines.sindy import SindyBoids, SindyGeneric
from swarmssm.baselines.sindy_autoencoder import SindyAutoencoder
from swarmssm.baselines.sindy_oracle import BoidsForms, SindyOracle
from swarmssm.baselines.sindy_pi import SindyPI
from swarmssm.graphs import GraphRule
from swarmssm.simulate import simulate_boids
from swarmssm.tracks import states_of

FPS = 10.0
RULE = GraphRule.parse("radius:2.5")


class QuickInteracting(InteractingModels):
    """With few evaluations of the likelihood."""

    evaluations = 3


class QuickKalman(KalmanVelocity):
    """With few evaluations of the likelihood."""

    evaluations = 5


class QuickAutoencoder(SindyAutoencoder):
    """With few steps, and small."""

    steps = 12
    batch = 64
    widths = (8,)
    latent_per_dimension = 2


class QuickPI(SindyPI):
    """With a small library, and less time than all left-hand sides would take."""

    degree = 1

    def learn(self, states, fps, training):
        super().learn(states, fps, replace(training, seconds=0.5))


class QuickGeneric(SindyGeneric):
    """With a small library."""

    degree = 2


def told():
    return SindyOracle(BoidsForms(2.5, 4.0, 0.6, 1.2))


KINDS = [
    AR1,
    AR5,
    RidgeBoids,
    QuickKalman,
    QuickInteracting,
    SindyBoids,
    QuickGeneric,
    told,
    QuickPI,
    QuickAutoencoder,
]


def flock(space=2):
    tracks = simulate_boids(individuals=5, steps=32, trials=3, seed=3, space=space)
    states = states_of(tracks)
    states[0, 12:15, 1] = np.nan
    states[1, 25:, 4] = np.nan
    states[2, :10, 0] = np.nan
    return states


def fitted(kind, space=2):
    states = flock(space)
    baseline = kind()
    baseline.fit_states(states[:2], FPS, Training(states[2:], RULE, None, 7))
    return baseline


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: kind.__name__)
def baseline(request):
    return fitted(request.param)


def test_each_step_is_the_forecast_from_what_came_before(baseline):
    states = flock()
    predicted = baseline.one_step(states, FPS)
    assert predicted.shape == states.shape
    assert np.isnan(predicted[:, 0]).all()
    for time in (1, 2, 16, 30):
        ahead = baseline.predict(states[:, :time], 1, FPS)[:, 0]
        np.testing.assert_allclose(predicted[:, time], ahead, rtol=1e-6, atol=1e-6)


def test_who_is_known_in_the_last_frame_is_forecast_and_nobody_else(baseline):
    history = flock()[:, :16]
    history[0, 15, 2] = np.nan
    history[1, :15, 3] = np.nan
    path = baseline.predict(history, 12, FPS)
    forecast = np.isfinite(path).all(axis=(1, 3))
    nothing = np.isnan(path).all(axis=(1, 3))
    here = np.isfinite(history[:, -1]).all(axis=-1)
    np.testing.assert_array_equal(forecast, here)
    np.testing.assert_array_equal(nothing, ~here)


def test_leading_axes_are_kept(baseline):
    history = flock()[:, 11:18]
    many = baseline.predict(np.stack([history, history[::-1]]), 3, FPS)
    assert many.shape == (2, 3, 3, 5, 4)
    np.testing.assert_allclose(many[0], baseline.predict(history, 3, FPS), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(many[1], many[0][::-1], rtol=1e-6, atol=1e-6)


def test_one_alone_is_forecast_from_one_frame(baseline):
    path = baseline.predict(flock()[0, 20:21, :1], 4, FPS)
    assert path.shape == (4, 1, 4)
    assert np.isfinite(path).all()


def test_it_comes_back_from_a_pickle(baseline):
    again = pickle.loads(pickle.dumps(baseline))
    history = flock()[:, :20]
    np.testing.assert_array_equal(again.predict(history, 3, FPS), baseline.predict(history, 3, FPS))
    assert again.num_parameters == baseline.num_parameters > 0


def test_draws_follow_the_seed_and_centre_on_what_is_expected(baseline):
    history = flock()[0, :20]
    copies = np.broadcast_to(history, (2000, *history.shape))
    first = baseline.predict(copies, 1, FPS, np.random.default_rng(1))
    again = baseline.predict(copies, 1, FPS, np.random.default_rng(1))
    np.testing.assert_array_equal(first, again)
    spread = first.std(axis=0)
    assert (spread > 0).all()
    expected = baseline.predict(history, 1, FPS)
    # 20 means of 2000 draws each; 5 standard errors are exceeded by chance once in 10^5 runs.
    bound = 5.0 * spread / np.sqrt(len(copies))
    assert (np.abs(first.mean(axis=0) - expected) <= bound + 1e-9).all()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_three_dimensions(kind):
    history = flock(3)[:, :20]
    path = fitted(kind, space=3).predict(history, 5, FPS)
    assert path.shape == (3, 5, 5, 6)
    assert np.isfinite(path).all()


@pytest.mark.parametrize("kind", [AR5, QuickKalman, QuickAutoencoder])
def test_the_same_seed_gives_the_same_numbers_and_leaves_the_state_of_torch(kind):
    before = torch.get_rng_state()
    first, again = fitted(kind), fitted(kind)
    history = flock()[:, :20]
    np.testing.assert_array_equal(first.predict(history, 5, FPS), again.predict(history, 5, FPS))
    assert torch.equal(before, torch.get_rng_state())
