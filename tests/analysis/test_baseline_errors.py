"""How far off baselines are, and what of it comes out in an evaluation."""

import math

import numpy as np
import pytest

from swarmssm.analysis import evaluate
from swarmssm.analysis.scoring.references import ConstantVelocity, StayPut


def test_errors_of_a_baseline_in_a_random_walk_grow_as_they_must():
    """Positions take independent steps of sd 0.3: k steps ahead, staying put is off by 0.09 k."""
    generator = np.random.default_rng(0)
    position = generator.normal(scale=0.3, size=(3, 2000, 4, 2)).cumsum(1)
    states = np.concatenate([position, np.zeros_like(position)], -1)
    covariance = StayPut().error_covariances(states, 5, fps=10.0)
    assert covariance.shape == (5, 2, 2)
    for step in range(1, 6):
        variance = 0.09 * step
        # About 8000 errors, of which step neighbours share most of their steps.
        error = 6 * variance * math.sqrt(2 * step / 8000)
        np.testing.assert_allclose(np.diag(covariance[step - 1]), variance, atol=error)
        assert abs(covariance[step - 1][0, 1]) < error


def test_a_bias_counts_as_error():
    """Constant velocity of a circling body errs the same way in every frame of a short arc."""
    time = np.arange(40) / 10.0
    position = np.stack([time, 0.5 * time**2], -1)[None, :, None]
    velocity = np.stack([np.ones(40), time], -1)[None, :, None]
    states = np.concatenate([position, velocity], -1)
    covariance = ConstantVelocity().error_covariances(states, 3, fps=10.0)
    for step in range(1, 4):
        off = 0.5 * (0.1 * step) ** 2
        np.testing.assert_allclose(covariance[step - 1], [[0, 0], [0, off**2]], atol=1e-12)


def test_nothing_is_said_of_what_was_never_seen():
    states = np.full((1, 30, 2, 4), np.nan)
    states[0, :6] = 1.0
    covariance = StayPut().error_covariances(states, 10, fps=10.0)
    assert np.isnan(covariance[9]).all()
    assert np.isfinite(covariance[0]).all()


def test_in_an_evaluation(quick_fit, boids):
    """Nobody is more probable than the law that made the tracks, and noise adds up over steps."""
    evaluation = evaluate(quick_fit, boids, horizons=(1, 5, 10), free_run_steps=5, origins=12)
    scores = {str(row["model"].item()): row for row in evaluation.forecasts["log_score"]}
    assert all(np.isfinite(row.mean("origin")).all() for row in scores.values())
    assert float(scores["noise-floor"].mean()) > float(scores[evaluation.model].mean())
    straight = scores["constant-velocity"].mean("origin").to_numpy()
    assert straight[0] > straight[1] > straight[2]
    table = evaluation.to_dict()["methods"]["stay-put"]["horizons"]["1"]
    assert table["log_score"] == pytest.approx(evaluation.score("log_score", "stay-put", 1))
