"""Linear recurrences against the same written as a loop."""

import itertools

import pytest
import torch

from swarmssm.models.scans import gated_scan, linear_scan, projective_scan

DOUBLE = torch.float64


def drawn(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, dtype=DOUBLE, generator=generator)


def loop(gain, shift, reverse):
    """The recurrence as it is defined."""
    order = list(range(len(shift)))[:: -1 if reverse else 1]
    states = {order[0]: shift[order[0]]}
    for before, t in itertools.pairwise(order):
        if gain.dim() > shift.dim():
            states[t] = (gain[t] @ states[before].unsqueeze(-1)).squeeze(-1) + shift[t]
        else:
            states[t] = gain[t] * states[before] + shift[t]
    return torch.stack([states[t] for t in range(len(shift))])


CASES = [((5, 3, 2), (5, 3, 2)), ((5, 3, 2, 2), (5, 3, 2)), ((6,), (6,)), ((1, 3, 2, 2), (1, 3, 2))]


@pytest.mark.parametrize("shapes", CASES, ids=str)
@pytest.mark.parametrize("reverse", [False, True])
def test_the_scan_is_the_loop(shapes, reverse):
    gain, shift = (drawn(*shape, seed=place).requires_grad_() for place, shape in enumerate(shapes))
    expected, actual = loop(gain, shift, reverse), linear_scan(gain, shift, reverse=reverse)
    torch.testing.assert_close(actual, expected, rtol=1e-12, atol=1e-12)
    weight = drawn(*shift.shape, seed=7)
    wanted = torch.autograd.grad((expected * weight).sum(), [gain, shift], allow_unused=True)
    found = torch.autograd.grad((actual * weight).sum(), [gain, shift])
    for a, b in zip(found, wanted, strict=True):
        torch.testing.assert_close(
            a, torch.zeros_like(a) if b is None else b, rtol=1e-12, atol=1e-12
        )


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("shapes", CASES[:2], ids=str)
def test_derivatives_of_both_orders(shapes, reverse):
    inputs = [drawn(*shape, seed=place).requires_grad_() for place, shape in enumerate(shapes)]

    def scan(gain, shift):
        return linear_scan(gain, shift, reverse=reverse)

    assert torch.autograd.gradcheck(scan, inputs)
    assert torch.autograd.gradgradcheck(scan, inputs)


@pytest.mark.parametrize("reverse", [False, True])
def test_ratios_and_their_derivatives_are_those_of_the_product(reverse):
    gain = drawn(6, 3, 4, 4).abs().requires_grad_()
    first = torch.cat([torch.ones(3, 1, dtype=DOUBLE), drawn(3, 3, seed=1).abs()], -1)
    first.requires_grad_()
    edge = [first.unsqueeze(0), first.new_zeros(5, 3, 4)]
    plain = loop(gain, torch.cat(edge[::-1] if reverse else edge), reverse)
    scaled = projective_scan(gain, first, reverse=reverse)
    torch.testing.assert_close(scaled[..., 0], torch.ones(6, 3, dtype=DOUBLE))
    ratios = [x[..., 1:] / x[..., :1] for x in (scaled, plain)]
    torch.testing.assert_close(*ratios, rtol=1e-12, atol=1e-12)
    weight = drawn(6, 3, 3, seed=2)
    gradients = [torch.autograd.grad((r * weight).sum(), [gain, first]) for r in ratios]
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-10, atol=1e-10)


def test_a_long_product_neither_overflows_nor_vanishes():
    for size in (1e-3, 1e3):
        gain = torch.full((2000, 1, 2, 2), size)
        ratios = projective_scan(gain, torch.tensor([[1.0, 5.0]]))
        torch.testing.assert_close(ratios[1:], torch.ones(1999, 1, 2))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"\(5, 3, 2\), and it is \(5, 3, 1\)"):
        linear_scan(drawn(5, 3, 1), drawn(5, 3, 2))


@pytest.mark.parametrize("is_masked", [False, True])
def test_gates_both_ways(is_masked: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    told = torch.randn(7, 3, 2, 12, generator=generator, dtype=torch.float64, requires_grad=True)
    there = (torch.rand(7, 3, 2, 1, generator=generator) > 0.3).double() if is_masked else None
    gate, candidate = told.chunk(2, -1)
    gate = gate.sigmoid() * (1.0 if there is None else there)
    learned = gate * candidate.tanh()
    wanted = torch.cat(
        [
            linear_scan(1.0 - gate[..., :3], learned[..., :3]),
            linear_scan(1.0 - gate[..., 3:], learned[..., 3:], reverse=True),
        ],
        -1,
    )
    torch.testing.assert_close(gated_scan(told, there), wanted)
    assert torch.autograd.gradcheck(lambda values: gated_scan(values, there), told)
