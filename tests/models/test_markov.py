"""The path distribution against hand-written densities, a dense Gaussian and its own moments."""

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import Predictive

from swarmssm.graphs import EdgeList, neighbor_sum
from swarmssm.models import MarkovChain, StepInputs

DOUBLE = torch.float64
STEPS, INDIVIDUALS = 4, 3
MATRIX = torch.tensor([[1.0, 0.1], [-0.2, 0.9]], dtype=DOUBLE)
NOISE = 0.3


def initial(mean=0.5):
    return dist.Normal(torch.full((2,), mean, dtype=DOUBLE), 1.5).to_event(1)


def linear(states, inputs):
    """Each individual on its own: z' = F z + noise."""
    return dist.Normal(states @ MATRIX.T, NOISE).to_event(1)


def coupled(states, inputs):
    """Each individual is drawn to those it sees, and all feel the control."""
    pull = inputs.adjacency @ states
    push = 0.0 if inputs.controls is None else inputs.controls.unsqueeze(-2)
    return dist.Normal(0.8 * states + 0.1 * pull + push, NOISE).to_event(1)


def rand(*shape, seed=0):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


def test_a_linear_chain_has_the_density_of_one_dense_gaussian():
    """Mean and covariance of [z_1, ..., z_T] of an individual, stacked by hand."""
    chain = MarkovChain(initial(), linear, STEPS, INDIVIDUALS)
    assert chain.batch_shape == ()
    assert chain.event_shape == (STEPS, INDIVIDUALS, 2)
    matrix = MATRIX.numpy()
    powers = [np.linalg.matrix_power(matrix, k) for k in range(STEPS)]
    mean = np.concatenate([p @ [0.5, 0.5] for p in powers])
    covariance = np.zeros((2 * STEPS, 2 * STEPS))
    for i in range(STEPS):
        for j in range(STEPS):
            block = powers[i] @ (2.25 * np.eye(2)) @ powers[j].T
            for k in range(1, min(i, j) + 1):
                block += NOISE**2 * powers[i - k] @ powers[j - k].T
            covariance[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
    joint = torch.distributions.MultivariateNormal(
        torch.from_numpy(mean), torch.from_numpy(covariance)
    )
    paths = rand(5, STEPS, INDIVIDUALS, 2)
    expected = joint.log_prob(paths.transpose(1, 2).reshape(5, INDIVIDUALS, -1)).sum(-1)
    torch.testing.assert_close(chain.log_prob(paths), expected, rtol=1e-10, atol=0)

    number = 20_000
    pyro.set_rng_seed(1)
    drawn = chain.sample((number,)).transpose(1, 2).reshape(number * INDIVIDUALS, -1).numpy()
    deviation = np.sqrt(np.diag(covariance))
    count = len(drawn)
    assert (np.abs(drawn.mean(0) - mean) < 6 * deviation / np.sqrt(count)).all()
    # The variance of a product of two Gaussians is at most twice that of their squares.
    spread = np.outer(deviation, deviation) * np.sqrt(2 / count)
    assert (np.abs(np.cov(drawn.T) - covariance) < 6 * spread).all()


def test_graph_and_controls_are_those_of_each_step():
    graphs = (rand(2, STEPS - 1, INDIVIDUALS, INDIVIDUALS, seed=1) > 0).to(DOUBLE)
    controls = rand(2, STEPS - 1, 2, seed=2)
    chain = MarkovChain(initial(), coupled, STEPS, INDIVIDUALS, inputs=StepInputs(graphs, controls))
    assert chain.batch_shape == (2,)
    path = rand(2, STEPS, INDIVIDUALS, 2, seed=3)
    expected = initial().log_prob(path[:, 0]).sum(-1)
    for t in range(STEPS - 1):
        centre = 0.8 * path[:, t] + 0.1 * graphs[:, t] @ path[:, t] + controls[:, t, None]
        step = dist.Normal(centre, NOISE).log_prob(path[:, t + 1])
        expected = expected + step.sum((-1, -2))
    torch.testing.assert_close(chain.log_prob(path), expected, rtol=1e-12, atol=0)


def test_the_transition_is_asked_once_for_all_steps():
    calls = []

    def counting(states, inputs):
        calls.append(tuple(states.shape))
        return linear(states, inputs)

    chain = MarkovChain(initial(), counting, STEPS, INDIVIDUALS)
    chain.log_prob(rand(7, STEPS, INDIVIDUALS, 2))
    assert calls == [(7, STEPS - 1, INDIVIDUALS, 2)]


@pytest.fixture
def coming_and_going():
    """Individual 0 always there, 1 from frame 2 on, 2 away in frame 1."""
    present = torch.ones(STEPS, INDIVIDUALS, dtype=torch.bool)
    present[:2, 1] = False
    present[1, 2] = False
    return MarkovChain(initial(), linear, STEPS, INDIVIDUALS, mask=present), present


def test_who_comes_is_scored_by_the_initial_distribution(coming_and_going):
    chain, _ = coming_and_going
    path = rand(STEPS, INDIVIDUALS, 2, seed=4)
    step = dist.Normal(path[:-1] @ MATRIX.T, NOISE).log_prob(path[1:]).sum(-1)
    first = initial().log_prob(path)
    expected = first[0, 0] + step[:, 0].sum()
    expected += first[2, 1] + step[2, 1]
    expected += first[0, 2] + first[2, 2] + step[2, 2]
    torch.testing.assert_close(chain.log_prob(path), expected, rtol=1e-12, atol=0)


def test_what_stands_at_absent_individuals_says_nothing(coming_and_going):
    chain, present = coming_and_going
    path = rand(STEPS, INDIVIDUALS, 2, seed=5)
    other = torch.where(present.unsqueeze(-1), path, torch.full_like(path, 1e3))
    assert torch.equal(chain.log_prob(path), chain.log_prob(other))
    drawn = chain.sample((4,))
    assert (drawn[:, ~present] == 0).all()
    assert (drawn[:, present] != 0).all()


def test_it_works_in_plates_and_predictive_and_expands():
    def model():
        with pyro.plate("windows", 6, dim=-1):
            return pyro.sample("states", MarkovChain(initial(), linear, STEPS, INDIVIDUALS))

    trace = pyro.poutine.trace(model).get_trace()
    site = trace.nodes["states"]
    assert site["value"].shape == (6, STEPS, INDIVIDUALS, 2)
    again = pyro.poutine.trace(pyro.poutine.replay(model, trace=trace)).get_trace()
    chain = MarkovChain(initial(), linear, STEPS, INDIVIDUALS)
    expected = chain.log_prob(site["value"]).sum()
    torch.testing.assert_close(again.log_prob_sum(), expected, rtol=1e-12, atol=0)
    drawn = Predictive(model, num_samples=3)()["states"]
    assert drawn.shape == (3, 6, STEPS, INDIVIDUALS, 2)
    wide = chain.expand((5, 1)).expand((5, 2))
    assert wide.batch_shape == (5, 2)
    path = rand(5, 2, STEPS, INDIVIDUALS, 2, seed=6)
    torch.testing.assert_close(wide.log_prob(path), chain.log_prob(path), rtol=1e-12, atol=0)


def test_gradients_reach_the_transition_through_the_draws():
    scale = torch.tensor(NOISE, dtype=DOUBLE, requires_grad=True)
    chain = MarkovChain(
        initial(),
        lambda states, inputs: dist.Normal(states @ MATRIX.T, scale).to_event(1),
        STEPS,
        INDIVIDUALS,
    )
    pyro.set_rng_seed(0)
    chain.rsample()[1:].sum().backward()
    at = scale.detach()
    sums = []
    for value in (at - 1e-6, at + 1e-6):
        pyro.set_rng_seed(0)
        with torch.no_grad():
            scale.copy_(value)
            sums.append(chain.rsample()[1:].sum())
    slope = (sums[1] - sums[0]) / 2e-6
    # The draw is linear in the scale: the difference quotient has rounding errors alone.
    torch.testing.assert_close(scale.grad, slope, rtol=1e-7, atol=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"initial": dist.Normal(0.0, 1.0)}, r"event shape \(state,\), and it is \(\)"),
        ({"num_steps": 0}, "num_steps must be at least 1, and it is 0"),
        (
            {"mask": torch.ones(3, 3, dtype=torch.bool)},
            r"\(time, individual\) = \(4, 3\), and its shape is \(3, 3\)",
        ),
        (
            {"inputs": StepInputs(controls=torch.zeros(4, 2))},
            r"controls must end in \(step, control\) = \(3, 2\), and its shape is \(4, 2\)",
        ),
    ],
)
def test_shapes_that_do_not_fit_are_named(change, message):
    arguments = {
        "initial": initial(),
        "transition": linear,
        "num_steps": STEPS,
        "num_individuals": INDIVIDUALS,
    }
    with pytest.raises(ValueError, match=message):
        MarkovChain(**{**arguments, **change})


