"""Hold the thesis's model against its density written out in numpy."""

import dataclasses

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import scipy.special
import scipy.stats
import torch
from pyro import poutine

from swarmssm.models import GraphVAE, SwarmBatch

DOUBLE = torch.float64
#: Sums of some thousand terms of size one to ten, in float64.
CLOSE = {"rtol": 1e-10, "atol": 0.0}
WINDOWS, TIMES, INDIVIDUALS, LATENT = 3, 5, 4, 2


def rand(*shape, seed):
    return torch.randn(*shape, dtype=DOUBLE, generator=torch.Generator().manual_seed(seed))


@pytest.fixture
def model():
    model = GraphVAE(4, latent_dim=LATENT, decoder_widths=(8, 6)).to(DOUBLE)
    with torch.no_grad():
        model.log_scale.copy_(torch.tensor([-1.0, 0.0, 0.5, -0.3]))
        model.decoder[2].bias.uniform_(-1.0, 1.0)
    return model


@pytest.fixture
def batch():
    """Windows with gaps, an individual who is never there, weights, and more windows elsewhere."""
    mask = rand(WINDOWS, TIMES, INDIVIDUALS, seed=2) > -0.8
    mask[0, :, 1] = False
    mask[1] = True
    observations = rand(WINDOWS, TIMES, INDIVIDUALS, 4, seed=3) * mask.unsqueeze(-1)
    adjacency = (rand(WINDOWS, TIMES, INDIVIDUALS, INDIVIDUALS, seed=4) > 0).to(DOUBLE)
    adjacency *= mask.unsqueeze(-1) & mask.unsqueeze(-2)
    adjacency.diagonal(dim1=-2, dim2=-1).zero_()
    weight = torch.tensor([1.0, 0.5, 2.0], dtype=DOUBLE)
    batch = SwarmBatch.of(observations, mask, adjacency)
    return dataclasses.replace(batch, window_weight=weight, population=12)


@pytest.fixture
def latent():
    return rand(WINDOWS, TIMES - 1, INDIVIDUALS, LATENT, seed=5)


def density(model, batch, latent):
    """Return the log density of a path as Pyro has it."""
    conditioned = poutine.condition(model, {"states": latent})
    return poutine.trace(conditioned).get_trace(batch).log_prob_sum()


def decoded(model, latent):
    """Return the decoder's output, by hand."""
    linear = [part for part in model.decoder if isinstance(part, torch.nn.Linear)]
    values = latent.numpy()
    for place, layer in enumerate(linear):
        values = values @ layer.weight.detach().numpy().T + layer.bias.detach().numpy()
        if place < len(linear) - 1:
            values = np.maximum(values, 0.0)
    return values


def terms(model, batch, latent):
    """Return the three terms of the log density of each window, by hand."""
    mask = batch.mask.numpy()
    observations, adjacency = batch.observations.numpy(), batch.adjacency.numpy()
    z, scale = latent.numpy(), np.exp(model.log_scale.detach().numpy())
    mean = decoded(model, latent)
    out = np.zeros((len(batch), 3))
    for w in range(len(batch)):
        for t in range(batch.num_times - 1):
            both = [i for i in range(batch.num_individuals) if mask[w, t, i] and mask[w, t + 1, i]]
            for i in both:
                out[w, 0] += scipy.stats.norm.logpdf(z[w, t, i]).sum()
                x = observations[w, t + 1, i]
                out[w, 1] += scipy.stats.norm.logpdf(x, mean[w, t, i], scale).sum()
                for j in both:
                    if i != j:
                        p = scipy.special.expit(z[w, t, i] @ z[w, t, j])
                        edge = adjacency[w, t + 1, i, j]
                        out[w, 2] += scipy.stats.bernoulli.logpmf(edge, p)
    return out


def test_log_density_is_the_written_one(model, batch, latent):
    """Every window counts as often as its weight says, and 12 / 3 times for the absent windows."""
    expected = 12 / 3 * (terms(model, batch, latent).sum(1) * batch.window_weight.numpy()).sum()
    assert abs(expected) > 100
    np.testing.assert_allclose(density(model, batch, latent).item(), expected, rtol=1e-10)


