"""A law of motion that is held while edges are learned."""

import numpy as np
import pytest

from swarmssm import inference, simulate
from swarmssm.errors import InputError
from swarmssm.inference import Fit, fixed_transition
from swarmssm.models.parameters import priors_of

OPTIONS = {"observed": "states"}


@pytest.fixture(scope="module")
def tracks():
    return simulate.simulate_boids(individuals=4, steps=40, trials=3, seed=0)


@pytest.fixture(scope="module")
def law(tracks):
    options = {"model_options": OPTIONS, "steps": 5, "graph": "radius:3"}
    return inference.fit("boids", tracks=tracks, **options)


def test_everything_but_the_edges_is_held(law, tracks, tmp_path):
    held = fixed_transition(law)
    assert set(held) == set(priors_of(law.model))
    drawn = law.parameters(1000, seed=0)
    for name, value in held.items():
        np.testing.assert_allclose(value, drawn[name].median("draw"))
    fit = inference.fit(
        "boids",
        tracks=tracks,
        model_options=OPTIONS,
        priors=held,
        edges="dynamic-relational",
        edge_options={"hidden": 4},
        window=10,
        steps=3,
        out=tmp_path / "run",
    )
    assert priors_of(fit.model) == []
    again = Fit.load(tmp_path / "run")
    for name, value in held.items():
        kept = dict(again.model.named_buffers())[name]
        np.testing.assert_allclose(kept, value, rtol=1e-6)
    told, same = (each.edge_probabilities(tracks) for each in (fit, again))
    np.testing.assert_array_equal(told, same)


def test_edges_that_are_learned_do_not_count(tracks, law):
    fit = inference.fit(
        "boids",
        tracks=tracks,
        model_options=OPTIONS,
        edges="relational",
        edge_options={"hidden": 4},
        window=10,
        steps=1,
    )
    assert set(fixed_transition(fit)) == set(fixed_transition(law))


@pytest.mark.parametrize(
    ("model", "options", "said"),
    [
        ("graph-vae", {}, "is no state-space model"),
        ("graph-ssm", OPTIONS, r"learned parameters without a prior \(transition"),
    ],
)
def test_networks_have_no_law_to_hold(tracks, model, options, said):
    fit = inference.fit(model, tracks=tracks, model_options=options, steps=1)
    with pytest.raises(InputError, match=said):
        fixed_transition(fit)
