"""The whole model against sums of normals made by hand and one dense Gaussian."""

import math
from dataclasses import replace

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import Predictive, Trace_ELBO
from torch import nn

from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import EdgeList, dense
from swarmssm.models import (
    Emission,
    InitialStates,
    KinematicTransition,
    LatentEdges,
    LinearTransition,
    PositionEmission,
    StateEmission,
    StateSpaceModel,
    SwarmBatch,
    Transition,
)

DOUBLE = torch.float64
TIMES, INDIVIDUALS, STATE = 5, 3, 2
MATRIX = torch.tensor([[1.0, 0.2], [-0.3, 0.8]], dtype=DOUBLE)
COUPLING = torch.tensor([[0.1, 0.0], [0.3, 0.2]], dtype=DOUBLE)
OFFSET = torch.tensor([0.05, -0.1], dtype=DOUBLE)
TRIL = torch.tensor([[0.2, 0.0], [0.1, 0.3]], dtype=DOUBLE)
MEAN = torch.tensor([0.5, -0.2], dtype=DOUBLE)
SCALE = torch.tensor([1.0, 0.5], dtype=DOUBLE)
NOISE = 0.25


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def linear_model(emission=None, edges=None, **changes):
    parts = {"matrix": MATRIX, "noise_tril": TRIL, "coupling": COUPLING, "offset": OFFSET}
    transition = LinearTransition(STATE, **{**parts, **changes})
    return StateSpaceModel(InitialStates(MEAN, SCALE), transition, emission, edges).double()


def seen(**changes):
    return linear_model(PositionEmission(1, torch.tensor(NOISE, dtype=DOUBLE)), **changes)


def graphs(batch=1, times=TIMES, seed=7):
    graph = (rand(batch, times, INDIVIDUALS, INDIVIDUALS, seed=seed) > 0).to(DOUBLE)
    return graph * (1 - torch.eye(INDIVIDUALS, dtype=DOUBLE))


def batch_of(batch=2, mask=None, seed=0):
    if mask is None:
        mask = torch.ones(batch, TIMES, INDIVIDUALS, dtype=torch.bool)
    observations = rand(batch, TIMES, INDIVIDUALS, 1, seed=seed) * mask.unsqueeze(-1)
    return SwarmBatch.of(observations, mask, graphs(batch))


def moments(graph):
    """Mean and covariance of all states, stacked over time and individuals, in numpy."""
    size = INDIVIDUALS * STATE
    mean, means = np.tile(MEAN.numpy(), INDIVIDUALS), []
    covariance = np.kron(np.eye(INDIVIDUALS), np.diag(SCALE.numpy() ** 2))
    noise = np.kron(np.eye(INDIVIDUALS), (TRIL @ TRIL.T).numpy())
    blocks, steps = [covariance], []
    means.append(mean)
    for adjacency in graph[:-1].numpy():
        count = adjacency.sum(1, keepdims=True)
        pull = np.where(count > 0, adjacency / np.maximum(count, 1) - np.eye(INDIVIDUALS), 0.0)
        step = np.kron(np.eye(INDIVIDUALS), MATRIX.numpy()) + np.kron(pull, COUPLING.numpy())
        mean = step @ mean + np.tile(OFFSET.numpy(), INDIVIDUALS)
        covariance = step @ covariance @ step.T + noise
        steps.append(step)
        means.append(mean)
        blocks.append(covariance)
    joint = np.zeros((TIMES, size, TIMES, size))
    for s in range(TIMES):
        block = blocks[s]
        for t in range(s, TIMES):
            joint[t, :, s, :] = block
            joint[s, :, t, :] = block.T
            if t < TIMES - 1:
                block = steps[t] @ block
    return np.concatenate(means), joint.reshape(TIMES * size, TIMES * size)


