"""Hold draws of edges to their distribution, and divergences to numbers worked by hand."""

import math

import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.models.relational import categorical_kl, sample_edges, sparse_logits

SHARES = torch.tensor([0.6, 0.3, 0.1], dtype=torch.float64)


@pytest.mark.parametrize("temperature", [0.1, 0.5, 5.0])
def test_hard_draws_are_categorical_at_any_temperature(temperature):
    """The share of a type among n draws has a standard deviation of sqrt(p (1 - p) / n)."""
    n = 20_000
    generator = torch.Generator().manual_seed(0)
    logits = SHARES.log().expand(n, 3)
    drawn = sample_edges(logits, temperature, hard=True, generator=generator)
    assert set(drawn.round(decimals=12).unique().tolist()) == {0.0, 1.0}
    error = (drawn.mean(0) - SHARES).abs()
    assert (error < 6 * (SHARES * (1 - SHARES) / n).sqrt()).all()


def test_relaxed_draws_have_the_concrete_distribution():
    """The largest entry is the type drawn, and logs of ratios are those of logits and noise.

    The difference of two Gumbel draws is logistic, of variance pi ** 2 / 3 and fourth central
    moment 7 pi ** 4 / 15.
    """
    n, temperature = 20_000, 0.7
    generator = torch.Generator().manual_seed(1)
    drawn = sample_edges(SHARES.log().expand(n, 3), temperature, generator=generator)
    torch.testing.assert_close(drawn.sum(-1), torch.ones(n, dtype=torch.float64))
    chosen = torch.nn.functional.one_hot(drawn.argmax(-1), 3).double().mean(0)
    assert ((chosen - SHARES).abs() < 6 * (SHARES * (1 - SHARES) / n).sqrt()).all()
    ratio = temperature * (drawn[:, 0] / drawn[:, 1]).log() - math.log(2.0)
    variance = math.pi**2 / 3
    assert abs(ratio.mean()) < 6 * math.sqrt(variance / n)
    spread = math.sqrt((7 * math.pi**4 / 15 - variance**2) / n)
    assert abs(ratio.square().mean() - variance) < 6 * spread


def test_a_hard_draw_has_the_gradient_of_the_relaxed_one():
    weight = torch.tensor([1.0, -2.0, 0.5])
    gradients = []
    for hard in (False, True):
        logits = torch.tensor([[0.3, -0.2, 0.1]], requires_grad=True)
        generator = torch.Generator().manual_seed(3)
        (sample_edges(logits, 0.5, hard=hard, generator=generator) * weight).sum().backward()
        gradients.append(logits.grad)
    assert gradients[0].abs().min() > 0
    torch.testing.assert_close(*gradients)


def test_draws_follow_their_generator_and_leave_the_global_one():
    logits = torch.zeros(5, 4)
    state = torch.get_rng_state()
    one, two = (sample_edges(logits, generator=torch.Generator().manual_seed(7)) for _ in range(2))
    assert (one == two).all()
    assert (torch.get_rng_state() == state).all()
    assert torch.isfinite(sample_edges(torch.tensor([[200.0, -200.0]]), 0.01).log()[..., 0]).all()
    with pytest.raises(InputError, match="temperature: it must be above 0, and it is 0"):
        sample_edges(logits, 0.0)


def test_divergences_by_hand():
    """Of (3/4, 1/4) from (1/2, 1/2): 3/4 log 3/2 + 1/4 log 1/2."""
    q = torch.tensor([0.75, 0.25]).log()
    expected = 0.75 * math.log(1.5) + 0.25 * math.log(0.5)
    assert categorical_kl(q + 3.0, torch.zeros(2)).item() == pytest.approx(expected, rel=1e-6)
    assert categorical_kl(q, q - 1.0).item() == pytest.approx(0.0, abs=1e-7)
    several = categorical_kl(q.expand(4, 5, 2), torch.zeros(5, 2))
    assert several.shape == (4, 5)
    certain = categorical_kl(torch.tensor([0.0, -1e4]), torch.zeros(2))
    assert certain.item() == pytest.approx(math.log(2.0), rel=1e-6)


def test_a_sparse_prior():
    expected = torch.tensor([0.9, 0.05, 0.05])
    torch.testing.assert_close(sparse_logits(3, 0.9).exp(), expected)
    torch.testing.assert_close(sparse_logits(4).exp(), torch.full((4,), 0.25))
    with pytest.raises(InputError, match="edge_types: there must be at least 2"):
        sparse_logits(1)
    with pytest.raises(InputError, match="no_edge: it must be between 0 and 1"):
        sparse_logits(2, 1.0)
