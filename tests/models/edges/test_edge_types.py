"""Types of edges as random variables."""

import itertools
import math

import pytest
import torch

from swarmssm.models.edges import EdgeTypes
from swarmssm.models.edges.types import PosteriorEdgeTypes
from swarmssm.models.relational import pairs_of


def two(logits, **options):
    """Two individuals in one frame: the pairs (0, 1) and (1, 0)."""
    wide = torch.zeros(1, 2, 2, logits.shape[-1]).to(logits)
    wide[0, 0, 1], wide[0, 1, 0] = logits[0], logits[1]
    return EdgeTypes(wide, pairs_of(torch.ones(1, 2, dtype=torch.bool)), **options)


def one_hot(first, second, types):
    value = torch.zeros(1, 2, 2, types, dtype=torch.float64)
    value[0, 0, 1, first] = value[0, 1, 0, second] = 1.0
    return value


P = torch.tensor([[0.2, 0.3, 0.5], [0.6, 0.3, 0.1]], dtype=torch.float64)
Q = torch.tensor([[0.1, 0.8, 0.1], [0.3, 0.3, 0.4]], dtype=torch.float64)


def test_the_score_by_hand():
    law = two(P.log() + 7.0)
    assert law.batch_shape == ()
    assert law.event_shape == (1, 2, 2, 3)
    assert float(law.log_prob(one_hot(2, 0, 3))) == pytest.approx(math.log(0.5) + math.log(0.6))
    # What stands where there is no pair does not count.
    value = one_hot(2, 0, 3)
    value[0, 0, 0, 1] = 1.0
    assert float(law.log_prob(value)) == pytest.approx(math.log(0.3))


def test_the_divergence_by_hand():
    expected = float((Q * (Q / P).log()).sum())
    assert float(two(Q.log()).divergence(two(P.log()))) == pytest.approx(expected)


def test_an_integrated_posterior_has_the_elbo_of_a_drawn_one_in_the_mean_of_all_draws():
    posterior, prior = two(Q.log()), two(P.log())
    integrated = PosteriorEdgeTypes(posterior, prior)
    drawn, terms = 0.0, set()
    for first, second in itertools.product(range(3), repeat=2):
        value = one_hot(first, second, 3)
        chance = float(Q[0, first] * Q[1, second])
        drawn += chance * float(prior.log_prob(value) - posterior.log_prob(value))
        terms.add(round(float(prior.log_prob(value) - integrated.log_prob(value)), 12))
    assert terms == {round(drawn, 12)}


def test_draws_are_one_hot_and_as_frequent_as_their_probabilities():
    law, number = two(P.log()), 20_000
    torch.manual_seed(0)
    drawn = law.rsample((number,))
    assert set(drawn.unique().tolist()) == {0.0, 1.0}
    assert not drawn[:, 0, [0, 1], [0, 1]].any()
    found = torch.stack([drawn[:, 0, 0, 1], drawn[:, 0, 1, 0]]).mean(1)
    spread = (P * (1 - P) / number).sqrt()
    assert ((found - P).abs() < 6 * spread).all()
    assert torch.allclose(law.mean[0, 0, 1], P[0])
    assert law.mode[0, 0, 1].tolist() == [0, 0, 1]


def test_gradients_flow_through_draws_and_relaxed_ones_are_not_one_hot():
    logits = P.log().clone().requires_grad_()
    torch.manual_seed(0)
    for kind in ("straight-through", "relaxed"):
        relaxed = kind == "relaxed"
        law = two(logits, gradient=kind)
        value = law.rsample()
        (gradient,) = torch.autograd.grad(value[0, 0, 1, 2], logits)
        assert gradient[0, 2] > 0
        assert gradient[0, 0] < 0
        assert not gradient[1].any()
        assert float(value[0, 0, 1].sum().detach()) == pytest.approx(1.0)
        assert ((value > 0) & (value < 1)).any() == relaxed
        assert set(law.sample().unique().tolist()) == {0.0, 1.0}


def test_conditional_draws_have_the_gradient_of_log_q_and_scores_none():
    logits = P.log().clone().requires_grad_()
    law = two(logits)
    value = law.rsample()
    assert set(value.detach().unique().tolist()) == {0.0, 1.0}
    weights = torch.tensor([0.2, 0.5, 0.3], dtype=torch.float64)
    (gradient,) = torch.autograd.grad((weights * value[0, 0, 1]).sum(), logits)
    # Of a cross-entropy: target minus probability.
    assert torch.allclose(gradient[0], weights - P[0])
    posterior = PosteriorEdgeTypes(law, two(Q.log()))
    for integrated in (True, False):
        posterior.integrated = integrated
        assert not posterior.log_prob(value).requires_grad
    assert float(posterior.log_prob(value)) == pytest.approx(float(law.log_prob(value).detach()))


def test_scores_that_are_not_normalised_are_taken_as_they_stand():
    half = 0.5 * (P.log() + Q.log())
    law = two(half, normalized=False)
    assert float(law.log_prob(one_hot(0, 0, 3))) == pytest.approx(float(half[0, 0] + half[1, 0]))
    assert torch.allclose(law.mean[0, 0, 1], half[0].softmax(-1))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="frame, individual, neighbor, type"):
        EdgeTypes(torch.zeros(1, 2, 2, 3), torch.ones(2, 2, dtype=torch.bool))