def test_simulated_paths_have_the_mean_and_covariance_of_the_dense_gaussian():
    graph = graphs()[0]
    number = 20_000
    drawn = seen().simulate(TIMES, INDIVIDUALS, num_windows=number, graph=graph, seed=3)
    mean, covariance = moments(graph)
    paths = drawn.states.reshape(number, -1).numpy()
    sd = np.sqrt(np.diag(covariance))
    assert (np.abs(paths.mean(0) - mean) < 6 * sd / math.sqrt(number)).all()
    # The variance of the product of two Gaussians is at most twice that of their squares.
    spread = np.outer(sd, sd) * math.sqrt(2 / number)
    assert (np.abs(np.cov(paths.T) - covariance) < 6 * spread).all()
    residuals = (drawn.observations - drawn.states[..., :1]).numpy()
    count = residuals.size
    assert abs(residuals.mean()) < 6 * NOISE / math.sqrt(count)
    assert abs(residuals.std() / NOISE - 1) < 6 / math.sqrt(2 * count)
    assert torch.equal(drawn.adjacency[17], graph)
    assert drawn.present.all()
    assert drawn.states.dtype == drawn.observations.dtype == DOUBLE


def test_the_path_has_the_density_of_the_dense_gaussian():
    graph = graphs()[0]
    model, batch = seen(), batch_of(1)
    mean, covariance = (torch.from_numpy(x) for x in moments(batch.adjacency[0]))
    assert torch.equal(graph, batch.adjacency[0])
    path = rand(1, TIMES, INDIVIDUALS, STATE, seed=9)
    expected = dist.MultivariateNormal(mean, covariance).log_prob(path.reshape(1, -1))
    torch.testing.assert_close(model.chain(batch, {}).log_prob(path), expected, rtol=1e-9, atol=0)


def test_a_list_of_edges_gives_the_same_numbers():
    model, batch = seen(), batch_of(2)
    sparse = replace(batch, adjacency=EdgeList.from_dense(batch.adjacency))
    path = rand(2, TIMES, INDIVIDUALS, STATE, seed=9)
    chains = [model.chain(b, {}) for b in (batch, sparse)]
    scores = [chain.log_prob(path) for chain in chains]
    torch.testing.assert_close(*scores, rtol=1e-12, atol=0)
    draws = []
    for chain in chains:
        pyro.set_rng_seed(1)
        draws.append(chain.sample((3,)))
    torch.testing.assert_close(*draws, rtol=1e-12, atol=1e-14)
    listed = model.simulate(TIMES, INDIVIDUALS, num_windows=2, graph=sparse.adjacency)
    matrix = model.simulate(TIMES, INDIVIDUALS, num_windows=2, graph=batch.adjacency)
    torch.testing.assert_close(listed.states, matrix.states, rtol=1e-12, atol=1e-14)
    assert listed.batch().steps().adjacency.leading == (2, TIMES - 1)


def score_at(model, batch, path):
    """Log joint of a path and the observations."""
    pinned = pyro.poutine.condition(model, {"states": path})
    trace = pyro.poutine.trace(pinned).get_trace(batch)
    trace.compute_log_prob()
    return trace.log_prob_sum(), trace


def by_hand(batch, path, exact=False):
    """Sum of normals, window for window."""
    totals = []
    for w in range(len(batch)):
        present, mask = batch.present[w], batch.mask[w]
        total = torch.zeros((), dtype=DOUBLE)
        for i in range(INDIVIDUALS):
            for t in range(TIMES):
                if not present[t, i]:
                    continue
                z = path[w, t, i]
                if t == 0 or not present[t - 1, i]:
                    total = total + dist.Normal(MEAN, SCALE).log_prob(z).sum()
                else:
                    before, row = path[w, t - 1], batch.adjacency[w, t - 1, i]
                    mean = MATRIX @ before[i] + OFFSET
                    if row.sum() > 0:
                        mean = mean + COUPLING @ (row @ before / row.sum() - before[i])
                    total = total + dist.MultivariateNormal(mean, scale_tril=TRIL).log_prob(z)
                if mask[t, i] and not exact:
                    seen_at = batch.observations[w, t, i]
                    total = total + dist.Normal(z[:1], NOISE).log_prob(seen_at).sum()
        totals.append(total)
    return torch.stack(totals)


