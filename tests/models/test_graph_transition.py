"""The free-form law of motion: its equations by hand, its symmetries, its learning."""

import math

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, Pairs
from swarmssm.models import InitialStates, Scales, StateSpaceModel, StepInputs, SwarmBatch
from swarmssm.models.interaction_network import InteractionNetwork
from swarmssm.models.presets import graph_ssm
from swarmssm.models.reflections import reflected
from swarmssm.models.transitions import GraphTransition, SoftSpeedLimits
from swarmssm.models.transitions.base import Transition

DOUBLE = torch.float64
NUMBER = 5
#: Sums of a few hundred terms of size one, in float64.
CLOSE = {"rtol": 1e-10, "atol": 1e-12}


def scales(space=2, individuals=NUMBER, **changes):
    values = {
        "space": space,
        "individuals": individuals,
        "dt": 0.1,
        "centre": (0.3, -0.2, 0.1)[:space],
        "low": (-3.0,) * space,
        "high": (3.0,) * space,
        "length": 2.0,
        "speed": 0.9,
        "slow": 0.5,
        "fast": 1.3,
        "spacing": 0.8,
        "step": 0.04,
        "noise": 0.0,
    }
    return Scales(**(values | changes))


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def graphs(*leading, number=NUMBER, seed=1):
    dense = (rand(*leading, number, number, seed=seed) > 0).to(DOUBLE)
    return dense * (1.0 - torch.eye(number, dtype=DOUBLE))