def test_each_term_is_a_site(model, batch, latent):
    plain = SwarmBatch.of(batch.observations, batch.mask, batch.adjacency)
    trace = poutine.trace(poutine.condition(model, {"states": latent})).get_trace(plain)
    trace.compute_log_prob()
    names = ["states", "next_states", "next_adjacency"]
    assert [name for name in trace.nodes if name in names] == names
    sites = [n for n, s in trace.nodes.items() if s["type"] == "sample" and n != "windows"]
    assert sites == names  # no site per step or per window
    by_hand = terms(model, plain, latent)
    for name, column in zip(names, by_hand.T, strict=True):
        found = trace.nodes[name]["log_prob"].detach().numpy()
        np.testing.assert_allclose(found, column, rtol=1e-10)


def test_prior_draws_are_standard_normal(model):
    shape = (4, 26, 20)
    batch = SwarmBatch.of(
        torch.zeros(*shape, 4, dtype=DOUBLE),
        torch.ones(shape, dtype=torch.bool),
        torch.zeros(*shape, 20, dtype=DOUBLE),
    )
    draws = poutine.trace(model).get_trace(batch).nodes["states"]["value"]
    assert draws.shape == (4, 25, 20, LATENT)
    n = draws.numel()
    assert abs(draws.mean()) < 6 / n**0.5
    assert abs((draws**2).mean() - 1) < 6 * (2 / n) ** 0.5


def test_next_edges_are_inner_products(model):
    """(3.57) by hand: of three individuals, two at right angles."""
    latent = torch.tensor([[1.0, 0.0], [0.0, 2.0], [3.0, -1.0]], dtype=DOUBLE)
    expected = [[1.0, 0.0, 3.0], [0.0, 4.0, -2.0], [3.0, -2.0, 10.0]]
    following = model.decode(latent)
    torch.testing.assert_close(following.edge_logits, torch.tensor(expected, dtype=DOUBLE))
    np.testing.assert_allclose(following.states.mean.detach(), decoded(model, latent), rtol=1e-12)
    scale = torch.tensor([-1.0, 0.0, 0.5, -0.3], dtype=DOUBLE).exp().expand(3, 4)
    torch.testing.assert_close(following.states.stddev.detach(), scale, rtol=1e-6, atol=0)


def test_relabelling_individuals_changes_nothing(model, batch, latent):
    order = torch.tensor([2, 0, 3, 1])
    relabelled = dataclasses.replace(
        batch,
        observations=batch.observations[:, :, order],
        mask=batch.mask[:, :, order],
        adjacency=batch.adjacency[:, :, order][..., order],
    )
    before = density(model, batch, latent)
    torch.testing.assert_close(density(model, relabelled, latent[:, :, order]), before, **CLOSE)
    one, other = model.decode(latent), model.decode(latent[:, :, order])
    torch.testing.assert_close(other.states.mean, one.states.mean[:, :, order], **CLOSE)
    logits = one.edge_logits[:, :, order][..., order]
    torch.testing.assert_close(other.edge_logits, logits, rtol=1e-10, atol=1e-12)


def test_absent_individuals_contribute_nothing(model, batch, latent):
    """Neither more seats that nobody takes, nor what stands at the places of the absent."""
    before = density(model, batch, latent)
    pad = torch.nn.functional.pad
    larger = dataclasses.replace(
        batch,
        observations=pad(batch.observations, (0, 0, 0, 2)),
        mask=pad(batch.mask, (0, 2)),
        adjacency=pad(batch.adjacency, (0, 2, 0, 2)),
    )
    seats = torch.cat([latent, rand(WINDOWS, TIMES - 1, 2, LATENT, seed=6)], dim=2)
    torch.testing.assert_close(density(model, larger, seats), before, **CLOSE)
    absent = ~batch.mask.unsqueeze(-1)
    assert absent.any()
    other = torch.where(absent, 100 * rand(*batch.observations.shape, seed=7), batch.observations)
    changed = dataclasses.replace(batch, observations=other)
    hidden = ~(batch.mask[:, 1:] & batch.mask[:, :-1]).unsqueeze(-1)
    moved = torch.where(hidden, 100 * rand(*latent.shape, seed=8), latent)
    assert density(model, changed, moved).item() == before.item()