@pytest.fixture
def gaps():
    """Individual 0 of window 0 is unseen in frame 2, 1 comes late, 2 of window 1 leaves early."""
    mask = torch.ones(2, TIMES, INDIVIDUALS, dtype=torch.bool)
    mask[0, 2, 0] = False
    mask[0, :2, 1] = False
    mask[1, 3:, 2] = False
    return batch_of(2, mask)


def test_the_log_joint_is_a_sum_of_normals(gaps):
    assert not gaps.present[0, 0, 1]
    assert gaps.present[0, 2, 0]
    path = rand(2, TIMES, INDIVIDUALS, STATE, seed=4)
    expected = by_hand(gaps, path)
    found, trace = score_at(seen(), gaps, path)
    torch.testing.assert_close(found, expected.sum(), rtol=1e-12, atol=0)
    parts = trace.nodes["states"]["log_prob"] + trace.nodes["observations"]["log_prob"]
    torch.testing.assert_close(parts, expected, rtol=1e-12, atol=0)


def test_a_frame_that_was_not_seen_takes_its_one_term_along():
    path = rand(2, TIMES, INDIVIDUALS, STATE, seed=4)
    whole = batch_of(2)
    mask = whole.mask.clone()
    mask[1, 2, 0] = False
    # What stands in the observations there says nothing.
    part = replace(whole, mask=mask)
    term = dist.Normal(path[1, 2, 0, :1], NOISE).log_prob(whole.observations[1, 2, 0]).sum()
    model = seen()
    torch.testing.assert_close(
        score_at(model, whole, path)[0] - score_at(model, part, path)[0], term, rtol=1e-9, atol=0
    )


def test_a_sample_of_the_windows_counts_as_all_of_them():
    model, whole = seen(noise_tril=TRIL), batch_of(6)
    path = rand(6, TIMES, INDIVIDUALS, STATE, seed=4)
    full = score_at(model, whole, path)[0]
    halves = [torch.tensor([0, 1, 5]), torch.tensor([2, 3, 4])]
    scores = [score_at(model, whole.select(rows), path[rows])[0] for rows in halves]
    torch.testing.assert_close(sum(scores) / 2, full, rtol=1e-12, atol=0)
    weight = torch.tensor([2.0, 1.0, 0.5, 1.0, 1.0, 3.0], dtype=DOUBLE)
    heavy = replace(whole, window_weight=weight)
    expected = (weight * by_hand(whole, path)).sum()
    torch.testing.assert_close(score_at(model, heavy, path)[0], expected, rtol=1e-12, atol=0)


def test_a_prior_counts_once_however_small_the_sample():
    model = seen(offset=dist.Normal(torch.zeros(2, dtype=DOUBLE), 1.0))
    batch = replace(batch_of(2), population=10)
    path = rand(2, TIMES, INDIVIDUALS, STATE, seed=4)
    pinned = pyro.poutine.condition(model, {"transition.offset": OFFSET})
    found, _ = score_at(pinned, batch, path)
    prior = dist.Normal(0.0, 1.0).log_prob(OFFSET).sum()
    torch.testing.assert_close(found, prior + 5 * by_hand(batch, path).sum(), rtol=1e-12, atol=0)


def test_states_seen_exactly_are_scored_where_they_were_seen(gaps):
    """A gap has no states to score: the steps into it and out of it have no term."""
    states = rand(2, TIMES, INDIVIDUALS, STATE, seed=4) * gaps.mask.unsqueeze(-1)
    batch = replace(gaps, observations=states)
    model = linear_model()
    trace = pyro.poutine.trace(model).get_trace(batch)
    assert trace.nodes["states"]["is_observed"]
    cut = replace(batch, present=batch.mask)
    expected = by_hand(cut, states, exact=True).sum()
    torch.testing.assert_close(trace.log_prob_sum(), expected, rtol=1e-12, atol=0)
    assert model.observes == "states"
    assert seen().observes == "positions"


