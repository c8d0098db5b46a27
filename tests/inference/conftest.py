"""A small swarm, and a model that was fitted to it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr

from swarmssm.inference import Fit, fit
from swarmssm.simulate import simulate_boids
from swarmssm.tracks import make_tracks

#: Enough for a test of what stays the same, whatever was learned.
BRIEF: dict[str, Any] = {"epochs": 3, "window": 20, "batch_windows": 4, "seed": 3}


@pytest.fixture(scope="session")
def brief() -> dict[str, Any]:
    """Settings of a fit that takes about a second."""
    return BRIEF


@pytest.fixture(scope="session")
def swarm() -> xr.Dataset:
    """Four boids in two trials of 100 frames, with velocities and the graph of a radius."""
    return simulate_boids(individuals=4, steps=100, trials=2, seed=0)


@pytest.fixture(scope="session")
def fitted(swarm: xr.Dataset) -> Fit:
    """Return a model that has hardly learned anything."""
    return fit(tracks=swarm, **BRIEF)


@pytest.fixture(scope="session")
def with_gaps(swarm: xr.Dataset) -> xr.Dataset:
    """The swarm with gaps: one individual is never seen in the first trial, others now and then.

    It has neither velocities nor a graph, so that both have to be made.
    """
    position = swarm["position"].transpose("trial", "time", "individual", "space").to_numpy().copy()
    hidden = np.random.default_rng(1).random(position.shape[:3]) < 0.1
    hidden[0, :, 2] = True
    hidden[1, 60:, :] = True
    position[hidden] = np.nan
    return make_tracks(position, fps=swarm.attrs["fps"])


@pytest.fixture(scope="session")
def weights_of() -> Callable[[Fit], dict[str, torch.Tensor]]:
    """Return a function that gives all weights of a fit by name."""

    def weights(fitted: Fit) -> dict[str, torch.Tensor]:
        parts = (("model", fitted.model), ("guide", fitted.guide))
        return {f"{p}.{n}": v for p, module in parts for n, v in module.state_dict().items()}

    return weights
