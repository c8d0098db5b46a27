"""Relational edges as parts of a model: what they are told, their priors, how they go on."""

import math
from dataclasses import replace

import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.models import (
    DynamicRelationalEdges,
    InitialStates,
    KinematicTransition,
    LatentEdges,
    ObservedEdges,
    RelationalEdges,
    Scales,
    StateSpaceModel,
    StepInputs,
    SwarmBatch,
)
from swarmssm.models.edges import EdgeState
from swarmssm.models.edges.pair_features import PairFeatures
from swarmssm.models.edges.seen import seen_states
from swarmssm.models.presets import graph_ssm, kernel, with_edges
from swarmssm.models.transitions import LinearForceTransition, TypedKinematicTransition

KINDS = [RelationalEdges, DynamicRelationalEdges]


def scales(individuals=4):
    box = {"centre": (0.0, 0.0), "low": (-3.0, -3.0), "high": (3.0, 3.0)}
    return Scales(2, individuals, 0.1, **box, length=2.0, speed=1.0, slow=0.5, fast=1.5,
                  spacing=1.0, step=0.1, noise=0.0)  # fmt: skip


def windows(batch=2, times=6, individuals=4, seed=0, features=4):
    torch.manual_seed(seed)
    observed = torch.randn(batch, times, individuals, features)
    mask = torch.ones(batch, times, individuals, dtype=torch.bool)
    return SwarmBatch.of(observed, mask, torch.zeros(batch, times, individuals, individuals))


def springs(edges, **own):
    options = {"cohesion_gain": 1.0, "alignment_gain": 0.5, "damping": 0.1, "process_noise": 0.3}
    transition = LinearForceTransition(2, 0.1, **{**options, **own})
    return StateSpaceModel(InitialStates.for_scales(scales()), transition, None, edges)


def test_gaps_are_filled_with_the_last_sight_and_nothing_is_known_of_later_frames():
    positions = torch.tensor([0.0, 1.0, 9.0, 9.0, 7.0, 9.0]).view(1, 6, 1, 1).expand(-1, -1, -1, 2)
    mask = torch.tensor([False, True, False, False, True, False]).view(1, 6, 1)
    batch = SwarmBatch.of(positions.clone(), mask, torch.zeros(1, 6, 1, 1))
    seen = seen_states(batch, 2, 0.5)
    assert seen.states[0, :, 0, 0].tolist() == [1, 1, 1, 1, 7, 7]
    # From 1 to 7 in three frames of half a second.
    assert seen.states[0, :, 0, 2].tolist() == pytest.approx([0, 0, 0, 0, 4, 4])
    assert seen.present[0, :, 0].tolist() == [False, True, True, True, True, False]


def test_observations_that_show_no_positions_are_refused():
    with pytest.raises(InputError, match="3 features"):
        seen_states(windows(features=3), 2, 0.1)


@pytest.mark.parametrize("future", [False, True])
def test_features_of_pairs_are_the_same_turned_mirrored_and_moved(future):
    told = PairFeatures(scales(), future=future)
    torch.manual_seed(0)
    states = torch.randn(2, 5, 4, 4, dtype=torch.float64)
    found = told.of_window(states)
    assert found.shape == (2, 5, 4, 4, told.size)
    turn = torch.tensor([[0.6, -0.8], [-0.8, -0.6]], dtype=torch.float64)
    moved = torch.cat([states[..., :2] @ turn + 5.0, states[..., 2:] @ turn], -1)
    assert torch.allclose(told.of_window(moved), found, atol=1e-10)