def test_the_elbo_of_the_true_posterior_is_the_evidence():
    """A guide that draws from the dense posterior: each draw's ELBO is the log-evidence."""
    model, batch = seen(), batch_of(1)
    mean, covariance = (torch.from_numpy(x) for x in moments(batch.adjacency[0]))
    pick = torch.eye(len(mean), dtype=DOUBLE)[::STATE]
    spread = pick @ covariance @ pick.T + NOISE**2 * torch.eye(len(pick), dtype=DOUBLE)
    data = batch.observations.flatten()
    evidence = dist.MultivariateNormal(pick @ mean, spread).log_prob(data)
    gain = covariance @ pick.T @ torch.linalg.inv(spread)
    posterior = dist.MultivariateNormal(
        mean + gain @ (data - pick @ mean), covariance - gain @ pick @ covariance
    )

    def guide(batch):
        with pyro.plate("windows", 1, dim=-1):
            drawn = posterior.sample((1,))
            states = drawn.reshape(1, TIMES, INDIVIDUALS, STATE)
            density = posterior.log_prob(drawn)
            pyro.sample("states", dist.Delta(states, log_density=density, event_dim=3))

    for _ in range(3):
        torch.testing.assert_close(
            torch.tensor(-Trace_ELBO().loss(model, guide, batch), dtype=DOUBLE),
            evidence,
            rtol=1e-9,
            atol=0,
        )


class Chase(KinematicTransition):
    """Velocities turn to the mean place of the neighbours."""

    def velocity(self, positions, velocities, inputs):
        graph = dense(inputs.adjacency, positions.dtype)
        count = graph.sum(-1, keepdim=True)
        pull = graph @ positions / count.clamp_min(1) - positions
        return dist.Normal(velocities + self.dt * (count > 0) * pull, 0.1).to_event(1)


def chase(rule="radius:1.0", **options):
    initial = InitialStates(torch.zeros(4), torch.ones(4))
    edges = LatentEdges(rule)
    return StateSpaceModel(initial, Chase(2, 0.1), PositionEmission(2, 0.1, **options), edges)


def test_edges_of_the_latent_states_are_those_of_each_frame():
    model = chase()
    drawn = model.simulate(6, 4, num_windows=2, seed=1)
    apart = torch.cdist(drawn.states[..., :2], drawn.states[..., :2])
    expected = (apart <= 1.0) & ~torch.eye(4, dtype=torch.bool)
    graph = dense(drawn.adjacency)
    assert torch.equal(graph.bool(), expected)
    assert 0 < graph.mean() < 0.75
    batch = drawn.batch()
    assert torch.equal(batch.adjacency, drawn.adjacency)
    path = drawn.states
    found = model.chain(batch, {}).log_prob(path)
    pull = graph @ path[..., :2] / graph.sum(-1, keepdim=True).clamp_min(1) - path[..., :2]
    mean = path[..., 2:] + 0.1 * (graph.sum(-1, keepdim=True) > 0) * pull
    steps = dist.Normal(mean[:, :-1], 0.1).log_prob(path[:, 1:, :, 2:]).sum((1, 2, 3))
    first = dist.Normal(0.0, 1.0).log_prob(path[:, 0]).sum((1, 2))
    torch.testing.assert_close(found, first + steps)
    # A rule that is given for the occasion does as the model's own.
    observed = StateSpaceModel(model.initial, Chase(2, 0.1), model.emission)
    again = observed.simulate(6, 4, num_windows=2, seed=1, graph="radius:1.0")
    assert torch.equal(again.states, path)


