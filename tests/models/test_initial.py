"""First states."""

from dataclasses import replace

import pyro
import pyro.distributions as dist
import pytest
import torch

from swarmssm.errors import InputError
from swarmssm.models import InitialStates, Scales

SCALES = Scales(
    space=2,
    individuals=3,
    dt=0.1,
    centre=(5.0, -2.0),
    low=(0.0, -4.0),
    high=(10.0, 0.0),
    length=3.0,
    speed=0.7,
    slow=0.1,
    fast=1.0,
    spacing=1.0,
    step=0.1,
    noise=0.01,
)


def test_each_feature_is_normal():
    initial = InitialStates([0.0, 1.0], [1.0, 2.0])()
    assert (initial.batch_shape, initial.event_shape) == ((), (2,))
    value = torch.tensor([[0.5, 0.5], [1.0, 2.0]])
    expected = dist.Normal(value.new_tensor([0.0, 1.0]), value.new_tensor([1.0, 2.0]))
    torch.testing.assert_close(initial.log_prob(value), expected.log_prob(value).sum(-1))
    own = InitialStates(torch.zeros(3, 4), torch.ones(4))()
    assert (own.batch_shape, own.event_shape) == ((3,), (4,))


def test_those_of_tracks_are_wide():
    initial = InitialStates.for_scales(SCALES)()
    assert torch.equal(initial.mean, torch.tensor([5.0, -2.0, 0.0, 0.0]))
    assert torch.equal(initial.stddev, torch.tensor([10.0, 10.0, 0.7, 0.7]))
    cube = replace(SCALES, space=3, centre=(0.0,) * 3, low=(0.0,) * 3, high=(1.0, 2.0, 1.0))
    assert InitialStates.for_scales(cube)().stddev.tolist() == pytest.approx([2.0] * 3 + [0.7] * 3)


def test_those_of_an_individual_at_rest_have_a_density():
    still = replace(SCALES, low=(5.0, -2.0), high=(5.0, -2.0), speed=0.0, noise=0.0)
    initial = InitialStates.for_scales(still)()
    assert initial.log_prob(torch.tensor([5.0, -2.0, 0.0, 0.0])).isfinite()


def test_its_numbers_may_be_random():
    part = InitialStates(dist.Normal(torch.zeros(4), 1.0), dist.LogNormal(torch.zeros(4), 1.0))
    trace = pyro.poutine.trace(part).get_trace()
    assert trace.nodes["mean"]["value"].shape == trace.nodes["scale"]["value"].shape == (4,)


@pytest.mark.parametrize(
    ("mean", "scale", "message"),
    [
        (0.0, [1.0], r"mean: it must be \(any number,\) or .* in shape, and it is \(\)"),
        ([0.0], [0.0], r"scale: it must be positive, and it is \[0\]"),
        ([0.0, 0.0], [1.0, 1.0, 1.0], r"mean has 2 features and scale 3"),
    ],
)
def test_what_cannot_be_is_refused(mean, scale, message):
    with pytest.raises(InputError, match=message):
        InitialStates(mean, scale)()
