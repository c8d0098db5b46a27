"""Hold the thesis's encoder against its equations, and against relabelled groups."""

import dataclasses
import math

import pytest
import torch
from pyro import poutine

from swarmssm.graphs import normalized_adjacency
from swarmssm.inference import GUIDES, GraphEncoderGuide, find_guide
from swarmssm.models import GraphVAE, SwarmBatch

DOUBLE = torch.float64
CLOSE = {"rtol": 1e-10, "atol": 1e-12}


def rand(*shape, seed):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


@pytest.fixture
def guide():
    torch.manual_seed(0)
    return GraphEncoderGuide(4, latent_dim=3, widths=(6, 5, 4), rounds=2).to(DOUBLE)


@pytest.fixture
def batch():
    """Three windows of five frames with six individuals, who are not always there."""
    mask = rand(3, 5, 6, seed=1) > -1.0
    mask[1, :, 2] = False
    adjacency = (rand(3, 5, 6, 6, seed=2) > 0).to(DOUBLE)
    adjacency *= mask.unsqueeze(-1) & mask.unsqueeze(-2)
    adjacency.diagonal(dim1=-2, dim2=-1).zero_()
    observations = rand(3, 5, 6, 4, seed=3) * mask.unsqueeze(-1)
    weight = torch.tensor([1.0, 0.5, 2.0], dtype=DOUBLE)
    batch = SwarmBatch.of(observations, mask, adjacency)
    return dataclasses.replace(batch, window_weight=weight, population=6)


def test_encoder_is_the_written_one(guide, batch):
    """(3.50) to (3.56) from the layers, which have tests of their own."""
    states, adjacency = batch.observations, batch.adjacency
    graph = normalized_adjacency(adjacency)
    hidden = guide.gated(states, adjacency)
    hidden = torch.tanh(guide.second(hidden, graph))
    hidden = torch.tanh(guide.third(hidden, graph))
    posterior = guide.encode(states, adjacency)
    assert posterior.mean.shape == (3, 5, 6, 3)
    torch.testing.assert_close(posterior.mean, guide.mean(hidden, graph), **CLOSE)
    variance = guide.log_variance(hidden, graph).exp()
    torch.testing.assert_close(posterior.variance, variance, **CLOSE)


def test_each_frame_is_encoded_from_itself_alone(guide, batch):
    whole = guide.encode(batch.observations, batch.adjacency)
    frame = guide.encode(batch.observations[2, 3], batch.adjacency[2, 3])
    torch.testing.assert_close(frame.mean, whole.mean[2, 3], **CLOSE)
    torch.testing.assert_close(frame.stddev, whole.stddev[2, 3], **CLOSE)


def test_relabelling_individuals_relabels_the_posterior(guide, batch):
    order = torch.tensor([3, 0, 5, 1, 4, 2])
    before = guide.encode(batch.observations, batch.adjacency)
    after = guide.encode(batch.observations[:, :, order], batch.adjacency[:, :, order][..., order])
    torch.testing.assert_close(after.mean, before.mean[:, :, order], **CLOSE)
    torch.testing.assert_close(after.stddev, before.stddev[:, :, order], **CLOSE)


def test_who_sees_nobody_depends_on_nobody(guide, batch):
    adjacency = batch.adjacency.clone()
    adjacency[..., 4, :] = 0.0
    before = guide.encode(batch.observations, adjacency)
    other = batch.observations.clone()
    other[..., :4, :] += 1.0
    after = guide.encode(other, adjacency)
    # Not bit for bit: a product of matrices adds up its zeros in any order.
    torch.testing.assert_close(after.mean[..., 4, :], before.mean[..., 4, :], **CLOSE)
    assert (after.mean[..., :4, :] - before.mean[..., :4, :]).abs().amin() > 1e-9


def test_the_absent_reach_nobody(guide, batch):
    """Neither seats that nobody takes, nor what stands at the places of the absent."""
    seen = batch.mask.unsqueeze(-1)
    before = guide.encode(batch.observations, batch.adjacency)
    changed = torch.where(seen, batch.observations, 100 * rand(3, 5, 6, 4, seed=4))
    pad = torch.nn.functional.pad
    larger = guide.encode(pad(changed, (0, 0, 0, 2), value=7.0), pad(batch.adjacency, (0, 2, 0, 2)))
    for name in ("mean", "stddev"):
        one, other = getattr(before, name), getattr(larger, name)[:, :, :6]
        torch.testing.assert_close(one.masked_fill(~seen, 0), other.masked_fill(~seen, 0), **CLOSE)