def test_the_prior_of_fixed_types_by_hand():
    edges = RelationalEdges(scales(), 3, sparsity=0.8)
    batch = windows(individuals=3)
    value = torch.zeros(2, 1, 3, 3, 3)
    for place, (i, j) in enumerate([(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]):
        value[:, 0, i, j, place % 3] = 1.0
    expected = 2 * math.log(0.8) + 4 * math.log(0.1)
    assert edges.prior(batch).log_prob(value).tolist() == pytest.approx([expected] * 2)
    uniform = RelationalEdges(scales(), 3).prior(batch).log_prob(value)
    assert uniform.tolist() == pytest.approx([6 * math.log(1 / 3)] * 2)
    assert edges.names == ("none", "type 1", "type 2")


def test_a_held_prior_is_half_of_the_fixed_one_and_half_of_the_learned():
    free, held = (DynamicRelationalEdges(scales(), sparsity=0.9, held=h) for h in (0.0, 0.5))
    held.load_state_dict(free.state_dict())
    batch = windows()
    value = free.prior(batch).sample()
    learned = free.prior(batch).log_prob(value)
    fixed = (value * torch.tensor([0.9, 0.1]).log()).sum((1, 2, 3, 4))
    found = held.prior(batch).log_prob(value)
    assert torch.allclose(found, 0.5 * (learned + fixed), rtol=1e-4)


def test_one_type_that_is_an_edge_is_the_complete_graph():
    model = springs(RelationalEdges(scales(), 1, no_edge=False))
    complete = springs(LatentEdges("complete"))
    batch = windows()
    free = model.transition.path(batch.observations[:, 0], batch.observations[:, 1:, :, 2:])
    batch = replace(batch, observations=free)
    types = model.edges.prior(batch).sample()
    put = model.edges.with_edge_types(batch, types)
    assert torch.equal(put.adjacency, 1.0 - torch.eye(4).expand(2, 6, 4, 4))
    found = model.chain(put, {}).log_prob(batch.observations)
    assert torch.allclose(found, complete.chain(batch, {}).log_prob(batch.observations))


def test_strengths_weigh_types():
    edges = RelationalEdges(scales(), 4, strengths=True)
    with torch.no_grad():
        edges.log_strengths.copy_(torch.tensor([2.0, 0.5]).log())
    types = torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.5, 0, 0, 0.5]])
    assert edges.weights(types).tolist() == pytest.approx([0, 1, 2, 0.25])
    assert edges.interacting(types).tolist() == [0, 1, 1, 0.5]
    assert not RelationalEdges(scales(), 2, strengths=True).has_strengths


def test_a_learned_prior_knows_nothing_of_later_frames_and_goes_on_step_by_step():
    edges = DynamicRelationalEdges(scales(), 3).double()
    batch = windows()
    batch = replace(batch, observations=batch.observations.double())
    before = edges.prior(batch).log_p
    changed = batch.observations.clone()
    changed[:, 4:] += 1.0
    after = edges.prior(replace(batch, observations=changed)).log_p
    assert torch.equal(before[:, :4], after[:, :4])
    assert not torch.allclose(before[:, 4:], after[:, 4:])
    # Whoever goes on freely from the third frame is told the same.
    head = replace(batch, observations=batch.observations[:, :3], mask=batch.mask[:, :3],
                   present=batch.present[:, :3])  # fmt: skip
    known = edges.memory(head, edges.prior(head).mean)
    for frame in range(3, 6):
        logits, memory = edges.following(batch.observations[:, frame], batch.present[:, 0], known)
        assert torch.allclose(logits.log_softmax(-1), before[:, frame])
        known = EdgeState(known.types, memory)


def test_fixed_types_stay_in_a_free_run_and_changing_ones_are_drawn_anew():
    torch.manual_seed(0)
    model = springs(RelationalEdges(scales(), sparsity=0.5))
    drawn = model.simulate(20, 4, num_windows=3, seed=1)
    assert drawn.adjacency.shape == (3, 20, 4, 4)
    assert (drawn.adjacency == drawn.adjacency[:, :1]).all()
    assert set(drawn.adjacency.unique().tolist()) == {0.0, 1.0}
    dynamic = springs(DynamicRelationalEdges(scales(), sparsity=0.5))
    drawn = dynamic.simulate(20, 4, num_windows=3, seed=1)
    assert (drawn.adjacency != drawn.adjacency[:, :1]).any()
    # The graph is the one on which they moved.
    noise_free = springs(RelationalEdges(scales()), process_noise=1e-8)
    path = noise_free.simulate(5, 4, seed=2)
    moved = springs(ObservedEdges(), process_noise=1e-8).step(
        path.states[:, :-1], StepInputs(path.adjacency[:, :-1])
    )
    assert torch.allclose(moved.mean, path.states[:, 1:], atol=1e-5)


