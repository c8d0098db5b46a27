"""The ready-made linear swarm: its priors, and its evidence at the truth."""

import math
from dataclasses import replace

import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.inference.filtering import extended_kalman
from swarmssm.models import LatentEdges, Scales, StateSpaceModel, SwarmBatch
from swarmssm.models.parameters import priors_of
from swarmssm.models.presets.linear_model import linear

DOUBLE = torch.float64
SCALES = Scales(
    space=2,
    individuals=4,
    dt=0.1,
    centre=(1.0, -1.0),
    low=(-3.0, -4.0),
    high=(4.0, 3.0),
    length=2.0,
    speed=1.0,
    slow=0.3,
    fast=2.0,
    spacing=0.5,
    step=0.2,
    noise=0.02,
)
TRUTH = {
    "transition.cohesion_gain": 0.8,
    "transition.alignment_gain": 0.6,
    "transition.damping": 0.3,
    "transition.process_noise": 0.5,
    "transition.homing_gain": 0.4,
    "emission.noise": 0.05,
}


def test_named_parameters_have_priors_in_the_units_of_the_tracks():
    model = linear(SCALES)
    assert isinstance(model, StateSpaceModel)
    assert sorted(priors_of(model)) == sorted(TRUTH)
    # Of the speed, 1, tracking noise explains 2 * 2 * (0.02 / 0.1)^2 = 0.16 in the square.
    speed = math.sqrt(0.84)
    priors = {**model.transition._pyro_samples, **model.emission._pyro_samples}
    assert float(priors["cohesion_gain"].scale) == pytest.approx(3 * 0.84 / 0.25)
    assert float(priors["alignment_gain"].scale) == pytest.approx(3 * speed / 0.5)
    medians = {
        "damping": speed / 2,
        "homing_gain": 0.84 / 4,
        "process_noise": 0.3 * speed * math.sqrt(speed / 2),
        "noise": 0.02,
    }
    for name, median in medians.items():
        assert float(priors[name].loc) == pytest.approx(math.log(median))
    assert model.transition.home.tolist() == [1.0, -1.0]
    assert model.observes == "positions"


def test_tracks_without_noise_or_movement_have_priors_too():
    quiet = linear(replace(SCALES, noise=0.0))
    median = quiet.emission._pyro_samples["noise"].loc.exp()
    assert float(median) == pytest.approx(0.1 * 1.0 * 0.1)
    still = linear(replace(SCALES, speed=0.0, length=0.0, spacing=0.0, noise=0.0))
    values = still.sample_globals()
    assert all(bool(torch.isfinite(value)) for value in values.values())


def test_options_change_the_model():
    free = linear(SCALES, homing=False)
    assert "transition.homing_gain" not in priors_of(free)
    assert float(free.transition.homing_gain) == 0
    exact = linear(SCALES, observed="states")
    assert exact.emission.is_exact
    assert isinstance(linear(SCALES, edges="radius:1.5").edges, LatentEdges)
    with pytest.raises(InputError, match="observed: it must be 'positions' or 'states'"):
        linear(SCALES, observed="velocities")


def test_the_evidence_has_no_slope_at_the_truth_on_average():
    """The score of data drawn from the model itself has mean 0, in each parameter."""
    model = linear(SCALES).double()
    windows, times = 60, 25
    truth = {name: torch.tensor(value, dtype=DOUBLE) for name, value in TRUTH.items()}
    mask = torch.ones(windows, times, SCALES.individuals, dtype=torch.bool)
    mask[::3, 10:13, 1] = False
    graph = (torch.rand(windows, times, 4, 4, dtype=DOUBLE) < 0.6) & ~torch.eye(4).bool()
    empty = torch.zeros(windows, times, SCALES.individuals, 2, dtype=DOUBLE)
    batch = SwarmBatch.of(empty, mask, graph.to(DOUBLE))
    with torch.no_grad():
        paths = model.chain(batch, truth).sample()
        seen = paths[..., :2] + truth["emission.noise"] * torch.randn_like(empty)
    batch = replace(batch, observations=seen * mask.unsqueeze(-1))
    # One value for each window: its slope is that of the window.
    each = {}
    for name, value in truth.items():
        shape = (windows, 1, 1) if name == "emission.noise" else (windows, 1)
        each[name] = value.expand(shape).clone().requires_grad_()
    total = extended_kalman(model, batch, each).log_evidence.sum()
    for slope in torch.autograd.grad(total, list(each.values())):
        score = slope.flatten()
        assert abs(score.mean()) < 6 * score.std() / math.sqrt(windows)
        # Data without information would have no slope anywhere.
        assert score.std() > 0.1
