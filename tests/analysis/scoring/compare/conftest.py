"""Swarms on springs, and fits that differ by a force."""

from typing import Any

import numpy as np
import pyro.distributions as dist
import pytest
import torch
import xarray as xr

from swarmssm.inference import Fit, fit
from swarmssm.models import InitialStates, PositionEmission, Scales, StateSpaceModel
from swarmssm.models.transitions import LinearForceTransition
from swarmssm.tracks import make_tracks

FPS = 5.0


def springs(**options: Any) -> StateSpaceModel:
    """Return a law of which chosen parameters are others."""
    law = {"cohesion_gain": 0.8, "alignment_gain": 1.5, "damping": 0.3, "process_noise": 0.4}
    return StateSpaceModel(
        InitialStates(torch.tensor([0.0, 0.0, 0.1, 0.0]), torch.tensor([1.5, 1.0, 0.5, 0.5])),
        LinearForceTransition(2, 1.0 / FPS, **{**law, **options}),
        PositionEmission(2, 0.1),
    )


def aligned(scales: Scales) -> StateSpaceModel:
    """Return the law with alignment and noise to be inferred."""
    return springs(
        alignment_gain=dist.Normal(torch.tensor(0.0), torch.tensor(2.0)), process_noise=noise()
    )


def alone(scales: Scales) -> StateSpaceModel:
    """Return the law without any force between individuals; noise is inferred."""
    return springs(alignment_gain=0.0, cohesion_gain=0.0, process_noise=noise())


def noise() -> dist.LogNormal:
    """Return the prior of the noise."""
    return dist.LogNormal(torch.tensor(-1.0), torch.tensor(1.0))


def simulated(trials: int, frames: int, individuals: int, seed: int) -> xr.Dataset:
    """Return tracks of swarms in which everybody sees everybody."""
    graph = (1.0 - torch.eye(individuals)).expand(trials, frames, -1, -1)
    drawn = springs().simulate(frames, individuals, num_windows=trials, graph=graph, seed=seed)
    return make_tracks(
        drawn.observations.numpy().astype(np.float64),
        fps=FPS,
        adjacency=graph.numpy().astype(np.uint8),
        unit="cm",
    )


def fitted(model: Any, tracks: xr.Dataset, **settings: Any) -> Fit:
    """Fit with the paths summed out, every frame counting."""
    torch.set_num_threads(1)
    options = {"guide_options": {"given": 0}, "window": None, "seed": 0}
    return fit(model, tracks, guide="linearized", **{**options, **settings})


@pytest.fixture(scope="session")
def flocks() -> xr.Dataset:
    """Three individuals in twelve trials of 16 frames."""
    return simulated(12, 16, 3, seed=4)


@pytest.fixture(scope="session")
def whole_fits(flocks: xr.Dataset) -> dict[str, Fit]:
    """Fits to all of the trials."""
    return {
        name: fitted(model, flocks, fractions=(1.0, 0.0, 0.0))
        for name, model in (("aligned", aligned), ("alone", alone))
    }


@pytest.fixture(scope="session")
def flock() -> xr.Dataset:
    """Three individuals in one trial of 90 frames."""
    return simulated(1, 90, 3, seed=5)


@pytest.fixture(scope="session")
def timed_fits(flock: xr.Dataset) -> dict[str, Fit]:
    """Fits to the first half of it."""
    settings = {"split_by": "time", "fractions": (0.5, 0.0, 0.5)}
    return {
        name: fitted(model, flock, **settings)
        for name, model in (("aligned", aligned), ("alone", alone))
    }
