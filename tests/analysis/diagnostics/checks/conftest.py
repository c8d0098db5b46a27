"""A flock whose model is known, and no fit was needed for it."""

import pandas as pd
import pytest
import torch
import xarray as xr

from swarmssm.analysis.diagnostics.sbc.simulated import (
    FixedModel,
    SimulatedData,
    standard_scales,
)
from swarmssm.inference import Fit
from swarmssm.inference.data import preparation_for
from swarmssm.inference.run_folder import Builders, build_modules
from swarmssm.inference.settings import settings_from
from swarmssm.tracks.splits import split

NOISE = 0.03


@pytest.fixture(scope="session")
def flock() -> tuple[Fit, xr.Dataset]:
    """Five boids over 40 frames, seen with noise of 0.03, and the model that made them."""
    torch.set_num_threads(1)
    options = {"walls": False, "limits": False, "relaxation": True, "noise": "additive"}
    priors = {
        "initial.mean": [0.0, 0.0, 1.0, 0.0],
        "initial.scale": [1.2, 1.2, 0.3, 0.3],
        "preferred_speed": 1.0,
        "cohesion_gain": 0.6,
        "separation_gain": 0.15,
        "alignment_gain": 0.8,
        "relaxation_gain": 0.5,
        "process_noise": 0.15,
        "emission.noise": NOISE,
    }
    model = FixedModel(
        "boids", standard_scales(5), {**options, "edges": "radius:2.0", "priors": priors}
    )
    tracks, _, _ = SimulatedData(model, 40, 5, 1).draw(3)
    settings, own, guide = build_modules(
        settings_from({"model": "boids", "guide": "linearized"}),
        model.scales,
        Builders(model=model),
    )
    preparation, _ = preparation_for(
        tracks, scaler="none", graph="complete", velocity="auto", observes=own.observes
    )
    whole = split(tracks, "time", (1.0, 0.0, 0.0), 0)
    fit = Fit(own.eval(), guide.eval(), settings, model.scales, preparation, whole, pd.DataFrame())
    return fit, tracks