def test_who_is_absent_is_seen_by_nobody_and_nowhere():
    present = torch.ones(6, 4, dtype=torch.bool)
    present[:3, 1] = False
    present[4:, 2] = False
    drawn = chase("complete").simulate(6, 4, num_windows=2, present=present)
    for values in (drawn.states, drawn.observations):
        assert (values[:, ~present] == 0).all()
        assert (values[:, present] != 0).all()
    graph = dense(drawn.adjacency).bool()
    both = present.unsqueeze(-1) & present.unsqueeze(-2) & ~torch.eye(4, dtype=torch.bool)
    assert torch.equal(graph, both.expand(2, 6, 4, 4))
    batch = drawn.batch()
    assert torch.equal(batch.mask, present.expand(2, 6, 4))
    assert chase().chain(batch, {}).log_prob(drawn.states).isfinite().all()


def test_first_states_may_be_given():
    first = torch.arange(8.0).reshape(2, 4)
    drawn = chase().simulate(3, 2, num_windows=2, first=first)
    assert torch.equal(drawn.states[:, 0], first.expand(2, 2, 4))
    assert drawn.states[0, 1, 0, 2] != drawn.states[1, 1, 0, 2]


def random_model():
    transition = Chase(2, 0.1)
    emission = PositionEmission(2, dist.LogNormal(torch.tensor([-2.0, 0.0]), 0.1))
    initial = InitialStates(dist.Normal(torch.zeros(4), 1.0), torch.ones(4))
    return StateSpaceModel(initial, transition, emission, LatentEdges("complete"))


def test_draws_from_the_prior_have_parameters_of_their_own():
    model = random_model()
    number = 200
    drawn = model.sample_prior((4, 3), number, seed=5)
    assert drawn.parameters["initial.mean"].shape == (number, 4)
    assert drawn.parameters["emission.noise"].shape == (number, 2)
    assert drawn.states.shape == (number, 1, 4, 3, 4)
    logs = drawn.parameters["emission.noise"].log()
    centre = torch.tensor([-2.0, 0.0])
    assert ((logs.mean(0) - centre).abs() < 6 * 0.1 / number**0.5).all()
    assert ((logs.std(0) / 0.1 - 1).abs() < 6 / (2 * number) ** 0.5).all()
    # Each swarm starts about its own mean, and is seen with its own noise.
    start = drawn.states[:, 0, 0] - drawn.parameters["initial.mean"].unsqueeze(1)
    assert abs(start.std() - 1) < 6 / (2 * start.numel()) ** 0.5
    noise = drawn.parameters["emission.noise"][:, None, None, None]
    residuals = (drawn.observations - drawn.states[..., :2]) / noise
    assert abs(residuals.std() - 1) < 6 / (2 * residuals.numel()) ** 0.5
    one = drawn.draw(3)
    assert one.batch().observations.shape == (1, 4, 3, 2)
    with model.fixed(one.parameters):
        assert torch.equal(model.emission.noise, one.parameters["emission.noise"])
    with pytest.raises(InputError, match="several draws"):
        drawn.batch()


def test_given_windows_lend_their_sizes_graph_and_presence(gaps):
    model = seen(offset=dist.Normal(torch.zeros(2, dtype=DOUBLE), 1.0))
    drawn = model.sample_prior(gaps, 3)
    assert drawn.states.shape == (3, 2, TIMES, INDIVIDUALS, STATE)
    assert torch.equal(drawn.present, gaps.present)
    assert torch.equal(drawn.adjacency, gaps.adjacency.expand(3, *gaps.adjacency.shape))
    sparse = replace(gaps, adjacency=EdgeList.from_dense(gaps.adjacency))
    listed = model.sample_prior(sparse, 3)
    torch.testing.assert_close(listed.states, drawn.states)
    assert torch.equal(dense(listed.adjacency, DOUBLE), drawn.adjacency)
    assert torch.equal(dense(listed.draw(2).batch().adjacency, DOUBLE), gaps.adjacency)
    assert (drawn.states[:, ~gaps.present] == 0).all()


def test_a_seed_says_all_and_disturbs_nothing():
    model = random_model()
    before = torch.get_rng_state()
    one, two, other = (model.simulate(4, 3, seed=seed) for seed in (1, 1, 2))
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(one.observations, two.observations)
    assert not torch.equal(one.observations, other.observations)
    moving = torch.Generator().manual_seed(1)
    first, second = (model.simulate(4, 3, seed=moving) for _ in range(2))
    assert not torch.equal(first.observations, second.observations)
    assert not one.states.requires_grad
    assert len(pyro.get_param_store()) == 0


