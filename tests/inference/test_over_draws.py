"""Many draws of the parameters run side by side, and no otherwise than one after the other."""

import dataclasses

import pytest
import torch

from swarmssm.analysis.diagnostics.sbc.simulated import FixedModel, standard_scales
from swarmssm.graphs import GraphRule
from swarmssm.inference.guides import LinearizedGuide
from swarmssm.inference.prediction import over_draws, seeded
from swarmssm.inference.prediction.base import InitialCondition
from swarmssm.inference.prediction.over_draws import OverDraws, in_pieces
from swarmssm.inference.prediction.state_space import StateSpacePredictor
from swarmssm.tracks.scaling import Scaler

DRAWS, ORIGINS, BIRDS = 5, 3, 4
PLAIN = {"walls": False, "limits": False, "relaxation": True, "noise": "additive"}
LAWS = {
    "boids": ("boids", PLAIN),
    "limited": ("boids", PLAIN | {"limits": True}),
    "radius": ("boids", PLAIN | {"radius": 2.0}),
    "kernel": ("kernel", {"walls": False, "limits": False}),
    "linear": ("linear", {"homing": False}),
}
SCALER = Scaler("none", (0.0,) * 4, (1.0,) * 4)


def predictor_of(law):
    name, options = LAWS[law]
    model = FixedModel(name, standard_scales(BIRDS), options, {}, 0.3)()
    guide = LinearizedGuide(model)
    rule = GraphRule("radius", radius=2.0)
    return StateSpacePredictor(model, guide, SCALER, rule, 10)


def beginning_of(predictor, draws=DRAWS):
    """States of a small group, of which one is absent at one origin, and draws of parameters."""
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(draws, ORIGINS, BIRDS, 4, generator=generator)
    present = torch.ones(draws, ORIGINS, BIRDS, dtype=torch.bool)
    present[:, 1, 2] = False
    graph = (torch.ones(BIRDS, BIRDS) - torch.eye(BIRDS)).expand(draws, ORIGINS, BIRDS, BIRDS)
    with seeded(1):
        values = tuple(predictor.guide.parameters_guide() for _ in range(draws))
    return InitialCondition(states, graph, present, states, values)


@pytest.fixture(params=LAWS)
def predictor(request):
    return predictor_of(request.param)


def one_by_one(monkeypatch):
    """Let no draws be taken together."""
    begin = OverDraws.__init__

    def apart(own, function, parameters):
        begin(own, function, parameters)
        own.together = False

    monkeypatch.setattr(OverDraws, "__init__", apart)


def test_expected_paths_and_kernels_are_those_one_after_the_other(predictor, monkeypatch):
    start = beginning_of(predictor)
    together = predictor.run(start, 6, sample=False)
    with seeded(2):
        foreseen = predictor.kernels(start, 1)
    one_by_one(monkeypatch)
    apart = predictor.run(start, 6, sample=False)
    with seeded(2):
        expected = predictor.kernels(start, 1)
    close = {"rtol": 1e-4, "atol": 1e-5, "equal_nan": True}
    torch.testing.assert_close(together.states, apart.states, **close)
    assert torch.equal(together.adjacency, apart.adjacency)
    assert together.states[:, 1, :, 2].isnan().all()
    # Of a single step the kernels are those of the beginning: nothing was drawn before.
    torch.testing.assert_close(foreseen.location, expected.location, **close)
    torch.testing.assert_close(foreseen.variance, expected.variance, **close)
    assert foreseen.degrees == expected.degrees


def test_each_draw_and_each_step_has_noise_of_its_own(predictor):
    start = beginning_of(predictor)
    same = dataclasses.replace(
        start,
        states=start.states[:1].expand_as(start.states).contiguous(),
        parameters=(start.parameters[0],) * DRAWS,
    )
    with seeded(3):
        first = predictor.run(same, 2, sample=True).states
    with seeded(3):
        again = predictor.run(same, 2, sample=True).states
    assert torch.equal(first.nan_to_num(), again.nan_to_num())
    velocities = first[:, 0, 0, :, 2:]
    for draw in range(1, DRAWS):
        assert not torch.equal(velocities[0], velocities[draw])


def test_noise_is_as_large_as_the_parameters_say():
    """Velocities spread by process_noise * sqrt(dt) about what is expected."""
    predictor = predictor_of("boids")
    start = beginning_of(predictor, 400)
    name = "transition.process_noise"
    values = tuple({**own, name: torch.tensor(0.7)} for own in start.parameters)
    start = dataclasses.replace(start, parameters=values)
    with seeded(4):
        drawn = predictor.run(start, 1, sample=True).states[:, 0, 0, :, 2:]
    error = drawn - predictor.run(start, 1, sample=False).states[:, 0, 0, :, 2:]
    scale = 0.7 * predictor.model.transition.dt**0.5
    number = error.numel()
    assert abs(error.std().item() / scale - 1.0) < 5.0 / (2 * number) ** 0.5
    assert abs(error.mean().item()) < 5.0 * scale / number**0.5


def test_what_cannot_be_taken_together_is_taken_apart():
    def signed(values, numbers):
        # A course that depends on a number, which vmap cannot follow.
        return -values["a"] * numbers if bool(numbers.sum() < 0) else values["a"] * numbers

    parameters = tuple({"a": torch.tensor(float(k))} for k in (1, 2, 3))
    function = OverDraws(signed, parameters)
    found = function(torch.tensor([[1.0, 2.0], [-3.0, 1.0], [1.0, 1.0]]))
    assert found.tolist() == [[1.0, 2.0], [6.0, -2.0], [3.0, 3.0]]
    assert not function.together


def test_large_tensors_are_taken_in_pieces(monkeypatch):
    monkeypatch.setattr(over_draws, "NETWORK_CHUNK", 12)
    sizes = []

    def double(first, second):
        sizes.append(len(first))
        return 2 * first, (first.sum(-1) + second).reshape(-1)

    first, second = torch.arange(35.0).reshape(7, 5), torch.ones(7)
    found = in_pieces(double, [first, second])
    assert sizes == [2, 2, 2, 1]
    assert torch.equal(found[0], 2 * first)
    assert torch.equal(found[1], first.sum(-1) + 1)
