"""DCRNN and DyGrEncoder on a diffusion over a fixed graph, whose noise is known."""

import numpy as np
import pytest
import torch

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.dcrnn import (
    DCRNN,
    DCRNNDirect,
)
from swarmssm.baselines.dygrencoder import DyGrEncoder, DyGrEncoderDirect
from swarmssm.graphs import GraphRule

FPS = 10.0
NOISE = 0.1
RATE = 0.9
FRAMES = 4


def diffusion(trials, seed):
    """Eight on a ring that stay where they are, and exchange their last two features.

    u_i <- u_i + 0.9 (mean of the two neighbours' u - u_i) + 0.1 e_i. Each trial is 4 frames from
    independent values of variance 1, before all is even.
    """
    generator = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(8) / 8
    states = np.empty((trials, FRAMES, 8, 4))
    states[..., :2] = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    value = generator.standard_normal((trials, 8, 2))
    for frame in range(FRAMES):
        states[:, frame, :, 2:] = value
        mean = 0.5 * (np.roll(value, 1, axis=1) + np.roll(value, -1, axis=1))
        value = value + RATE * (mean - value) + NOISE * generator.standard_normal(value.shape)
    return states


# Neighbours on the ring are 2 sin(pi/8) = 0.765 apart, the next ones 1.414.
RING = GraphRule.parse("radius:1.0")


def errors_on_a_diffusion(baseline):
    """Return the mean squared error after fitting, and that of the best blind linear forecast."""
    baseline.fit_states(diffusion(200, 0), FPS, Training(None, RING))
    test = diffusion(100, 1)
    predicted = baseline.one_step(test, FPS)
    error = ((predicted - test)[:, 1:, :, 2:] ** 2).mean()
    before, after = test[:, :-1, :, 2:].reshape(-1, 1), test[:, 1:, :, 2:].reshape(-1, 1)
    gain = np.linalg.lstsq(before, after, rcond=None)[0]
    return error, ((after - before @ gain) ** 2).mean()


RESIDUAL = (DCRNN, DyGrEncoder)
DIRECT = (DCRNNDirect, DyGrEncoderDirect)


@pytest.mark.parametrize("kind", RESIDUAL + DIRECT, ids=lambda kind: kind.name)
def test_the_published_output_writes_the_state_itself(kind):
    baseline = kind()
    baseline.epochs = 1
    baseline.fit_states(diffusion(3, 0), FPS, Training(None, RING))
    torch.nn.init.zeros_(baseline.network.out.weight)
    torch.nn.init.zeros_(baseline.network.out.bias)
    states = diffusion(1, 3)
    last, mean = states[:, -1], np.broadcast_to(baseline.scaler.offset, states[:, -1].shape)
    expected = last if kind in RESIDUAL else mean
    np.testing.assert_allclose(baseline.predict(states, 1, FPS)[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("kind", RESIDUAL, ids=lambda kind: kind.name)
def test_it_learns_a_diffusion(kind):
    assert_diffusion_is_learned(kind())


@pytest.mark.slow
@pytest.mark.parametrize("kind", DIRECT, ids=lambda kind: kind.name)
def test_the_published_output_learns_it_too(kind):
    assert_diffusion_is_learned(kind())


def assert_diffusion_is_learned(baseline):
    baseline.order, baseline.ahead = FRAMES - 1, 1
    baseline.epochs, baseline.learning_rate = 10, 1e-2
    error, blind = errors_on_a_diffusion(baseline)
    # Of what the best blind forecast misses beyond the noise, at least 95 % is found.
    assert NOISE**2 * 0.9 < error < NOISE**2 + 0.05 * (blind - NOISE**2)
