"""Swarms whose future is known."""

import numpy as np
import pytest

from swarmssm.simulate import simulate_boids
from swarmssm.tracks import make_tracks

FPS = 10.0


def straight(num_times=200, individuals=3, trials=None):
    """Individuals on straight lines, each with its own constant velocity."""
    generator = np.random.default_rng(0)
    velocity = generator.normal(size=(individuals, 2))
    start = generator.normal(size=(individuals, 2))
    time = np.arange(num_times)[:, None, None] / FPS
    position = start + velocity * time
    steady = np.broadcast_to(velocity, position.shape)
    if trials is not None:
        position = np.stack([position + 3.0 * k for k in range(trials)])
        steady = np.stack([steady] * trials)
    return make_tracks(position, velocity=steady.copy(), fps=FPS)


@pytest.fixture(scope="session")
def noiseless():
    """Boids that move without any noise, five trials of 120 frames."""
    return simulate_boids(4, 120, 5, process_noise=0.0, seed=3)


@pytest.fixture(scope="session")
def flock():
    """Boids with the usual noise."""
    return simulate_boids(5, 150, 6, seed=2)