SPARSE = EdgeList.from_dense(torch.ones(2, STEPS - 1, INDIVIDUALS, INDIVIDUALS))


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        (
            StepInputs(torch.ones(STEPS, INDIVIDUALS, INDIVIDUALS)),
            r"adjacency must end in \(step, individual, individual\) = \(3, 3, 3\), and .* \(4, 3",
        ),
        (StepInputs(torch.ones(STEPS - 1, 2, 2)), r"\(3, 3, 3\), and its shape is \(3, 2, 2\)"),
        (StepInputs(SPARSE.select(1, 0, 2)), r"\(3, 3, 3\), and its shape is \(2, 2, 3, 3\)"),
        (
            StepInputs(EdgeList.from_dense(torch.ones(STEPS - 1, 2, 2))),
            r"\(3, 3, 3\), and its shape is \(3, 2, 2\)",
        ),
        (
            StepInputs(present=torch.ones(STEPS - 1, 2, dtype=torch.bool)),
            r"present must end in \(step, individual\) = \(3, 3\), and its shape is \(3, 2\)",
        ),
    ],
)
def test_inputs_of_another_size_are_named(inputs, message):
    with pytest.raises(ValueError, match=message):
        MarkovChain(initial(), linear, STEPS, INDIVIDUALS, inputs=inputs)


