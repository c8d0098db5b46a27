"""Hold the Markov guide against swarms whose posterior is known."""

import math
from dataclasses import replace

import pyro.distributions as dist
import pytest
import torch
from pyro.infer import Trace_ELBO

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, neighbor_mean
from swarmssm.inference.guides import MarkovGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    KinematicTransition,
    LinearTransition,
    NeuralEmission,
    PositionEmission,
    StateEmission,
    StateSpaceModel,
    SwarmBatch,
    Transition,
)

# The dense Gaussian differentiates forwards, for which torch compiles a part of itself.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.torch.jit.script. is deprecated:DeprecationWarning"
)

DOUBLE = torch.float64
BATCH, TIMES, INDIVIDUALS = 3, 12, 4


def tensor(*values):
    return torch.tensor(values, dtype=DOUBLE)


class Flight(KinematicTransition):
    """Bodies with friction, which turn with their neighbours and are drawn to them."""

    def __init__(self, friction=0.0, align=0.0, cohesion=0.0, dt=0.1):
        super().__init__(2, dt)
        self.friction, self.align, self.cohesion = friction, align, cohesion

    def velocity(self, positions, velocities, inputs):
        change = -self.friction * velocities
        if self.align or self.cohesion:
            mean_p, sees = neighbor_mean(positions, inputs.adjacency)
            mean_v, _ = neighbor_mean(velocities, inputs.adjacency)
            pull = self.align * (mean_v - velocities) + self.cohesion * (mean_p - positions)
            change = change + torch.where(sees, pull, 0.0)
        if inputs.controls is not None:
            change = change + inputs.controls.unsqueeze(-2)
        mean = velocities + self.dt * change
        return dist.Normal(mean, torch.full_like(mean, 0.1)).to_event(1)


def start(dtype=DOUBLE):
    return InitialStates(
        torch.tensor([1.0, 0.0, 0.2, 0.0], dtype=dtype),
        torch.tensor([1.0, 1.0, 0.5, 0.5], dtype=dtype),
    )


def flying(**options):
    return StateSpaceModel(start(), Flight(**options), PositionEmission(2, tensor(0.05, 0.08)))


def linear(coupling=0.0, emission=None):
    matrix = torch.eye(4, dtype=DOUBLE)
    matrix[0, 2] = matrix[1, 3] = 0.2
    matrix[2, 0] = matrix[3, 1] = -0.1
    matrix[2, 3], matrix[3, 2] = 0.3, -0.3
    root = torch.diag(tensor(0.04, 0.04, 0.1, 0.1))
    root[2, 0] = root[3, 1] = 0.05
    pull = coupling * torch.eye(4, dtype=DOUBLE)
    pull[2, 0] = pull[3, 1] = 0.5 * coupling
    law = LinearTransition(4, matrix, root, coupling=pull, offset=tensor(0.1, 0.0, 0.0, -0.1))
    emission = emission or StateEmission(2, 0.1, 0.2)
    return StateSpaceModel(start(), law.double(), emission.double())


def drawn(model, mask=None, seed=0, times=TIMES, controls=None):
    """Draw a swarm from a model, in which individuals are seen where the mask says."""
    torch.manual_seed(seed)
    shape = (BATCH, times, INDIVIDUALS)
    mask = torch.ones(shape, dtype=torch.bool) if mask is None else mask
    seen = (torch.rand(*shape, INDIVIDUALS) < 0.6).to(DOUBLE)
    seen = seen * (1 - torch.eye(INDIVIDUALS, dtype=DOUBLE))
    seen = seen * mask.unsqueeze(-1) * mask.unsqueeze(-2)
    width = 2 if model.observes == "positions" else 4
    batch = SwarmBatch.of(torch.zeros(*shape, width, dtype=DOUBLE), mask, seen, controls)
    with torch.no_grad():
        states = model.chain(batch, {}).sample()
        observations = model.emission(states).sample() * mask.unsqueeze(-1)
    return replace(batch, observations=observations), states


@pytest.fixture
def ragged():
    """Individuals that come late, go early, are lost for a while, or are seen once."""
    mask = torch.ones(BATCH, TIMES, INDIVIDUALS, dtype=torch.bool)
    mask[0, :4, 0] = False
    mask[0, 3:9, 1] = False
    mask[1, 7:, 2] = False
    mask[1, :, 3] = False
    mask[2, :, 0] = False
    mask[2, 5, 0] = True
    mask[2, 2:11:2, 1:3] = False
    return mask


