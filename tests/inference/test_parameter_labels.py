"""Names, dimensions and units of parameters."""

import numpy as np
import pyro.distributions as dist
import torch

from swarmssm.inference.parameter_labels import labelled_parameters, short_names
from swarmssm.models import InitialStates, PositionEmission, StateSpaceModel
from swarmssm.models.parameters import priors_of
from swarmssm.models.transitions import BoidsTransition


def boids(individuals):
    """Return boids with gains of their own, walls with two sides, and two noises."""
    wide = dist.LogNormal(torch.zeros(individuals), torch.ones(individuals)).to_event(1)
    sides = dist.LogNormal(torch.zeros(2), torch.ones(2)).to_event(1)
    one = dist.LogNormal(torch.tensor(0.0), torch.tensor(1.0))
    transition = BoidsTransition(
        2,
        0.1,
        cohesion_gain=wide,
        separation_gain=1.0,
        alignment_gain=one,
        process_noise=one,
        wall_gain=1.0,
        half_width=sides,
    )
    initial = InitialStates(torch.zeros(4), torch.ones(4))
    return StateSpaceModel(initial, transition, PositionEmission(2, one))


def test_names_are_as_short_as_they_may_be():
    found = short_names(["transition.noise", "emission.noise", "transition.damping"])
    assert list(found.values()) == ["transition.noise", "emission.noise", "damping"]


def test_dimensions_are_of_individuals_and_axes():
    model = boids(3)
    generator = np.random.default_rng(0)
    shapes = {"transition.cohesion_gain": (3,), "transition.half_width": (2,)}
    values = {name: generator.normal(size=(5, *shapes.get(name, ()))) for name in priors_of(model)}
    found = labelled_parameters(model, values, ["a", "b", "c"], ["x", "y"], "cm")
    assert found["cohesion_gain"].dims == ("chain", "draw", "individual")
    assert found["half_width"].dims == ("chain", "draw", "space")
    assert found["noise"].dims == ("chain", "draw")
    assert list(found["individual"].values) == ["a", "b", "c"]
    assert found["half_width"].attrs["units"] == "cm"
    assert found["noise"].attrs["full_name"] == "emission.noise"
    np.testing.assert_array_equal(
        found["cohesion_gain"].sel(individual="b")[0], values["transition.cohesion_gain"][:, 1]
    )


def test_two_individuals_are_not_taken_for_two_axes():
    model = boids(2)
    values = {name: np.zeros((5, 2)) for name in ("transition.cohesion_gain",)}
    found = labelled_parameters(model, values, ["a", "b"], ["x", "y"], "")
    assert found["cohesion_gain"].dims == ("chain", "draw", "individual")
