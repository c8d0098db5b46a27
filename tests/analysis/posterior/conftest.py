"""Swarms on springs: linear and Gaussian, so that a Kalman filter of somebody else's can judge."""

from collections.abc import Callable
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

FPS, SPACE = 5.0, 2
TRUTH = {"cohesion_gain": 0.8, "alignment_gain": 0.5, "damping": 0.3, "process_noise": 0.4}
TRACKING = 0.1


def springs(**options: Any) -> StateSpaceModel:
    """Return the law with chosen parameters in place of the true ones."""
    return StateSpaceModel(
        InitialStates(torch.tensor([0.0, 0.0, 0.1, 0.0]), torch.tensor([1.5, 1.0, 0.5, 0.5])),
        LinearForceTransition(SPACE, 1.0 / FPS, **{**TRUTH, **options}),
        PositionEmission(SPACE, TRACKING),
    )


def two_unknown(scales: Scales) -> StateSpaceModel:
    """Return the law with alignment and noise to be inferred."""
    return springs(
        alignment_gain=dist.Normal(torch.tensor(0.0), torch.tensor(2.0)),
        process_noise=dist.LogNormal(torch.tensor(-1.0), torch.tensor(1.0)),
    )


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


@pytest.fixture(scope="session")
def swarms() -> Callable[..., xr.Dataset]:
    """Simulate swarms on springs."""
    return simulated


@pytest.fixture(scope="session")
def law() -> Callable[..., StateSpaceModel]:
    """Return the law with given parameters, all of them fixed."""
    return springs


@pytest.fixture(scope="session")
def ten_trials() -> xr.Dataset:
    """Three individuals in ten trials of 14 frames."""
    return simulated(10, 14, 3, seed=2)


@pytest.fixture(scope="session")
def springs_fit(ten_trials: xr.Dataset) -> Fit:
    """A fit of two parameters to all of the ten trials, every frame counting."""
    torch.set_num_threads(1)
    return fit(
        two_unknown,
        ten_trials,
        guide="linearized",
        guide_options={"given": 0},
        window=None,
        fractions=(1.0, 0.0, 0.0),
        seed=0,
    )


def with_gaps(tracks: xr.Dataset) -> xr.Dataset:
    """Hide one for four frames, let one come late, one leave early, and nobody be seen once."""
    tracks = tracks.copy(deep=True)
    position = (
        tracks["position"].transpose("trial", "time", "individual", "space").to_numpy().copy()
    )
    position[0, 3:7, 1] = np.nan
    position[0, :4, 2] = np.nan
    position[-1, 9:, 0] = np.nan
    position[-1, 6] = np.nan
    graph = tracks["adjacency"].to_numpy()
    return make_tracks(position, fps=FPS, adjacency=graph, unit="cm")


@pytest.fixture(scope="session")
def gappy(ten_trials: xr.Dataset) -> xr.Dataset:
    """The ten trials with gaps of every kind."""
    return with_gaps(ten_trials)
