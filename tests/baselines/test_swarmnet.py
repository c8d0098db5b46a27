"""SwarmNet on individuals that pull each other like springs."""

import numpy as np
import torch

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.swarmnet import SwarmNet
from swarmssm.graphs import GraphRule

FPS = 10.0
NOISE = 0.05


def springs(trials, frames, seed, space=2):
    """Four that pull each other: v' = v + dt (mean of others' p - p) k, p' = p + dt v', dt k = 0.3.

    With errors of 0.05 in the velocities.
    """
    generator = np.random.default_rng(seed)
    states = np.empty((trials, frames, 4, 2 * space))
    position = generator.standard_normal((trials, 4, space))
    velocity = generator.standard_normal((trials, 4, space))
    for frame in range(frames):
        states[:, frame] = np.concatenate([position, velocity], axis=-1)
        others = (position.sum(1, keepdims=True) - position) / 3
        noise = NOISE * generator.standard_normal(velocity.shape)
        velocity = 0.98 * velocity + 0.3 * (others - position) + noise
        position = position + velocity / FPS
    return states


def own_linear(train, test):
    """Return the error of the best linear forecast of a velocity from somebody's own state."""

    def rows(states):
        past = states[:, :-1].reshape(-1, 4)
        return np.c_[past, np.ones(len(past))], states[:, 1:, :, 2:].reshape(-1, 2)

    weights = np.linalg.lstsq(*rows(train), rcond=None)[0]
    past, after = rows(test)
    return ((past @ weights - after) ** 2).mean()


def test_frames_before_the_first_are_filled_by_going_back():
    baseline = SwarmNet()
    baseline.epochs = 1
    states = springs(2, 20, 0)
    baseline.fit_states(states, FPS, Training())
    network, scaler = baseline.network, baseline.scaler
    scaled = torch.from_numpy(scaler.transform(states[0, :3])).float().transpose(0, 1)[None]
    path = torch.cat([torch.zeros(1, 4, 2, 4), scaled], dim=2)
    seen = torch.tensor([False, False, True, True, True]).expand(1, 4, 5)
    filled = scaler.inverse(network._carried_back(path, seen)[0].double().numpy())
    first = states[0, 0]
    for frames in (1, 2):
        expected = first[:, :2] - frames * first[:, 2:] / FPS
        np.testing.assert_allclose(filled[:, 2 - frames, :2], expected, atol=1e-5)
        np.testing.assert_allclose(filled[:, 2 - frames, 2:], first[:, 2:], atol=1e-5)
    np.testing.assert_allclose(filled[:, 2:].swapaxes(0, 1), states[0, :3], atol=1e-5)


def test_all_see_all_whatever_the_rule():
    states = springs(2, 20, 0)
    paths = []
    for rule in (None, GraphRule.parse("radius:0.01")):
        baseline = SwarmNet()
        baseline.epochs = 1
        baseline.fit_states(states, FPS, Training(None, rule))
        paths.append(baseline.predict(states, 2, FPS))
    np.testing.assert_array_equal(*paths)


def test_it_learns_a_pull():
    train, test = springs(40, 40, 0), springs(20, 40, 1)
    baseline = SwarmNet()
    baseline.order, baseline.ahead = 8, 1
    baseline.epochs, baseline.learning_rate = 10, 1e-2
    baseline.fit_states(train, FPS, Training())
    predicted = baseline.one_step(test, FPS)
    error = ((predicted - test)[:, 5:, :, 2:] ** 2).mean()
    blind = own_linear(train, test)
    # Of what the best forecast from one's own state misses beyond the noise, 95 % is found. A mean
    # of 20 * 35 * 4 * 2 squares of the noise itself is within 6 sd, 0.11, of its variance.
    assert 0.89 * NOISE**2 < error < NOISE**2 + 0.05 * (blind - NOISE**2)