def weights(model, guide, batch, draws=3):
    """Return log p(x, z) - log q(z) of each window for several draws."""
    found = []
    with torch.no_grad():
        for seed in range(draws):
            torch.manual_seed(seed)
            states, density = guide.path(batch, {})
            joint = model.chain(batch, {}).log_prob(states)
            seen = model.emission(states).mask(batch.mask).to_event(2)
            found.append(joint + seen.log_prob(batch.observations) - density)
    return torch.stack(found)


def set_velocity_gain(guide, gain):
    """Tell a guide what a velocity does to the next one, as training would."""
    place = sum(guide.parts[:4]) + 1
    with torch.no_grad():
        guide.correct.bias[place] = 5.0 * math.atanh((gain - 1.0) / 5.0)


def scrambled(guide):
    """Give a guide's network something to say."""
    torch.manual_seed(5)
    with torch.no_grad():
        guide.correct.weight.normal_(std=0.2)
        guide.correct.bias.normal_(std=0.2)
        guide.neighbor_gain.normal_(std=0.2)
    return guide


@pytest.mark.parametrize("friction", [0.0, 2.0])
def test_without_interaction_each_draw_has_the_weight_of_the_evidence(
    friction, ragged, dense_evidence
):
    model = flying(friction=friction)
    batch, _ = drawn(model, ragged)
    guide = MarkovGuide(model).double()
    set_velocity_gain(guide, 1.0 - 0.1 * friction)
    exact = dense_evidence(model, batch)
    # q is the posterior: whatever is drawn, p(x, z) / q(z) is the evidence. The least variance that
    # the guide puts below the noise is 1e-12 of the first states'.
    torch.testing.assert_close(
        weights(model, guide, batch), exact.expand(3, -1), rtol=1e-7, atol=1e-6
    )


def test_a_general_linear_state_is_as_exact(ragged, dense_evidence):
    model = linear()
    batch, _ = drawn(model, ragged)
    guide = MarkovGuide(model).double()
    exact = dense_evidence(model, batch)
    torch.testing.assert_close(
        weights(model, guide, batch), exact.expand(3, -1), rtol=1e-7, atol=1e-6
    )


def test_positions_of_a_general_linear_state(ragged, dense_evidence):
    model = linear(emission=PositionEmission(2, 0.1))
    batch, _ = drawn(model, ragged)
    guide = MarkovGuide(model).double()
    exact = dense_evidence(model, batch)
    torch.testing.assert_close(
        weights(model, guide, batch), exact.expand(3, -1), rtol=1e-7, atol=1e-6
    )


@pytest.mark.parametrize("make", [flying, linear])
def test_an_individual_that_comes_back_starts_anew(make, dense_evidence):
    model = make()
    batch, _ = drawn(model)
    present = batch.present.clone()
    present[1, 4:7, 2] = False
    mask = batch.mask & present
    batch = replace(batch, present=present, mask=mask)
    batch = replace(batch, observations=batch.observations * mask.unsqueeze(-1))
    guide = MarkovGuide(model).double()
    exact = dense_evidence(model, batch)
    torch.testing.assert_close(
        weights(model, guide, batch), exact.expand(3, -1), rtol=1e-7, atol=1e-6
    )


@pytest.mark.parametrize("make", [flying, linear])
def test_window_of_one_frame(make, dense_evidence):
    model = make()
    batch, _ = drawn(model, times=1)
    guide = MarkovGuide(model).double()
    exact = dense_evidence(model, batch)
    torch.testing.assert_close(weights(model, guide, batch), exact.expand(3, -1))