def test_values_may_be_given_in_part():
    noise = torch.tensor([0.1, 0.2])
    drawn = random_model().simulate(4, 3, values={"emission.noise": noise})
    assert torch.equal(drawn.parameters["emission.noise"], noise)
    assert drawn.parameters["initial.mean"].shape == (4,)


def test_predictive_gives_what_the_model_draws():
    model = random_model()
    batch = model.simulate(4, 3, num_windows=2).batch()
    unseen = replace(batch, mask=torch.zeros_like(batch.mask))
    drawn = Predictive(model, num_samples=3, return_sites=("states", "_RETURN"))(unseen)
    assert drawn["states"].shape == (3, 2, 4, 3, 4)
    assert torch.equal(drawn["states"], drawn["_RETURN"])


class Driven(Transition):
    """A push by the control, which the whole swarm feels."""

    def forward(self, states, inputs):
        return dist.Normal(states + inputs.controls.unsqueeze(-2), 1e-3).to_event(1)


def test_controls_push_the_swarm():
    model = StateSpaceModel(InitialStates(torch.zeros(2), torch.ones(2)), Driven(2), None)
    controls = torch.tensor([[1.0, 0.0], [0.0, 2.0], [5.0, 5.0]])
    drawn = model.simulate(3, 2, controls=controls, num_windows=2)
    moved = drawn.states.diff(dim=1)
    torch.testing.assert_close(moved, controls[:2, None].expand(2, 2, 2, 2), atol=6 * 1e-3, rtol=0)
    batch = drawn.batch()
    assert torch.equal(batch.controls[0], controls)
    score = model.chain(batch, {}).log_prob(drawn.states)
    assert score.isfinite().all()


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize(("times", "individuals", "space"), [(1, 1, 2), (4, 1, 3), (1, 3, 2)])
def test_small_swarms_and_short_windows(times, individuals, space, dtype):
    initial = InitialStates(torch.zeros(2 * space), torch.ones(2 * space))
    model = StateSpaceModel(
        initial, Chase(space, 0.1), PositionEmission(space, 0.1), LatentEdges("complete")
    ).to(dtype)
    drawn = model.simulate(times, individuals, num_windows=2)
    assert drawn.states.dtype == dtype
    assert drawn.observations.shape == (2, times, individuals, space)
    trace = pyro.poutine.trace(model).get_trace(drawn.batch())
    assert trace.log_prob_sum().isfinite()
    assert trace.log_prob_sum().dtype == dtype


