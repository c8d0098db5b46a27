"""Fits whose parameters are known: nothing is trained."""

from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest
import torch
import xarray as xr

from swarmssm import simulate
from swarmssm.analysis.posterior.accelerations import AccelerationModel
from swarmssm.inference import Fit
from swarmssm.inference.data import preparation_for
from swarmssm.inference.guides import ParameterGuide
from swarmssm.inference.settings import FitSettings
from swarmssm.models import InitialStates, StateSpaceModel, scales_of
from swarmssm.models.transitions import BoidsTransition, KinematicTransition
from swarmssm.tracks.splits import Split

#: Those that simulated boids have by default.
GAINS = {"cohesion_gain": 0.5, "separation_gain": 0.3, "alignment_gain": 0.2}
LIMITS = {"min_speed": 0.6, "max_speed": 1.2}
WALL = {"wall_gain": 1.0, "half_width": 4.0}


class Nameless(BoidsTransition):
    """Boids that tell nobody of what their acceleration is made."""

    @property
    def terms(self) -> tuple[str, ...]:
        """None."""
        return ()

    def __getattribute__(self, name: str) -> Any:
        if name == "kernels":
            raise AttributeError(name)
        return super().__getattribute__(name)


def law(kind: type[BoidsTransition] = BoidsTransition, **options: Any) -> BoidsTransition:
    """Return boids of the default gains, two-dimensional and nearly without noise."""
    chosen = {"space": 2, "dt": 0.1, "process_noise": 1e-9, **GAINS, **options}
    return kind(**chosen)


def known_fit(
    tracks: xr.Dataset, transition: KinematicTransition, *, edges: Any = None, graph: str = "auto"
) -> Fit:
    """Return a fit of a law with known parameters that takes tracks as exactly observed."""
    scales = scales_of(tracks)
    model = StateSpaceModel(InitialStates.for_scales(scales), transition, None, edges).double()
    preparation, _ = preparation_for(
        tracks, scaler="none", graph=graph, velocity="auto", observes="states"
    )
    guide = ParameterGuide.for_model(model)
    settings = FitSettings(model="boids", guide="parameters")
    return Fit(model, guide, settings, scales, preparation, Split([], [], []), pd.DataFrame(), {})


@pytest.fixture
def make_law() -> Callable[..., BoidsTransition]:
    """Return a function that makes a law of boids."""
    return law


@pytest.fixture
def make_fit() -> Callable[..., Fit]:
    """Return a function that makes a fit of known parameters."""
    return known_fit


@pytest.fixture
def nameless() -> type[BoidsTransition]:
    """A law of boids without named terms."""
    return Nameless


@pytest.fixture(scope="session")
def packed_boids() -> xr.Dataset:
    """Six boids in two trials of 80 frames, in a small box, without noise.

    A law without walls and limits of speed may be asked at their states all the same.
    """
    return simulate.simulate_boids(6, 80, 2, seed=1, half_width=1.5, process_noise=0.0)


def accelerations(motion: AccelerationModel, fit: Fit, tracks: xr.Dataset) -> torch.Tensor:
    """Return what a law expects at the tracks themselves, ``(trial, time, individual, space)``."""
    prepared = fit.prepare(tracks)
    with torch.no_grad():
        return motion.acceleration(
            torch.from_numpy(prepared.states), prepared.adjacency.double(), prepared.known
        )


@pytest.fixture
def expected() -> Callable[..., torch.Tensor]:
    """Return a function that asks a law for accelerations."""
    return accelerations
