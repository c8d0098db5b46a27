"""States at the end of a history, filtered at many draws of the parameters side by side."""

import pytest
import torch

from swarmssm.analysis.diagnostics.sbc.simulated import FixedModel, standard_scales
from swarmssm.inference.filtering.kalman import extended_kalman, last_filtered
from swarmssm.inference.guides import LinearizedGuide
from swarmssm.inference.guides.base import PathGuide
from swarmssm.models import StateSpaceModel, SwarmBatch

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


def test_what_a_filter_ends_with_is_the_end_of_the_whole(case):
    model, batch = case
    guide = LinearizedGuide(model)
    with torch.no_grad():
        (values,) = drawn_values(guide, 1)
        whole = extended_kalman(model, batch, values)
        mean, covariance = last_filtered(model, batch, values)
    assert torch.equal(mean, whole.mean[:, -1])
    assert torch.equal(covariance, whole.covariance[:, -1])


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