def test_gradients_reach_learned_parameters_through_the_density():
    model = seen(noise_tril=nn.Parameter(TRIL), offset=nn.Parameter(OFFSET.clone()))
    batch, path = batch_of(2), rand(2, TIMES, INDIVIDUALS, STATE, seed=4)
    with pyro.settings.context(module_local_params=True):
        score_at(model, batch, path)[0].backward()
    offset = dict(model.named_parameters())["transition.offset"]
    # d log N / d offset is the sum of Q^-1 residuals.
    mean = path[:, :-1] @ MATRIX.T + OFFSET
    graph = batch.adjacency[:, :-1]
    count = graph.sum(-1, keepdim=True)
    pull = torch.where(count > 0, graph @ path[:, :-1] / count.clamp_min(1) - path[:, :-1], 0.0)
    residual = (path[:, 1:] - mean - pull @ COUPLING.T).sum((0, 1, 2))
    expected = torch.linalg.solve(TRIL @ TRIL.T, residual)
    torch.testing.assert_close(offset.grad, expected, rtol=1e-9, atol=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_steps": 0}, "simulate: num_steps must be a positive whole number, not 0"),
        ({"num_individuals": 2.0}, "num_individuals must be a positive whole number, not 2.0"),
        ({"num_windows": -1}, "num_windows must be a positive whole number"),
        ({"seed": -1}, "seed: it must be a whole number from 0 or a generator, not -1"),
        ({"seed": 1.5}, "not 1.5"),
        ({"graph": "radius:much"}, "radius"),
        (
            {"graph": torch.ones(4, 2, 2)},
            r"graph: its shape must be \(1, 4, 3, 3\), and it is \(4, 2, 2\)",
        ),
        (
            {"graph": EdgeList.from_dense(torch.ones(1, 3, 3, 3))},
            r"graph: it must be of frames and individuals \(1, 4, 3\), and it is of \(1, 3, 3\)",
        ),
        (
            {"present": torch.ones(3, 4)},
            r"present: its shape must be \(1, 4, 3\), and it is \(3, 4\)",
        ),
        (
            {"controls": torch.ones(3, 1)},
            r"controls: its shape must be \(1, 4, 1\), and it is \(3, 1\)",
        ),
        ({"first": torch.ones(3, 2)}, r"first: its shape must be \(1, 3, 4\), and it is \(3, 2\)"),
        ({"values": {"gain": torch.tensor(1.0)}}, "values: gain is no parameter with a prior"),
    ],
)
def test_a_simulation_that_cannot_be_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        chase().simulate(**{"num_steps": 4, "num_individuals": 3, **change})


def test_draws_from_the_prior_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="sample_prior: num must be a positive whole number"):
        chase().sample_prior((4, 3), 0)
    with pytest.raises(InputError, match=r"values: emission.noise is no parameter"):
        chase().simulate(4, 3, values={"emission.noise": torch.tensor(1.0)})


def run(model, batch):
    return pyro.poutine.trace(model).get_trace(batch)


def test_observations_of_another_size_are_refused_with_both_shapes():
    batch = chase().simulate(4, 3).batch()
    initial = InitialStates(torch.zeros(4), torch.ones(4))
    wants = StateSpaceModel(initial, Chase(2, 0.1), StateEmission(2, 0.1, 0.1))
    message = r"observes 4 features of each individual \(states\), and .* \(1, 4, 3, 2\)"
    with pytest.raises(InputError, match=message):
        run(wants, batch)
    with pytest.raises(InputError, match=message):
        run(StateSpaceModel(initial, Chase(2, 0.1), None), batch)


def test_first_states_of_another_size_are_refused_with_both_shapes():
    batch = chase().simulate(4, 3).batch()
    initial = InitialStates(torch.zeros(6), torch.ones(6))
    model = StateSpaceModel(initial, Chase(2, 0.1), PositionEmission(2, 0.1))
    message = r"initial: first states must have .* \(4,\), and they have \(6,\)"
    with pytest.raises(InputError, match=message):
        run(model, batch)
    few = InitialStates(torch.zeros(2, 4), torch.ones(4))
    model = StateSpaceModel(few, Chase(2, 0.1), PositionEmission(2, 0.1))
    with pytest.raises(ValueError, match=r"with 3 individuals or 1, and it is \(2,\)"):
        run(model, batch)


class Forgetful(Transition):
    """Forgets that features are one event."""

    def forward(self, states, inputs):
        return dist.Normal(states, 1.0)


class Vague(Emission):
    def forward(self, states):
        return dist.Normal(states[..., :2], 1.0)


def test_parts_that_forget_their_event_are_told_so():
    batch = chase().simulate(4, 3).batch()
    initial = InitialStates(torch.zeros(4), torch.ones(4))
    emission = PositionEmission(2, 0.1)
    message = r"\(1, 3\) and event shape \(state,\) = \(4,\), and this one has \(1, 3, 4\) and \(\)"
    with pytest.raises(ValueError, match=message):
        run(StateSpaceModel(initial, Forgetful(4), emission), batch)
    with pytest.raises(
        InputError, match=r"emission: it must return .* this one has \(\)\. \.to_ev"
    ):
        run(StateSpaceModel(initial, Chase(2, 0.1), Vague(), LatentEdges("complete")), batch)


