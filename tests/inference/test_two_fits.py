"""Two fits in one process have each its own parameters, whatever Pyro's store remembers."""

import copy

import numpy as np
import pyro
import pytest
import torch

from swarmssm.inference import fit
from swarmssm.simulate import simulate_boids


@pytest.fixture(autouse=True)
def empty_store():
    pyro.clear_param_store()
    yield
    pyro.clear_param_store()


@pytest.fixture(scope="module")
def tracks():
    return simulate_boids(4, 30, 2, observation_noise=0.03, seed=0)


def test_a_second_posterior_is_not_as_wide_as_the_first(tracks):
    first = fit(
        "boids",
        tracks,
        guide="linearized",
        window=30,
        steps=1,
        guide_options={"globals": "normal"},
        model_options={"walls": False, "limits": False},
        fractions=(1.0, 0.0, 0.0),
    )
    second = copy.deepcopy(first)
    auto = second.guide.parameters_guide.auto
    with torch.no_grad():
        for name, weight in auto.named_parameters():
            if "scales" in name:
                weight.add_(2.0)
    own = first.parameters(500)
    wider = second.parameters(500)
    for name in own.data_vars:
        # Log-normal both: of the same seed, so that only the scale is another.
        spread = np.log(own[name]).std(), np.log(wider[name]).std()
        assert spread[1] > 2.0 * spread[0]
    again = first.parameters(500)
    for name in own.data_vars:
        np.testing.assert_array_equal(again[name], own[name])
    assert len(list(pyro.get_param_store().keys())) == 0


def test_a_second_network_is_not_the_first(tracks):
    """Predictions, posteriors and free runs by its own weights, and none left in the store."""
    options = {"model_options": {"width": 8}, "window": 10, "steps": 1, "seed": 0}
    first = fit("graph-ssm", tracks, guide="markov", **options)
    second = copy.deepcopy(first)
    with torch.no_grad():
        for weight in (*second.model.parameters(), *second.guide.parameters()):
            weight.add_(0.1)

    def told(one):
        return [
            one.predictive(tracks)["position"].to_numpy(),
            one.posterior(tracks, draws=2)["mean"].to_numpy(),
            one.rollout(tracks, 3, draws=0)["position"].to_numpy(),
        ]

    expected = told(copy.deepcopy(first))
    others = told(second)
    for one, other, again in zip(expected, others, told(first), strict=True):
        np.testing.assert_array_equal(again, one)
        assert np.nanmax(np.abs(one - other)) > 1e-6
    assert len(list(pyro.get_param_store().keys())) == 0
