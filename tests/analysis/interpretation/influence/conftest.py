"""Fits whose law is known: nothing is trained, and states are taken as exactly observed."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd
import pyro
import pytest
import xarray as xr

from swarmssm.inference import Fit
from swarmssm.inference.data import preparation_for
from swarmssm.inference.guides import ParameterGuide
from swarmssm.inference.settings import FitSettings
from swarmssm.models import InitialStates, StateSpaceModel, scales_of
from swarmssm.models.transitions import KernelTransition, KinematicTransition, PowerBasis
from swarmssm.tracks import make_tracks
from swarmssm.tracks.splits import Split


def known_fit(
    tracks: xr.Dataset, transition: KinematicTransition, *, scaler: str = "none", edges: Any = None
) -> Fit:
    """Return a fit of a law with known parameters."""
    scales = scales_of(tracks)
    model = StateSpaceModel(InitialStates.for_scales(scales), transition, None, edges).double()
    preparation, _ = preparation_for(
        tracks, scaler=scaler, graph="auto", velocity="auto", observes="states"
    )
    guide = ParameterGuide.for_model(model)
    settings = FitSettings(model="boids", guide="parameters")
    return Fit(model, guide, settings, scales, preparation, Split([], [], []), pd.DataFrame(), {})


def kernels(**options: Any) -> KernelTransition:
    """Return kernels of the boids law, f = 0.5 r, q = -0.3 / r, g = 0.2."""
    chosen: dict[str, Any] = {
        "basis": PowerBasis((1.0, -1.0, 0.0)),
        "attraction": [0.5, 0.0, 0.0],
        "repulsion": [0.0, -0.3, 0.0],
        "alignment": [0.0, 0.0, 0.2],
        "process_noise": 1e-9,
    }
    return KernelTransition(2, 0.1, **{**chosen, **options})


def complete_tracks(position: Any, velocity: Any) -> xr.Dataset:
    """Return tracks ``(time, individual, space)`` in which all see all."""
    position = np.asarray(position, float)
    times, number = position.shape[:2]
    graph = np.broadcast_to(1 - np.eye(number), (times, number, number))
    return make_tracks(position, velocity=velocity, adjacency=graph, fps=10.0, unit="cm")


@pytest.fixture(autouse=True)
def own_parameters() -> Iterator[None]:
    """Let each guide keep its own parameters, as in a fit."""
    with pyro.settings.context(module_local_params=True):
        yield


@pytest.fixture
def make_fit() -> Callable[..., Fit]:
    """Return a function that makes a fit of known parameters."""
    return known_fit


@pytest.fixture
def make_kernels() -> Callable[..., KernelTransition]:
    """Return a function that makes a kernel transition of the boids law."""
    return kernels


@pytest.fixture
def tracks() -> xr.Dataset:
    """Four individuals at random in three frames."""
    rng = np.random.default_rng(0)
    return complete_tracks(rng.normal(size=(3, 4, 2)), rng.normal(size=(3, 4, 2)))


@pytest.fixture
def pair() -> xr.Dataset:
    """Two, 2 apart, in two frames alike."""
    position = [[[0.0, 0.0], [2.0, 0.0]]] * 2
    velocity = np.array([[[1.0, 0.0], [0.0, 0.8]]] * 2)
    return complete_tracks(position, velocity)