def test_log_density_of_the_guide(guide, batch):
    """Normal of all that are seen at both ends of a step, weighed as in the model."""
    trace = poutine.trace(guide).get_trace(batch)
    latent = trace.nodes["states"]["value"]
    posterior = guide.encode(batch.observations[:, :-1], batch.adjacency[:, :-1])
    mean, sd = posterior.mean, posterior.stddev
    each = -0.5 * ((latent - mean) / sd) ** 2 - sd.log() - 0.5 * math.log(2 * math.pi)
    both = (batch.mask[:, :-1] & batch.mask[:, 1:]).unsqueeze(-1)
    windows = (each * both).sum((1, 2, 3))
    expected = 6 / 3 * (windows * batch.window_weight).sum()
    torch.testing.assert_close(trace.log_prob_sum(), expected, rtol=1e-10, atol=0)


def test_draws_are_reparameterised(guide, batch):
    """(3.59): the mean plus a multiple of the noise, so that gradients pass through a draw."""
    torch.manual_seed(5)
    latent = poutine.trace(guide).get_trace(batch).nodes["states"]["value"]
    torch.manual_seed(5)
    noise = torch.randn(3, 4, 6, 3, dtype=DOUBLE)
    posterior = guide.encode(batch.observations[:, :-1], batch.adjacency[:, :-1])
    torch.testing.assert_close(latent, posterior.mean + posterior.stddev * noise, **CLOSE)
    assert latent.requires_grad


def test_the_variance_stays_within_bounds(guide, batch):
    for bias, variance in ((-1e6, math.exp(-20)), (1e6, math.exp(10))):
        with torch.no_grad():
            guide.log_variance.bias.fill_(bias)
        found = guide.encode(batch.observations, batch.adjacency).variance
        torch.testing.assert_close(found, torch.full_like(found, variance))


def test_it_has_the_model_s_latent_states_and_can_be_built_again():
    model = GraphVAE(6, latent_dim=3)
    options = {"widths": [8, 5, 4], "rounds": 2, "self_weight": False}
    guide = find_guide("encoder")(model, **options)
    assert isinstance(guide, GraphEncoderGuide)
    assert GUIDES["encoder"].build is GraphEncoderGuide
    assert guide.second.own is None
    again = GraphEncoderGuide.for_model(model, **options)
    again.load_state_dict(guide.state_dict())
    states, adjacency = rand(5, 6, seed=1).float(), torch.ones(5, 5) - torch.eye(5)
    mean = guide.encode(states, adjacency).mean
    assert mean.shape == (5, 3)
    assert torch.equal(again.encode(states, adjacency).mean, mean)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"widths": (8, 5)}, "widths must be three numbers, and there are 2"),
        ({"widths": (3, 5, 4)}, r"out_features \(3\) must be at least 4"),
        ({"rounds": 0}, "num_rounds must be a positive whole number, not 0"),
        ({"latent_dim": 1.5}, r"out_features must be a positive whole number, not 1\.5"),
    ],
)
def test_options_that_are_wrong_are_refused(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        GraphEncoderGuide(4, **options)


def test_the_model_and_its_guide_have_the_same_sites(guide, batch):
    model = GraphVAE(4, latent_dim=3).to(DOUBLE)
    latent = poutine.trace(guide).get_trace(batch).nodes["states"]
    scored = poutine.trace(poutine.condition(model, {"states": latent["value"]}))
    site = scored.get_trace(batch).nodes["states"]
    assert site["fn"].event_shape == latent["fn"].event_shape == (4, 6, 3)
    assert site["fn"].batch_shape == latent["fn"].batch_shape == (3,)
    nobody = dataclasses.replace(batch, mask=torch.zeros_like(batch.mask))
    assert poutine.trace(guide).get_trace(nobody).log_prob_sum() == 0