def test_observations_of_another_type_are_refused_with_both():
    batch = batch_of(2)
    with pytest.raises(InputError, match=r"of torch.float64, and the model is of torch.float32"):
        run(seen().float(), batch)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (0, PositionEmission, "initial: it must be a module that returns a distribution"),
        (0, dist.Normal(torch.zeros(4), 1.0).to_event(1), "initial: it must be .* Independent is"),
        (1, lambda states, inputs: None, "transition: it must be a Transition, and function is"),
        (2, PositionEmission, r"emission: .* PositionEmission is not. Call it: PositionEmission\("),
        (
            3,
            "radius:1",
            "edges: it must be ObservedEdges, LatentEdges or RelationalEdges, and str is not",
        ),
    ],
)
def test_what_is_no_part_is_refused(place, value, message):
    parts = [InitialStates(torch.zeros(4), torch.ones(4)), Chase(2, 0.1), None, None]
    parts[place] = value
    with pytest.raises(InputError, match=message):
        StateSpaceModel(*parts)


def test_values_that_cannot_be_are_refused():
    model = random_model()
    with pytest.raises(InputError, match=r"emission\.noise is not one that its prior can have"):
        model.simulate(4, 3, values={"emission.noise": [-1.0, 1.0]})
    with pytest.raises(InputError, match=r"shape of its prior, \(2,\), and this one has \(\)"):
        model.simulate(4, 3, values={"emission.noise": 0.1})
    with pytest.raises(InputError, match="like must be a batch of windows or"):
        model.sample_prior(5)


def test_a_swarm_that_runs_away_is_told_of():
    initial = InitialStates(torch.zeros(2), torch.ones(2))
    model = StateSpaceModel(initial, LinearTransition(2, 1e6, 0.1), None)
    with pytest.raises(WorkError, match=r"simulate: the states are no longer finite at frame"):
        model.simulate(20, 2)
    drawn = model.sample_prior((20, 2), 2)
    assert not drawn.states[:, :, -1].isfinite().any()
    assert drawn.states[:, :, :4].isfinite().all()


ONES = torch.ones(2, 5, 3, dtype=torch.bool)
GRAPH = torch.zeros(2, 5, 3, 3)
SEEN = torch.zeros(2, 5, 3, 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((SEEN[0], ONES, GRAPH), r"observations: they must be .* and are \(5, 3, 2\) of"),
        ((SEEN.long(), ONES, GRAPH), r"of floats, and are \(2, 5, 3, 2\) of torch.int64"),
        ((SEEN, ONES[:, 1:], GRAPH), r"mask: its shape must be \(2, 5, 3\) .* it is \(2, 4, 3\)"),
        ((SEEN, ONES, GRAPH[:1]), r"adjacency: its shape must be \(2, 5, 3, 3\) .* \(1, 5, 3, 3\)"),
        ((SEEN, ONES, EdgeList.from_dense(GRAPH[:1])), r"must be \(2, 5, 3\) .* it is \(1, 5, 3\)"),
        ((SEEN, ONES, GRAPH, torch.ones(2, 4, 1)), r"controls: .* \(2, 5, 1\) .* \(2, 4, 1\)"),
        ((SEEN, ONES, None), "adjacency: it must be a tensor, not NoneType"),
        (
            (SEEN.index_fill(2, torch.tensor([1]), math.nan), ONES, GRAPH),
            r"that of \(batch, time, individual\) = \(0, 0, 1\) is not finite",
        ),
    ],
)
def test_windows_that_do_not_go_together_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        SwarmBatch.of(*arguments)


def test_what_was_not_seen_may_be_nan():
    mask = ONES.clone()
    mask[1, 2, 0] = False
    hidden = SEEN.masked_fill(~mask.unsqueeze(-1), math.nan)
    batch = SwarmBatch.of(hidden, mask, GRAPH)
    assert (batch.observations == 0).all()
    assert batch.present.all()