def test_an_interacting_swarm_is_learned_to_a_hundredth_of_a_nat(dense_evidence):
    model = linear(coupling=0.15)
    batch, _ = drawn(model, times=20)
    coordinates = batch.observations.numel()
    with quiet_pyro():
        guide = MarkovGuide(model).double()
        elbo = Trace_ELBO()(model, guide)
        optimizer = torch.optim.Adam(guide.parameters(), lr=0.003)
        for _ in range(20):
            optimizer.zero_grad()
            (elbo(batch) / coordinates).backward()
            optimizer.step()
        gaps = (dense_evidence(model, batch) - weights(model, guide, batch, 40)).sum(-1)
    gaps = gaps / coordinates
    error = gaps.std() / math.sqrt(len(gaps))
    assert gaps.mean() + 3 * error > 0.0
    assert gaps.mean() - 3 * error < 0.01


@pytest.mark.parametrize("make", [flying, linear])
def test_edge_list_gives_the_same_numbers(make, ragged):
    options = {"coupling": 0.3} if make is linear else {"align": 1.0, "cohesion": 0.5}
    model = make(**options)
    batch, _ = drawn(model, ragged)
    guide = scrambled(MarkovGuide(model).double())
    sparse = replace(batch, adjacency=EdgeList.from_dense(batch.adjacency))
    found = []
    for one in (batch, sparse):
        torch.manual_seed(0)
        found.append(guide.path(one, {}))
    torch.testing.assert_close(found[0], found[1], rtol=1e-6, atol=1e-6)


def mean_of(guide, batch):
    """Return the mean path before neighbours pull, and the law's noise."""
    known = guide.setting(batch, {})
    steps = guide.chain.steps(known.sightings, known.law, known.start, batch.present)
    return known.reference + steps.mean(known.reference), known.correction


