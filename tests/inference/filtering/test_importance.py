"""Weighed paths against exact evidences, and a particle filter where nothing is exact."""

import math

import pytest
import torch
from oracles.importance import weigh_paths
from oracles.iterated import iterated_smoother
from oracles.particles import bootstrap_particle_filter

from swarmssm.errors import InputError
from swarmssm.inference.filtering import extended_kalman
from swarmssm.models import StateSpaceModel

ABSENT = [(0, slice(0, 2), 2), (0, slice(5, None), 0)]


@pytest.mark.parametrize("kind", ["general", "kinematic"])
def test_all_paths_of_a_linear_model_weigh_the_same(kind, linear_swarm, windows):
    model, batch = linear_swarm(kind), windows(missing=[(1, 3, 1)], absent=ABSENT)
    exact = extended_kalman(model, batch, {})
    weighed = weigh_paths(model, batch, {}, exact, 5, seed=1)
    expected = exact.log_evidence.expand(5, -1)
    torch.testing.assert_close(weighed.log_weights, expected, rtol=1e-9, atol=0)
    torch.testing.assert_close(weighed.effective_size, torch.full((2,), 5.0).double())


def test_a_bent_swarm_has_the_evidence_of_the_particle_filter(bent_swarm, windows, observed):
    """Two estimates without bias."""
    model = bent_swarm(bend=0.5, curve=0.1, tracking=1.0)
    template = windows(batch=1, times=5, individuals=2, missing=[(0, 2, 0)])
    batch, _ = observed(model, template, seed=5)
    repeats, draws = 60, 2000
    copies = batch.select(torch.zeros(repeats, dtype=torch.long))
    cloud = bootstrap_particle_filter(model, copies, {}, 1000, seed=5)
    found = iterated_smoother(model, batch, {}, 4)
    weighed = weigh_paths(model, batch, {}, found.filtered, draws, seed=6)
    # In units of the weighed estimate; errors of both as the spread of what they are means of.
    particle = (cloud.log_evidence - weighed.log_evidence).exp()
    weights = (weighed.log_weights - weighed.log_evidence).exp()
    error = math.hypot(particle.std() / repeats**0.5, weights.std() / draws**0.5)
    assert error < 0.1
    assert abs(particle.mean() - 1) < 6 * error
    # A Gaussian about the smoothed path is a fair picture of the posterior, and its evidence
    # better than that of a filter that linearises as it goes.
    assert weighed.effective_size > draws / 4
    apart = (found.log_evidence - weighed.log_evidence).abs()
    assert apart < (extended_kalman(model, batch, {}).log_evidence - weighed.log_evidence).abs()


def test_transitions_without_density_are_refused(linear_swarm, windows):
    model, batch = linear_swarm("general"), windows()
    filtered = extended_kalman(model, batch, {})

    class Clamped(type(model.transition)):
        is_smooth = False

    model.transition.__class__ = Clamped
    with pytest.raises(InputError, match="cannot be weighed"):
        weigh_paths(model, batch, {}, filtered, 2)
    exact = StateSpaceModel(model.initial, model.transition, None)
    with pytest.raises(ValueError, match="no hidden paths"):
        weigh_paths(exact, batch, {}, filtered, 2)
