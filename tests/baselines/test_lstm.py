"""The LSTM against torch's own cell, and on a recursion that asks for memory."""

import numpy as np
import torch

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.lstm import LSTM, LstmUnit

FPS = 10.0


def test_the_unit_is_that_of_torch():
    torch.manual_seed(0)
    unit, judge = LstmUnit(3, 5), torch.nn.LSTMCell(3, 5)
    # torch orders the gates: write, keep, new, read; here: write, keep, read, new.
    order = torch.tensor([0, 1, 3, 2])
    with torch.no_grad():
        for ours, theirs in (
            (unit.given.weight, judge.weight_ih),
            (unit.kept.weight, judge.weight_hh),
            (unit.given.bias, judge.bias_ih),
        ):
            ours.copy_(theirs.unflatten(0, (4, 5))[order].flatten(0, 1))
        judge.bias_hh.zero_()
        memory = unit.begin(torch.zeros(2, 3))
        hidden, cell = memory["hidden"], memory["cell"]
        for _ in range(4):
            given = torch.randn(2, 3)
            memory = unit(unit.given(given), memory)
            hidden, cell = judge(given, (hidden, cell))
    torch.testing.assert_close(memory["hidden"], hidden)
    torch.testing.assert_close(memory["cell"], cell)


def alternating(trials, frames, seed):
    """Every feature by itself: s(t+1) = -0.9 s(t-1) + e, in its stationary state.

    The present state alone says nothing of the next one, whose variance is 1 / (1 - 0.81) = 5.26;
    with the one before, the error is that of e, 1.
    """
    generator = np.random.default_rng(seed)
    states = np.empty((trials, frames, 3, 4))
    states[:, :2] = generator.standard_normal((trials, 2, 3, 4)) / np.sqrt(1 - 0.81)
    for frame in range(2, frames):
        noise = generator.standard_normal((trials, 3, 4))
        states[:, frame] = -0.9 * states[:, frame - 2] + noise
    return states


def test_it_remembers():
    baseline = LSTM()
    baseline.order, baseline.ahead = 8, 1
    baseline.epochs, baseline.learning_rate = 10, 1e-2
    baseline.fit_states(alternating(30, 100, 0), FPS, Training())
    test = alternating(20, 100, 2)
    error = ((baseline.one_step(test, FPS) - test)[:, 2:] ** 2).mean()
    # The noise of the test itself: 6 sd of a mean of 20 * 98 * 12 squares, 0.06; the best forecast
    # without memory has 5.26.
    assert 0.94 < error < 1.2
    # Five steps ahead the best forecast has 1 + 0.81 + 0.81 ** 2.
    path = baseline.predict(test[:, :-5], 5, FPS)
    far = ((path - test[:, -5:])[:, 4] ** 2).mean()
    assert far < 0.85 * 5.26