@pytest.mark.parametrize("make", [flying, linear])
def test_padding_changes_nothing(make, ragged):
    model = make()
    batch, _ = drawn(model, ragged)
    guide = scrambled(MarkovGuide(model).double())

    def pad(values, before=2, after=3):
        shape = [values.shape[0], 1, *values.shape[2:]]
        ends = [values.new_zeros([shape[0], n, *shape[2:]]) for n in (before, after)]
        return torch.cat([ends[0], values, ends[1]], 1)

    padded = SwarmBatch.of(pad(batch.observations), pad(batch.mask), pad(batch.adjacency))
    for one, other in zip(mean_of(guide, batch), mean_of(guide, padded), strict=True):
        there = batch.present.unsqueeze(-1)
        torch.testing.assert_close(other[:, 2:-3] * there, one * there, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("make", [flying, linear])
def test_renaming_individuals_renames_the_posterior(make, ragged):
    model = make()
    batch, _ = drawn(model, ragged)
    guide = scrambled(MarkovGuide(model).double())
    order = torch.tensor([2, 0, 3, 1])
    renamed = SwarmBatch.of(
        batch.observations[:, :, order],
        batch.mask[:, :, order],
        batch.adjacency[:, :, order][..., order],
    )
    mean, _ = mean_of(guide, batch)
    torch.testing.assert_close(mean_of(guide, renamed)[0], mean[:, :, order])


def test_states_of_the_absent_are_zero_and_positions_follow(ragged):
    model = flying(align=1.0, cohesion=0.5)
    batch, _ = drawn(model, ragged)
    states, _ = scrambled(MarkovGuide(model).double()).path(batch, {})
    assert not states[~batch.present].any()
    # The chain refuses positions that do not follow from the velocities.
    chain = model.chain(batch, {})
    chain._validate_args = True
    assert chain.log_prob(states).isfinite().all()


def test_untrained_it_smooths_far_from_the_origin():
    """In float32 at 5,000 units, positions are known better than they were seen."""
    torch.manual_seed(0)
    model = flying(align=1.0, cohesion=0.5)
    batch, states = drawn(model, times=50)
    off = tensor(5000.0, -3000.0)
    moved = replace(batch, observations=(batch.observations + off).float(), mask=batch.mask)
    moved = replace(moved, adjacency=batch.adjacency.float())
    far = StateSpaceModel(
        InitialStates(torch.tensor([5001.0, -3000.0, 0.2, 0.0]), torch.tensor([1.0, 1, 0.5, 0.5])),
        Flight(align=1.0, cohesion=0.5),
        PositionEmission(2, torch.tensor([0.05, 0.08])),
    )
    guide = MarkovGuide(far)
    draws = torch.stack([guide.path(moved, {})[0] for _ in range(25)]).double()
    truth = torch.cat([states[..., :2] + off, states[..., 2:]], -1)
    error = (draws.mean(0) - truth)[..., :2].square().mean((0, 1, 2)).sqrt()
    assert (error < 0.7 * tensor(0.05, 0.08)).all()
    # The posterior is as wide as its errors; untrained, it leaves out how unsure neighbours are.
    size = ((draws.mean(0) - truth) / draws.std(0)).square().mean()
    assert 0.7 < size < 1.6


def test_controls_enter_through_the_law(dense_evidence):
    controls = 3.0 * torch.randn(
        BATCH, TIMES, 2, dtype=DOUBLE, generator=torch.Generator().manual_seed(1)
    )
    model = flying()
    batch, _ = drawn(model, controls=controls)
    guide = MarkovGuide(model).double()
    exact = dense_evidence(model, batch)
    torch.testing.assert_close(
        weights(model, guide, batch), exact.expand(3, -1), rtol=1e-7, atol=1e-6
    )


def test_it_follows_drawn_parameters(dense_evidence):
    model = flying()
    batch, _ = drawn(model)
    with quiet_pyro():
        asked = StateSpaceModel(
            start(), Flight(), PositionEmission(2, dist.LogNormal(tensor(-3.0)[0], 0.5))
        )
        guide = MarkovGuide(asked).double()
        for noise in (0.02, 0.2):
            values = {"emission.noise": tensor(noise)[0]}
            exact = dense_evidence(
                StateSpaceModel(start(), Flight(), PositionEmission(2, tensor(noise, noise))), batch
            )
            with torch.no_grad():
                states, density = guide.path(batch, values)
                seen = dist.Normal(states[..., :2], noise).to_event(3)
                joint = asked.chain(batch, values).log_prob(states)
            weight = joint + seen.log_prob(batch.observations) - density
            torch.testing.assert_close(weight, exact, rtol=1e-7, atol=1e-6)


def test_hidden_features_are_recognised_by_a_network():
    with quiet_pyro():
        torch.manual_seed(0)
        law = LinearTransition(3, 0.9 * torch.eye(3), 0.3 * torch.eye(3))
        initial = InitialStates(torch.zeros(3), torch.ones(3))
        model = StateSpaceModel(initial, law, NeuralEmission(3, 2, [8], 0.1))
        batch = SwarmBatch.of(
            torch.randn(2, 8, 3, 2), torch.ones(2, 8, 3, dtype=torch.bool), torch.zeros(2, 8, 3, 3)
        )
        guide = MarkovGuide(model)
        assert guide.shown is None
        elbo = Trace_ELBO()(model, guide)
        optimizer = torch.optim.Adam(elbo.parameters(), lr=0.02)
        losses = []
        for _ in range(30):
            optimizer.zero_grad()
            losses.append(elbo(batch))
            losses[-1].backward()
            optimizer.step()
    assert sum(losses[-5:]) < 0.5 * sum(losses[:5])


def test_gradient_reaches_what_the_model_learns():
    """The bound's gradient is that of finite differences, the guide's own way included."""
    with quiet_pyro():
        model = flying()
        batch, _ = drawn(model)
        model.transition.friction = torch.nn.Parameter(tensor(0.5)[0])
        # One pass: a later reference follows the model too, and is held fixed.
        guide = scrambled(MarkovGuide(model, passes=1).double())
        elbo = Trace_ELBO()(model, guide)

        def loss(friction):
            with torch.no_grad():
                model.transition.friction.fill_(friction)
            torch.manual_seed(0)
            return elbo(batch)

        loss(0.5).backward()
        slope = (loss(0.501) - loss(0.499)).item() / 0.002
    assert model.transition.friction.grad.item() == pytest.approx(slope, rel=1e-4)


class Clamped(Flight):
    @property
    def is_smooth(self):
        return False


class Heading(Transition):
    noise_dim = 1


def test_transitions_it_cannot_follow_are_refused():
    emission = PositionEmission(2, 0.1)
    with pytest.raises(InputError, match="MarkovGuide needs next states that have a density"):
        MarkovGuide(StateSpaceModel(start(), Clamped(), emission))
    with pytest.raises(InputError, match=r"moves all 4 features .* and Heading moves 1"):
        MarkovGuide(StateSpaceModel(start(), Heading(4), emission))