def test_gradients_know_nothing_of_the_absent(model, batch, latent):
    hidden = ~(batch.mask[:, 1:] & batch.mask[:, :-1]).unsqueeze(-1).expand_as(latent)
    path = latent.clone().requires_grad_()
    density(model, batch, path).backward()
    assert (path.grad[hidden] == 0).all()
    assert (path.grad[~hidden] != 0).all()
    assert all(weight.grad.isfinite().all() for weight in model.parameters())
    nobody = dataclasses.replace(
        batch, mask=torch.zeros_like(batch.mask), adjacency=torch.zeros_like(batch.adjacency)
    )
    model.zero_grad()
    nothing = density(model, nobody, latent)
    nothing.backward()
    assert nothing == 0
    assert all((weight.grad == 0).all() for weight in model.parameters())


def test_windows_add_up(model, batch, latent):
    """One call on a batch is the sum of calls on its windows, and of calls on single steps."""
    plain = SwarmBatch.of(batch.observations, batch.mask, batch.adjacency)
    whole = density(model, plain, latent)
    columns = (plain.observations, plain.mask, plain.adjacency)
    windows = [
        density(model, SwarmBatch.of(*(c[w : w + 1] for c in columns)), latent[w : w + 1])
        for w in range(WINDOWS)
    ]
    torch.testing.assert_close(torch.stack(windows).sum(), whole, **CLOSE)
    steps = [
        density(model, SwarmBatch.of(*(c[:, t : t + 2] for c in columns)), latent[:, t : t + 1])
        for t in range(TIMES - 1)
    ]
    torch.testing.assert_close(torch.stack(steps).sum(), whole, **CLOSE)


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_mini_batches_average_to_the_whole(model, size):
    """Over a pass through the windows, the mean of mini-batch ELBOs is the ELBO of all."""
    observations = rand(6, TIMES, INDIVIDUALS, 4, seed=9)
    adjacency = (rand(6, TIMES, INDIVIDUALS, INDIVIDUALS, seed=10) > 0).to(DOUBLE)
    mask = rand(6, TIMES, INDIVIDUALS, seed=11) > -1.5
    batch = SwarmBatch.of(observations, mask, adjacency)

    def guide(batch):
        # Without variance: the latent states are those of the observations themselves.
        with pyro.plate("windows", batch.population, subsample=torch.arange(len(batch)), dim=-1):
            pyro.sample("states", dist.Delta(batch.observations[:, :-1, :, :LATENT], event_dim=3))

    loss = pyro.infer.Trace_ELBO().loss
    parts = [batch.select(index) for index in torch.randperm(6).split(size)]
    losses = [loss(model, guide, part) for part in parts]
    np.testing.assert_allclose(np.mean(losses), loss(model, guide, batch), rtol=1e-10)
    assert all(part.population == 6 for part in parts)


def test_select_keeps_rows_together(batch):
    controls = rand(WINDOWS, TIMES, 2, seed=12)
    picked = dataclasses.replace(batch, controls=controls).select(torch.tensor([2, 0]))
    assert (len(picked), picked.population, picked.num_times) == (2, 12, TIMES)
    for name in ("observations", "mask", "adjacency", "window_weight", "present"):
        assert torch.equal(getattr(picked, name), getattr(batch, name)[[2, 0]])
    assert torch.equal(picked.controls, controls[[2, 0]])


def test_the_scale_is_fixed_unless_it_is_to_be_learned():
    latent = torch.zeros(2, 4)
    fixed = GraphVAE(4, scale=0.25)
    assert "log_scale" not in dict(fixed.named_parameters())
    assert "log_scale" in fixed.state_dict()
    torch.testing.assert_close(fixed.decode(latent).states.stddev, torch.full((2, 4), 0.25))
    learned = GraphVAE(4, scale=None)
    assert learned.log_scale.requires_grad
    assert learned.log_scale.shape == (4,)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"scale": 0.0}, "scale must be a positive number or None, and it is 0"),
        ({"latent_dim": 0}, "latent_dim must be a positive whole number, not 0"),
        ({"decoder_widths": (32, -1)}, r"widths\[2\] must be a positive whole number, not -1"),
        ({"decoder_widths": "32"}, r"widths\[1\] must be .* not '3'"),
    ],
)
def test_options_that_are_wrong_are_refused(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        GraphVAE(4, **options)
