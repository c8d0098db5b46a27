"""What a report says of a model is so."""

import pytest

from swarmssm import inference, simulate
from swarmssm.analysis.report.metadata import model_metadata


@pytest.mark.parametrize(
    ("model", "options", "told"),
    [
        ("graph-vae", {}, None),
        ("linear", {"observed": "states"}, "states, taken to be exact"),
        ("linear", {}, "positions, with tracking noise"),
    ],
)
def test_how_the_states_are_seen(model, options, told):
    tracks = simulate.simulate_boids(3, 12, 3, seed=0)
    guide = "auto" if options or model == "graph-vae" else "markov"
    fit = inference.fit(model, tracks, guide=guide, model_options=options, steps=1, window=4)
    assert dict(model_metadata(fit)).get("observations") == told