def test_who_comes_back_has_the_types_that_it_had():
    model = springs(RelationalEdges(scales(), sparsity=0.5))
    present = torch.ones(12, 4, dtype=torch.bool)
    present[4:8, 1] = False
    drawn = model.simulate(12, 4, present=present, seed=3)
    assert torch.equal(drawn.adjacency[:, 0], drawn.adjacency[:, -1])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"num_types": 1}, "at least 2"),
        ({"num_types": 0}, "num_types"),
        ({"sparsity": 1.5}, "sparsity"),
        ({"sparsity": 0.5, "no_edge": False}, "no_edge=true"),
        ({"temperature": 0.0}, "temperature"),
    ],
)
def test_options_out_of_range_are_refused(kind, options, words):
    with pytest.raises(InputError, match=words):
        kind(scales(), **options)


def test_edges_by_name():
    model = kernel(scales(), observed="states")
    assert with_edges(model, scales(), "relational", 3, {"sparsity": 0.7}) is model
    assert isinstance(model.transition, TypedKinematicTransition)
    assert isinstance(model.transition, KinematicTransition)
    assert model.edges.sparsity == 0.7
    # Of the second law what an individual does by itself is gone, with the priors.
    values = model.sample_globals()
    assert {n for n in values if n.startswith("transition.laws.1")} == {
        "transition.laws.1.attraction",
        "transition.laws.1.alignment",
    }
    common = with_edges(graph_ssm(scales()), scales(), "relational", 3, {"laws": "common"})
    assert common.edges.has_strengths
    assert not hasattr(common.transition, "laws")
    assert isinstance(with_edges(common, scales(), "radius:2").edges, LatentEdges)
    assert isinstance(with_edges(common, scales(), "observed").edges, ObservedEdges)


@pytest.mark.parametrize(
    ("name", "types", "options", "words"),
    [
        ("rational", None, {}, "'rational'"),
        ("radius:2", 3, {}, "no types"),
        ("observed", None, {"sparsity": 0.5}, "no types"),
        ("relational", 2, {"sparse": 0.5}, "sparse is no option.*sparsity"),
        ("relational", 2, {"held": 0.5}, "held is no option"),
        ("relational", 3, {"laws": "each"}, "laws"),
    ],
)
def test_names_and_options_that_are_none_are_refused(name, types, options, words):
    with pytest.raises(InputError, match=words):
        with_edges(kernel(scales()), scales(), name, types, options)


@pytest.mark.parametrize("kind", KINDS)
def test_edges_that_begin_near_fall_with_distance_by_the_slope(kind):
    edges = kind(scales(), near=3.0)
    encoder = edges.encoder()
    with torch.no_grad():
        head = encoder.head if kind is RelationalEdges else encoder.head[-1]
        head.weight.zero_()
        batch = windows()
        seen = edges.seen(batch)
        logits = encoder(seen)
    distance = encoder.features.of_window(seen.states)[..., 1]
    if kind is RelationalEdges:
        distance = distance.mean(1, keepdim=True)
    odds = logits[..., 1] - logits[..., 0]
    off = ~torch.eye(4, dtype=torch.bool)
    assert torch.allclose(odds[..., off], -3.0 * (distance - 2.0)[..., off], atol=1e-4)
    with pytest.raises(InputError, match="near"):
        kind(scales(), near=1.0, no_edge=False)
