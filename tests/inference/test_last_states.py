"""States at the end of a history, filtered at many draws of the parameters side by side."""

from dataclasses import replace

import pytest
import torch

from swarmssm.analysis.diagnostics.sbc.simulated import FixedModel, standard_scales
from swarmssm.inference import fit
from swarmssm.inference.filtering.kalman_filter import extended_kalman, filtered_at
from swarmssm.inference.guides import LinearizedGuide
from swarmssm.inference.guides.base import PathGuide
from swarmssm.inference.prediction.state_space import _stretches
from swarmssm.models import StateSpaceModel, SwarmBatch
from swarmssm.simulate import simulate_boids

OPTIONS = {"walls": False, "limits": False, "relaxation": True, "noise": "additive"}


@pytest.fixture(scope="module", params=["observed", "radius:1.5"])
def case(request) -> tuple[StateSpaceModel, SwarmBatch]:
    """Three windows of four boids, one of which comes late and one of which leaves."""
    options = OPTIONS if request.param == "observed" else {**OPTIONS, "edges": request.param}
    fixed = FixedModel("boids", standard_scales(4), options, {}, 0.3)
    model = fixed()
    drawn = fixed().simulate(12, 4, num_windows=3, seed=0, graph=None)
    present = drawn.present.clone()
    present[0, :5, 1] = False
    present[1, 8:, 2] = False
    mask = present.clone()
    mask[2, 3:6] = False
    observations = drawn.observations * mask.unsqueeze(-1)
    graph = (present.unsqueeze(-1) & present.unsqueeze(-2)).to(observations.dtype)
    graph = graph * (1.0 - torch.eye(4))
    weight = torch.ones(3)
    return model, SwarmBatch(observations, mask, graph, weight, 3, present, None)


def drawn_values(guide, count):
    torch.manual_seed(1)
    return [guide.parameters_guide() for _ in range(count)]


def test_states_at_some_frames_are_those_of_the_whole_filter(case):
    model, batch = case
    guide = LinearizedGuide(model)
    with torch.no_grad():
        (values,) = drawn_values(guide, 1)
        whole = extended_kalman(model, batch, values)
        windows, frames = torch.tensor([2, 0, 1, 2]), torch.tensor([11, 4, 11, 4])
        mean, covariance = filtered_at(model, batch, values, windows, frames)
    assert torch.equal(mean, whole.mean[windows, frames])
    assert torch.equal(covariance, whole.covariance[windows, frames])


def test_many_draws_at_once_are_those_one_after_the_other(case):
    model, batch = case
    guide = LinearizedGuide(model)
    with torch.no_grad():
        values = drawn_values(guide, 7)
        torch.manual_seed(2)
        at_once = guide.last_states(batch, values)
        torch.manual_seed(2)
        one_by_one = PathGuide.last_states(guide, batch, values)
    assert at_once.shape == (7, 3, 4, 4)
    torch.testing.assert_close(at_once, one_by_one, rtol=1e-5, atol=1e-5)
    # Draws of the parameters matter: the states are not all the same but for noise.
    assert at_once.std(0)[0, 0].min() > 0


def test_a_transition_that_looks_at_its_numbers_is_filtered_draw_by_draw(case, monkeypatch):
    model, batch = case
    guide = LinearizedGuide(model)
    plain = model.transition.linearize

    def looking(states, inputs, covariance=None):
        assert float(states.abs().sum()) >= 0.0
        return plain(states, inputs, covariance)

    with torch.no_grad():
        values = drawn_values(guide, 3)
        torch.manual_seed(2)
        expected = guide.last_states(batch, values)
        monkeypatch.setattr(model.transition, "linearize", looking)
        torch.manual_seed(2)
        found = guide.last_states(batch, values)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)


def test_stretches_hold_every_frame_with_its_history():
    trials = torch.tensor([1, 0, 0, 1, 0, 0])
    rows = torch.tensor([9, 30, 2, 3, 4, 37])
    (which, starts), windows, frames, length = _stretches(trials, rows, window=6)
    # Trial 0: 2 and 4, then 30, then 37; trial 1: 3, then 9, which is 6 frames later.
    assert which.tolist() == [0, 0, 0, 1, 1]
    assert length == 6 + 2
    assert torch.equal(which[windows], trials)
    assert torch.equal(starts[windows] + frames, rows)
    assert frames.min() >= 5
    assert frames.max() < length


def test_a_trial_filtered_once_gives_what_each_history_gives():
    tracks = simulate_boids(4, steps=40, observation_noise=0.02, seed=3)
    done = fit("boids", tracks, steps=3, model_options=OPTIONS, graph="radius:2")
    predictor = replace(done.predictor(), window=40)
    prepared = done.prepare(tracks)
    rows = torch.tensor([39, 8, 21, 9])
    trials = torch.zeros(4, dtype=torch.long)
    together = predictor.begin(prepared, trials, rows, 0)
    for place in range(4):
        alone = predictor.begin(prepared, trials[:1], rows[place : place + 1], 0)
        # Both filter from the first frame, in single precision.
        torch.testing.assert_close(together.states[place], alone.states[0], rtol=1e-4, atol=1e-5)
