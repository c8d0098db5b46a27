"""Small analyses, and held-out scores whose differences are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.interpretation.analyze import analyze
from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.inference import Fit

MODELS = ("graph-vae", "boids", "constant-velocity", "noise-floor")
HORIZONS = (1, 2, 5)


def planted_scores(**differences: tuple[float, ...]) -> xr.Dataset:
    """Make log scores of 60 starts in two trials, those of the first model being -start - step.

    Each keyword gives by how much another model scores more at each horizon, for underscores read
    hyphens. Around that a difference varies by 0.1 from start to start, that of all being exact: 0
    lies in the middle of its interval, and 0.1 is 0.1 sqrt(60) / 0.1 = 7.7 standard errors off.
    """
    starts = np.arange(60.0)
    first = -starts[:, None] - np.asarray(HORIZONS, float)
    swing = np.random.default_rng(0).normal(0.0, 0.1, (60, 1))
    swing -= swing.mean()
    more = {name.replace("_", "-"): np.asarray(values) for name, values in differences.items()}
    names = [MODELS[0], *(name for name in MODELS[1:] if name in more)]
    values = [first, *(first + more[name] + swing for name in names[1:])]
    return xr.Dataset(
        {
            "log_score": (("model", "origin", "horizon"), np.stack(values), {"units": "nat"}),
            "crps": (("model", "origin", "horizon"), -np.stack(values), {"units": "cm"}),
            "coverage": (
                ("model", "origin", "horizon", "level"),
                np.full((len(values), 60, 3, 1), 0.9),
            ),
            "number": (("origin", "horizon"), np.full(first.shape, 5)),
            "trained_on": ("model", [0] * len(names)),
        },
        {
            "model": names,
            "title": ("model", [name.replace("t-v", "t v") for name in names]),
            "fitted": ("model", [name in MODELS[:2] for name in names]),
            "origin": np.arange(60),
            "level": [0.9],
            "horizon": list(HORIZONS),
            "ahead": ("horizon", 0.1 * np.asarray(HORIZONS)),
            "trial": ("origin", ["a"] * 30 + ["b"] * 30),
            "frame": ("origin", 5 * (np.arange(60) % 30)),
            "time": ("origin", 0.5 * (starts % 30)),
        },
        {"notes": ["The baselines are told nothing."]},
    )


@pytest.fixture
def scores() -> Callable[..., xr.Dataset]:
    """Return :func:`planted_scores`."""
    return planted_scores


@pytest.fixture(scope="package")
def flock(quick_fit: Fit, boids: xr.Dataset) -> Analysis:
    """An analysis of simulated boids but for the latents."""
    only = ["forces", "kernels", "force_maps", "influence"]
    return analyze(quick_fit, boids, draws=2, only=only, part="all", scores=False)


@pytest.fixture(scope="package")
def shoal(flock: Analysis) -> Analysis:
    """The same in centimetres, with scores, and with a factor of the direction in its kernels."""
    assert flock.kernels is not None
    assert flock.forces is not None
    assert flock.force_maps is not None
    assert flock.influence is not None
    angle = np.linspace(-np.pi, np.pi, 25)
    factor = 1.0 + 0.5 * np.cos(angle)
    kernels = flock.kernels.assign_coords(angle=angle)
    kernels["modulation"] = (("quantile", "angle"), np.stack([factor - 0.1, factor, factor + 0.1]))
    return replace(
        flock,
        forces=flock.forces.assign_attrs(unit="cm"),
        kernels=kernels.assign_attrs(unit="cm"),
        force_maps=flock.force_maps.assign_attrs(unit="cm"),
        influence=flock.influence.assign_attrs(unit="cm"),
        scores=planted_scores(boids=(-1.0, -1.0, -1.0), constant_velocity=(1.0, 0.0, -1.0)),
        notes=("Simulated.",),
    )


@pytest.fixture(scope="package")
def sparse(flock: Analysis) -> Analysis:
    """Forces alone, with a note that says why there are no maps."""
    return replace(
        flock,
        kernels=None,
        force_maps=None,
        influence=None,
        parameters=None,
        notes=("Left out: force maps. The tracks have three dimensions.",),
    )