def test_first_states_of_another_number_of_individuals_are_refused():
    many = dist.Normal(torch.zeros(2, 2), 1.0).to_event(1)
    with pytest.raises(ValueError, match=r"with 3 individuals or 1, and it is \(2,\)"):
        MarkovChain(many, linear, STEPS, INDIVIDUALS)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (lambda z, u: dist.Normal(z, 1.0), r"this one has \(2, 3, 3, 2\) and \(\); \.to_event"),
        (lambda z, u: dist.Normal(z[..., :1], 1.0).to_event(1), r"has \(2, 3, 3\) and \(1,\)"),
        (lambda z, u: dist.Normal(z[..., :2, :], 1.0).to_event(1), r"has \(2, 3, 2\) and \(2,\)"),
        (lambda z, u: dist.Normal(z, 1.0).to_event(2), r"this one has \(2, 3\) and \(3, 2\)"),
    ],
)
def test_a_transition_of_another_shape_is_refused_with_both(step, message):
    chain = MarkovChain(initial(), step, STEPS, INDIVIDUALS)
    with pytest.raises(ValueError, match=message):
        chain.log_prob(rand(2, STEPS, INDIVIDUALS, 2))
    with pytest.raises(ValueError, match=r"batch shape \(..., individual\) = \(3,\) and event"):
        chain.sample()


def test_a_list_of_edges_gives_the_numbers_of_its_matrix():
    matrix = (rand(2, STEPS - 1, INDIVIDUALS, INDIVIDUALS, seed=1) > 0).to(DOUBLE)

    def pulled(states, inputs):
        pull = neighbor_sum(states, inputs.adjacency)
        return dist.Normal(0.8 * states + 0.1 * pull, NOISE).to_event(1)

    chains = [
        MarkovChain(initial(), pulled, STEPS, INDIVIDUALS, inputs=StepInputs(graph))
        for graph in (matrix, EdgeList.from_dense(matrix))
    ]
    path = rand(5, 2, STEPS, INDIVIDUALS, 2, seed=3)
    scores = [chain.log_prob(path) for chain in chains]
    torch.testing.assert_close(*scores, rtol=1e-12, atol=0)
    draws = []
    for chain in chains:
        assert chain.batch_shape == (2,)
        pyro.set_rng_seed(0)
        draws.append(chain.rsample((5,)))
    torch.testing.assert_close(*draws, rtol=1e-12, atol=1e-14)
    assert torch.equal(chains[1].inputs.at(1).adjacency.to_dense(DOUBLE), matrix[:, 1])
    dense = chains[1].inputs.dense().adjacency
    assert torch.equal(dense.to(DOUBLE), matrix)


def test_inputs_go_through_rows_and_back():
    """As a linearisation takes them: one leading dimension, and put together again."""
    graph = (rand(STEPS - 1, INDIVIDUALS, INDIVIDUALS) > 0).to(DOUBLE)
    present = torch.ones(2, 1, INDIVIDUALS, dtype=torch.bool)
    inputs = StepInputs(graph, None, present)
    rows = inputs.tensors((2, STEPS - 1))
    assert [tuple(row.shape) for row in rows] == [(6, 3, 3), (6, 3)]
    assert torch.equal(rows[0].reshape(2, STEPS - 1, 3, 3), graph.expand(2, STEPS - 1, 3, 3))
    one = inputs.rebuild([row[4] for row in rows])
    assert torch.equal(one.adjacency, graph[1])
    assert one.controls is None
    assert one.present.shape == (INDIVIDUALS,)


def test_draws_that_cannot_be_differentiated_are_made_all_the_same():
    def mixture(states, inputs):
        centres = torch.stack([states - 1.0, states + 1.0], -2)
        weights = dist.Categorical(torch.ones_like(states))
        return dist.MixtureSameFamily(weights, dist.Normal(centres, 0.1).to_event(1))

    chain = MarkovChain(initial(), mixture, STEPS, INDIVIDUALS)
    drawn = chain.sample((100,))
    assert chain.log_prob(drawn).isfinite().all()
    moved = drawn.diff(dim=1)
    assert ((moved.abs() - 1).abs() < 0.7).all()
    assert chain().shape == (STEPS, INDIVIDUALS, 2)


def test_one_frame_has_no_steps():
    chain = MarkovChain(initial(), linear, 1, INDIVIDUALS, inputs=StepInputs(torch.ones(0, 3, 3)))
    path = rand(5, 1, INDIVIDUALS, 2)
    expected = initial().log_prob(path[:, 0]).sum(-1)
    torch.testing.assert_close(chain.log_prob(path), expected, rtol=1e-12, atol=0)
    assert chain.sample().shape == (1, INDIVIDUALS, 2)


def test_a_path_of_another_shape_is_refused_with_both_shapes():
    chain = MarkovChain(initial(), linear, STEPS, INDIVIDUALS, validate_args=True)
    with pytest.raises(ValueError, match=r"\(4, 3, 2\), and its shape is \(2, 3, 2\)"):
        chain.log_prob(rand(2, INDIVIDUALS, 2))