def scrambled(model, seed=0, size=0.3):
    """Give every weight a value that does something, as training would."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += size * torch.randn(parameter.shape, generator=generator)
    return model.to(DOUBLE)


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rounds": 2, "noise": "state", "tails": "student"},
        {"positions": False},
        {"controls": 1},
    ],
)
def test_untrained_it_is_constant_velocity(space, options):
    transition = GraphTransition(scales(space), width=8, **options).to(DOUBLE)
    states = rand(3, NUMBER, 2 * space)
    controls = rand(3, 1) if "controls" in options else None
    following = transition(states, StepInputs(graphs(3), controls))
    positions, velocities = states[..., :space], states[..., space:]
    expected = torch.cat([positions + 0.1 * velocities, velocities], dim=-1)
    torch.testing.assert_close(following.mean, expected, rtol=1e-12, atol=1e-12)
    # The noise starts at the change of velocity that the tracks show.
    own = following.velocity
    own = own.scale if "tails" in options else own.base_dist.scale
    torch.testing.assert_close(own, torch.full_like(own, 0.04), rtol=1e-6, atol=0)


def test_the_network_is_its_equations():
    """Written out with loops over individuals and neighbours."""
    torch.manual_seed(0)
    width, own_features, pair_features, straight = 6, 4, 5, 3
    network = InteractionNetwork(
        own_features, pair_features, straight, 2, width=width, num_rounds=2, usual_degree=3.0
    )
    scrambled(network)
    own, pair, graph = rand(NUMBER, own_features), rand(NUMBER, NUMBER, pair_features), graphs()
    graph[2] = 0.0
    out = network(own, pair, Pairs(graph, own)).detach().numpy()
    weights = {name: value.detach().numpy() for name, value in network.named_parameters()}
    x, e, a = own.numpy(), pair.numpy(), graph.numpy()

    def layer(name, value):
        return weights[f"{name}.weight"] @ value + weights.get(f"{name}.bias", 0.0)

    hidden = [np.maximum(layer("enter", x[i]), 0) for i in range(NUMBER)]
    for place in range(2):
        before, together = list(hidden), []
        for i in range(NUMBER):
            seen = [j for j in range(NUMBER) if a[i, j]]
            messages = []
            for j in seen:
                sent = layer(f"pair.{place}", e[i, j])
                if place == 1:
                    ends = weights["ends.0.weight"]
                    sent = sent + ends[:width] @ before[i] + ends[width:] @ before[j]
                messages.append(np.maximum(sent, 0))
            total = sum(messages, np.zeros(width))
            features = sum((e[i, j, :straight] for j in seen), np.zeros(straight))
            few = max(len(seen), 1)
            parts = [x[i], features / 3, features / few, [len(seen) / 3], before[i]]
            both = np.concatenate([*parts, total / 3, total / few])
            together.append(both)
            update = layer(f"update.{place}", both)
            gate = 1 / (1 + np.exp(-update[:width]))
            hidden[i] = (1 - gate) * before[i] + gate * np.maximum(update[width:], 0)
    expected = [layer("leave", hidden[i]) + layer("straight", together[i]) for i in range(NUMBER)]
    np.testing.assert_allclose(out, np.stack(expected), rtol=1e-10)


@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_matrix_and_list_of_edges_agree(rounds, dtype):
    transition = scrambled(GraphTransition(scales(), width=16, rounds=rounds, noise="state"))
    transition = transition.to(dtype)
    states, dense = rand(2, 3, 4, NUMBER, 4).to(dtype), graphs(3, 4)
    dense[0, 1] = 0.0
    one = transition(states, StepInputs(dense)).velocity.base_dist
    other = transition(states, StepInputs(EdgeList.from_dense(dense))).velocity.base_dist
    size = float(one.loc.detach().abs().max())
    tolerance = {"rtol": 0, "atol": 1e-6 * size if dtype == torch.float32 else 1e-12}
    torch.testing.assert_close(other.loc, one.loc, **tolerance)
    torch.testing.assert_close(other.scale, one.scale, **tolerance)


def test_a_list_of_edges_of_other_frames_is_refused():
    transition = GraphTransition(scales(), width=4)
    edges = EdgeList.from_dense(graphs(3))
    with pytest.raises(ValueError, match=r"\(3, 5\).*\(4, 5\)"):
        transition(rand(4, NUMBER, 4).float(), StepInputs(edges))


def test_without_a_graph_it_is_refused():
    with pytest.raises(ValueError, match="adjacency"):
        GraphTransition(scales(), width=4)(rand(NUMBER, 4).float(), StepInputs())


@pytest.mark.parametrize("rounds", [1, 2])
def test_an_individual_feels_as_many_edges_away_as_there_are_rounds(rounds):
    transition = scrambled(GraphTransition(scales(), width=8, rounds=rounds))
    chain = torch.diag(torch.ones(NUMBER - 1, dtype=DOUBLE), diagonal=1)  # i sees i + 1
    states = rand(NUMBER, 4).requires_grad_()
    mean = transition(states, StepInputs(chain)).mean
    (gradient,) = torch.autograd.grad(mean[0].sum(), states)
    felt = (gradient.abs().sum(-1) > 0).tolist()
    assert felt == [place <= rounds for place in range(NUMBER)]


def test_individuals_have_no_number():
    transition = scrambled(GraphTransition(scales(), width=8, rounds=2))
    states, graph = rand(NUMBER, 4), graphs()
    order = torch.tensor([3, 1, 4, 0, 2])
    mean = transition(states, StepInputs(graph)).mean
    other = transition(states[order], StepInputs(graph[order][:, order])).mean
    torch.testing.assert_close(other, mean[order], **CLOSE)


def test_without_positions_the_law_is_the_same_everywhere():
    shift = torch.tensor([5.0, -3.0, 0.0, 0.0], dtype=DOUBLE)
    states, inputs = rand(NUMBER, 4), StepInputs(graphs())
    for positions in (True, False):
        transition = scrambled(GraphTransition(scales(), width=8, positions=positions))
        moved = transition(states + shift, inputs).mean - shift
        same = torch.allclose(moved, transition(states, inputs).mean, rtol=1e-9, atol=1e-9)
        assert same is not positions


def test_controls_reach_every_individual_and_their_number_is_checked():
    transition = scrambled(GraphTransition(scales(), width=8, controls=2))
    states, graph = rand(3, NUMBER, 4), graphs(3)
    one, other = (transition(states, StepInputs(graph, rand(3, 2, seed=k))).mean for k in (1, 2))
    assert ((one - other).abs().amax(-1) > 0).all()
    with pytest.raises(ValueError, match="2 controls, and there are 1"):
        transition(states, StepInputs(graph, rand(3, 1)))


def test_gradients_are_finite_at_rest_and_in_one_place():
    transition = scrambled(GraphTransition(scales(), width=8, rounds=2, noise="state"))
    states = torch.zeros(NUMBER, 4, dtype=DOUBLE, requires_grad=True)
    following = transition(states, StepInputs(torch.ones(NUMBER, NUMBER, dtype=DOUBLE)))
    following.log_prob(torch.zeros(NUMBER, 4, dtype=DOUBLE)).sum().backward()
    assert states.grad.isfinite().all()
    assert all(p.grad is None or p.grad.isfinite().all() for p in transition.parameters())


def test_noise_may_depend_on_the_state_within_bounds():
    transition = GraphTransition(scales(), width=8, noise="state")
    scrambled(transition, size=30.0)
    scale = transition(rand(50, NUMBER, 4), StepInputs(graphs(50))).velocity.base_dist.scale
    common = transition.noise_scale
    assert scale.std() > 0
    assert ((scale > 0.0099 * common) & (scale < 101 * common)).all()


def test_noise_takes_a_prior_and_a_value_for_each():
    each = torch.linspace(0.1, 0.5, NUMBER)
    transition = GraphTransition(scales(), width=4, noise_scale=each)
    following = transition(rand(3, NUMBER, 4).float(), StepInputs(graphs(3)))
    expected = each.square().unsqueeze(-1).expand(3, NUMBER, 2)
    torch.testing.assert_close(following.variance[..., 2:], expected)

    transition = GraphTransition(scales(), width=4, noise_scale=dist.LogNormal(-3.0, 1.0))
    model = StateSpaceModel(InitialStates.for_scales(scales()), transition, None)
    assert set(model.sample_globals()) == {"transition.noise_scale"}


def test_tracking_noise_is_not_taken_for_motion():
    noisy = scales(noise=0.0015)
    start = GraphTransition(noisy, width=4).noise_scale
    expected = math.sqrt(0.04**2 - 6 * (0.0015 / 0.1) ** 2)
    torch.testing.assert_close(start.item(), expected, rtol=1e-5, atol=0)


def test_tails_of_student_are_heavier():
    transition = GraphTransition(scales(), width=4, tails="student").to(DOUBLE)
    gaussian = GraphTransition(scales(), width=4).to(DOUBLE)
    states, inputs = rand(NUMBER, 4), StepInputs(graphs())
    outlier = states.clone()
    outlier[..., 2:] += 1.0  # 25 standard deviations
    assert (
        transition(states, inputs).log_prob(outlier)
        > gaussian(states, inputs).log_prob(outlier) + 100
    ).all()
    # Scale 0.04 and 6 degrees of freedom.
    variance = transition(states, inputs).velocity.variance
    torch.testing.assert_close(
        variance, torch.full_like(variance, 0.04**2 * 1.5), rtol=1e-5, atol=0
    )


@pytest.mark.parametrize(
    ("option", "value"), [("noise", "loud"), ("tails", "long"), ("symmetries", "all")]
)
def test_unknown_options_are_refused(option, value):
    with pytest.raises(InputError, match=f"{option}.*{value}"):
        GraphTransition(scales(), **{option: value})


# Said by torch itself when it differentiates forwards for the first time.
@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")
@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("sparse", [False, True])
def test_linearisation_is_the_derivative(rounds, sparse):
    transition = scrambled(GraphTransition(scales(), width=8, rounds=rounds, tails="student"))
    mean, dense = rand(2, 3, NUMBER, 4), graphs(2, 3)
    inputs = StepInputs(EdgeList.from_dense(dense) if sparse else dense)
    with torch.no_grad():
        linear = transition.linearize(mean, inputs)
    following = transition(mean, inputs)
    torch.testing.assert_close(linear.mean, following.mean, **CLOSE)
    assert linear.jacobian.shape == (2, 3, NUMBER, 4, NUMBER, 4)
    assert not linear.jacobian.requires_grad
    plain = Transition.linearize(transition, mean, StepInputs(dense))
    torch.testing.assert_close(linear.jacobian, plain.jacobian, **CLOSE)
    torch.testing.assert_close(linear.noise, following.covariance_matrix, **CLOSE)
    # Central differences, whose error falls with the square of the step.
    small = 1e-6
    for j, b in ((0, 0), (3, 1), (2, 3)):
        move = torch.zeros(NUMBER, 4, dtype=DOUBLE)
        move[j, b] = small
        up, down = (transition(mean + s * move, inputs).mean for s in (1, -1))
        slope = (up - down) / (2 * small)
        torch.testing.assert_close(linear.jacobian[..., j, b], slope, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("sparse", [False, True])
def test_parts_add_up_to_the_acceleration(rounds, sparse):
    model = GraphTransition(scales(), rounds=rounds, speed_limits=False, noise="state", width=8)
    states, graph = rand(6, NUMBER, 4), graphs(6)
    inputs = StepInputs(EdgeList.from_dense(graph) if sparse else graph)
    assert (model.to(DOUBLE).parts(states, inputs) == 0).all()
    model = scrambled(model)
    parts = model.parts(states, inputs)
    assert parts.shape == (6, len(model.part_names), NUMBER, 2)
    change = model(states, inputs).mean[..., 2:] - states[..., 2:]
    torch.testing.assert_close(parts.sum(-3), change / model.dt, **CLOSE)
    assert (parts.abs().amax((0, 2, 3)) > 0).all()


def test_parts_of_neighbours_are_nothing_to_who_is_alone():
    model = scrambled(GraphTransition(scales(), width=8))
    states, inputs = rand(6, NUMBER, 4), StepInputs(torch.zeros(6, NUMBER, NUMBER, dtype=DOUBLE))
    parts = dict(zip(model.part_names, model.parts(states, inputs).unbind(-3), strict=True))
    for name in ("displacement", "relative velocity", "push", "distance", "messages"):
        assert (parts[name] == 0).all()
    assert (parts["own"] != 0).all()
    assert (model.features(states, inputs) == 0).all()


def test_features_are_the_summed_messages():
    model = scrambled(GraphTransition(scales(), width=8))
    states, graph = rand(6, NUMBER, 4), graphs(6)
    sender, receiver = states.unsqueeze(-3), states.unsqueeze(-2)
    pair = model._pair(receiver, sender.expand(6, NUMBER, NUMBER, 4))
    messages = torch.relu(model.network.pair[0](pair)) * graph.unsqueeze(-1)
    expected = messages.sum(-2) / model.network.usual_degree
    torch.testing.assert_close(model.features(states, StepInputs(graph)), expected, **CLOSE)
    assert model.feature_names == tuple(f"message {k}" for k in range(1, 9))


def test_contributions_want_all_linear_features():
    network = InteractionNetwork(2, 5, 4, 2, width=3)
    with pytest.raises(ValueError, match="add up to 4"):
        network.contributions(
            rand(3, 2), rand(3, 3, 5), Pairs(graphs(number=3), rand(3, 2)), [2, 1]
        )


def test_linearisation_can_be_learned_through():
    """The gradient of a function of the Jacobian, against central differences in one weight."""
    transition = scrambled(GraphTransition(scales(), width=8))
    mean, inputs = rand(3, NUMBER, 4), StepInputs(graphs(3))
    pick = rand(3, NUMBER, 4, NUMBER, 4, seed=4)
    weight = transition.network.straight.weight

    def value():
        return (transition.linearize(mean, inputs).jacobian * pick).sum()

    (gradient,) = torch.autograd.grad(value(), weight)
    small = 1e-6
    with torch.no_grad():
        weight[0, 2] += small
        up = value()
        weight[0, 2] -= 2 * small
        down = value()
    torch.testing.assert_close(gradient[0, 2], (up - down) / (2 * small), rtol=1e-5, atol=1e-7)


def limits(low=0.5, high=1.5, softness=0.01, amount=1.0):
    limits = SoftSpeedLimits(low, high, softness).to(DOUBLE)
    with torch.no_grad():
        limits.strength.fill_(0.1 * math.atanh(min(amount, 1 - 1e-12)))
    return limits


def test_speed_limits_clip_when_sharp_and_do_nothing_before_training():
    velocities = rand(100, 2)
    speed = velocities.norm(dim=-1, keepdim=True)
    clipped = velocities * speed.clamp(0.5, 1.5) / speed
    # A rounded corner is off by softness * log 2 at most.
    off = (limits()(velocities) - clipped).norm(dim=-1)
    assert off.max() < 0.01 * math.log(2) + 1e-6
    assert off.max() > 1e-4
    assert torch.equal(limits(amount=0.0)(velocities), velocities)
    half = limits(amount=0.5)(velocities)
    torch.testing.assert_close(half, 0.5 * (velocities + limits()(velocities)), **CLOSE)


def test_speed_limits_by_hand():
    """With s = 1, l = 2, h = 3, k = 0.5, a = 1: 1 + 0.5 (log(1 + e^2) - log(1 + e^-4))."""
    value = limits(2.0, 3.0, 0.5)(torch.tensor([0.0, -1.0], dtype=DOUBLE))
    expected = 1 + 0.5 * (math.log1p(math.exp(2)) - math.log1p(math.exp(-4)))
    # The speed is smoothed at 0 over a thousandth of k, and its square root taken.
    torch.testing.assert_close(
        value, torch.tensor([0.0, -expected], dtype=DOUBLE), rtol=1e-6, atol=0
    )


def windows(features=4, batch=64, seed=0):
    observations = rand(batch, 3, NUMBER, features, seed=seed)
    mask = rand(batch, 3, NUMBER, seed=seed + 1) > -1.0
    observations = observations * mask.unsqueeze(-1)
    return SwarmBatch.of(observations, mask, graphs(batch, 3))


def test_reflected_windows_are_the_eight_images_of_a_square():
    centre = torch.tensor([0.5, -1.0], dtype=DOUBLE)
    batch = windows()
    image = reflected(batch, centre, generator=torch.Generator().manual_seed(0))
    assert image.adjacency is batch.adjacency
    assert (image.observations[~batch.mask] == 0).all()
    matrices = set()
    for one, other, mask in zip(batch.observations, image.observations, batch.mask, strict=True):
        before, after = one[mask], other[mask]
        # Of the window's velocities, by least squares, the matrix that turned them.
        turn = torch.linalg.lstsq(before[:, 2:], after[:, 2:]).solution.T
        rounded = turn.round()
        torch.testing.assert_close(turn, rounded, rtol=0, atol=1e-10)
        torch.testing.assert_close(
            after[:, :2], (before[:, :2] - centre) @ rounded.T + centre, **CLOSE
        )
        matrices.add(tuple(rounded.flatten().int().tolist()))
    assert matrices == {
        (a, 0, 0, b) if straight else (0, a, b, 0)
        for straight in (True, False)
        for a in (-1, 1)
        for b in (-1, 1)
    }


def test_reflected_without_exchange_of_axes():
    batch = windows(features=2)
    image = reflected(batch, (0.0, 0.0), "mirror", generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(image.observations.abs(), batch.observations.abs())
    signs = torch.sign(image.observations * batch.observations)
    assert {tuple(row) for row in signs[batch.mask].tolist()} == {
        (a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)
    }


@pytest.mark.parametrize("space", [2, 3])
def test_reflected_windows_of_a_round_arena(space):
    """All distances stay; a direction becomes any other, half of the images being mirrored."""
    number = 4000
    observations = torch.zeros(number, 1, space, 2 * space, dtype=DOUBLE)
    observations[..., space:] = torch.eye(space, dtype=DOUBLE)
    observations[..., :space] = 2.0
    mask = torch.ones(number, 1, space, dtype=torch.bool)
    batch = SwarmBatch.of(observations, mask, torch.zeros(number, 1, space, space))
    generator = torch.Generator().manual_seed(0)
    image = reflected(batch, (1.0,) * space, "circle", generator=generator).observations[:, 0]
    # Rows of the velocities are what became of the axes.
    turn = image[..., space:].mT
    eye = torch.eye(space, dtype=DOUBLE).expand(number, space, space)
    torch.testing.assert_close(turn @ turn.mT, eye, rtol=0, atol=1e-6)
    expected = turn @ torch.ones(space, dtype=DOUBLE) + 1.0
    torch.testing.assert_close(image[:, 0, :space], expected, rtol=0, atol=1e-6)
    # Four standard errors of a share of one half, and of a mean of squares of mean 1 / space.
    four = 4 / number**0.5
    assert abs(float((turn.det() > 0).double().mean()) - 0.5) < 0.5 * four
    assert (turn.mean(0).abs() < four).all()
    assert (turn.square().mean(0) - 1 / space).abs().max() < 0.5 * four


def test_reflected_refuses_what_it_does_not_understand():
    batch = windows(features=3)
    with pytest.raises(ValueError, match="2 or 4 features, and they have 3"):
        reflected(batch, (0.0, 0.0))
    with_controls = SwarmBatch.of(batch.observations, batch.mask, batch.adjacency, rand(64, 3, 1))
    with pytest.raises(ValueError, match="controls"):
        reflected(with_controls, (0.0, 0.0))
    with pytest.raises(InputError, match="symmetries"):
        GraphTransition(scales(), symmetries="mirror", controls=1)


def test_only_a_law_with_symmetries_makes_images():
    batch = windows()
    assert GraphTransition(scales(), width=4).augmented(batch) is batch
    pyro.set_rng_seed(0)
    transition = GraphTransition(scales(), width=4, symmetries="square").to(DOUBLE)
    model = StateSpaceModel(InitialStates.for_scales(scales()), transition, None)
    assert not torch.equal(model.augmented(batch).observations, batch.observations)


def test_the_centre_of_a_symmetric_arena_is_found():
    """Individuals on springs fixed to one point, which is not the mean of where they were seen."""
    pyro.set_rng_seed(0)
    true = torch.tensor([0.5, 0.4])
    states = torch.randn(100, 1, NUMBER, 4) * torch.tensor([1.0, 1.0, 0.5, 0.5])
    velocities = states[..., 2:] - 0.05 * (states[..., :2] - true)
    velocities = velocities + 0.01 * torch.randn_like(velocities)
    following = torch.cat([states[..., :2] + 0.1 * velocities, velocities], dim=-1)
    observations = torch.cat([states, following], dim=1)
    mask = torch.ones(100, 2, NUMBER, dtype=torch.bool)
    batch = SwarmBatch.of(observations, mask, torch.zeros(100, 2, NUMBER, NUMBER))
    own = scales(centre=(0.0, 0.0), length=1.0, speed=0.7, step=0.05)
    transition = GraphTransition(own, width=8, symmetries="square", speed_limits=False)
    model = StateSpaceModel(InitialStates.for_scales(own), transition, None)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.02)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 200)
    for _ in range(200):
        optimizer.zero_grad()
        image = model.augmented(batch)
        loss = -transition(image.observations[:, 0], StepInputs(image.adjacency[:, 0])).log_prob(
            image.observations[:, 1]
        )
        loss.mean().backward()
        optimizer.step()
        schedule.step()
    # 500 coordinates on each axis with noise 0.01 against a pull of 0.05: standard error 0.009.
    assert (transition.centre - true).abs().max() < 0.036


def test_the_weight_prior_is_normal_and_counts_once():
    transition = GraphTransition(scales(), width=4, weight_prior=0.5)
    expected = sum(
        -0.5 * float((weight.detach() ** 2).sum()) * weight.shape[1] / 0.25
        for weight in transition.network.parameters()
        if weight.dim() == 2
    )
    assert float(transition.log_prior().detach()) == pytest.approx(expected, rel=1e-5)
    assert GraphTransition(scales(), width=4).log_prior() is None
    with pytest.raises(InputError, match="weight_prior"):
        GraphTransition(scales(), width=4, weight_prior=0.0)


def test_the_weight_prior_is_part_of_training_alone():
    model = graph_ssm(scales(), width=4)
    states = torch.zeros(2, 3, NUMBER, 2)
    batch = SwarmBatch.of(states, torch.ones(2, 3, NUMBER, dtype=bool), graphs(2, 3).float())
    for training in (True, False):
        model.train(training)
        sites = pyro.poutine.trace(model).get_trace(batch).nodes
        assert ("weights" in sites) == training
