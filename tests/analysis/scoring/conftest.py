"""Scores of a quick fit, and some with planted numbers."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import xarray as xr

from swarmssm.analysis.scoring import score

#: What is no method that was asked for.
REFERENCES = ("stay-put", "constant-velocity", "noise-floor")


@pytest.fixture(scope="session")
def scores(quick_fit, boids) -> xr.Dataset:
    """A model that learned nothing, the baselines and the law that made the tracks."""
    return score({"net": quick_fit}, boids, horizons=(1, 3, 5), origins=12, draws=60)


@pytest.fixture
def planted() -> Callable[..., xr.Dataset]:
    """Return a function that makes scores with given scores."""
    return plant


def plant(
    crps: dict[str, Any],
    *,
    trials: Sequence[str] | None = None,
    number: Any = 4,
    coverage: float = 0.9,
    horizons: Sequence[int] = (1, 5),
    every: int = 5,
    **attrs: Any,
) -> xr.Dataset:
    """Make scores: ``crps`` has for each model something that broadcasts to (origin, horizon).

    The log score is minus the CRPS, energy score and squared error twice it.
    """
    count = max(np.shape(np.atleast_1d(value))[0] for value in crps.values())
    trials = ["0"] * count if trials is None else list(trials)
    count = len(trials)
    shape = (count, len(horizons))
    values = np.stack([np.broadcast_to(np.asarray(v, float), shape) for v in crps.values()])
    over = ("model", "origin", "horizon")
    frames = np.concatenate(
        [np.arange(trials.count(name)) * every for name in dict.fromkeys(trials)]
    )
    unit = {"units": "cm", "long_name": ""}
    covered = np.full((*values.shape, 2), coverage)
    return xr.Dataset(
        {
            "log_score": (over, -values, {"units": "nat", "long_name": ""}),
            "crps": (over, values, unit),
            "energy_score": (over, 2 * values, unit),
            "mse": (over, 2 * values, {"units": "cm^2", "long_name": ""}),
            "coverage": ((*over, "level"), covered, {"units": "1", "long_name": ""}),
            "width": ((*over, "level"), covered, unit),
            "number": (over[1:], np.broadcast_to(number, shape).copy()),
            "trained_on": ("model", attrs.pop("trained_on", [0] * len(crps))),
        },
        {
            "model": list(crps),
            "title": ("model", list(crps)),
            "fitted": ("model", [name not in REFERENCES for name in crps]),
            "horizon": list(horizons),
            "ahead": ("horizon", np.asarray(horizons) / 10.0),
            "level": [0.5, 0.9],
            "trial": ("origin", trials),
            "frame": ("origin", frames),
            "time": ("origin", frames / 10.0),
        },
        {"unit": "cm", "fps": 10.0, "part": "test", "draws": 100, "notes": [], **attrs},
    )
