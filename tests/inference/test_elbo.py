"""Hold the ELBO against the evidence of a model in which it is known.

With a linear decoder and a single individual, who has no edges, the next state is
``N(b, W W' + diag(s^2))``, and the posterior of each latent state is Gaussian.
"""

import dataclasses
import math

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import scipy.stats
import torch
from pyro.infer import Trace_ELBO

from swarmssm.models import GraphVAE, SwarmBatch

DOUBLE = torch.float64
WINDOWS, TIMES, LATENT = 3, 6, 2


class Gaussian:
    """The model with its truth, by hand."""

    def __init__(self):
        generator = torch.Generator().manual_seed(0)

        def rand(*shape):
            return torch.randn(*shape, dtype=DOUBLE, generator=generator)

        self.model = GraphVAE(4, latent_dim=LATENT, decoder_widths=(), scale=None).to(DOUBLE)
        with torch.no_grad():
            for parameter in self.model.parameters():
                parameter.copy_(0.5 * rand(*parameter.shape))
        mask = torch.ones(WINDOWS, TIMES, 1, dtype=torch.bool)
        mask[1, 4:] = False  # a window that was padded
        observations = rand(WINDOWS, TIMES, 1, 4) * mask.unsqueeze(-1)
        edges = torch.zeros(WINDOWS, TIMES, 1, 1, dtype=DOUBLE)
        self.batch = SwarmBatch.of(observations, mask, edges)
        self.weight = self.model.decoder[0].weight.detach()
        self.bias = self.model.decoder[0].bias.detach()
        self.noise = (2 * self.model.log_scale.detach()).exp()
        self.known = (mask[:, 1:] & mask[:, :-1]).squeeze(-1)
        self.following = observations[:, 1:, 0]

    def evidence(self):
        """Return log p of all known next states."""
        covariance = (self.weight @ self.weight.T + self.noise.diag()).numpy()
        density = scipy.stats.multivariate_normal(self.bias.numpy(), covariance)
        return density.logpdf(self.following[self.known].numpy()).sum()

    def posterior(self):
        """Return mean ``(window, step, latent)`` and covariance of the latent states."""
        scaled = self.weight.T / self.noise
        covariance = torch.linalg.inv(torch.eye(LATENT, dtype=DOUBLE) + scaled @ self.weight)
        return (self.following - self.bias) @ (covariance @ scaled).T, covariance


@pytest.fixture(scope="module")
def truth():
    return Gaussian()


def guide_of(mean, covariance, known):
    """Return a guide with the given Gaussian at each step."""

    def guide(batch):
        rows = torch.arange(len(batch))
        with pyro.plate("windows", batch.population, subsample=rows, dim=-1):
            normal = dist.MultivariateNormal(mean.unsqueeze(2), covariance)
            pyro.sample("states", normal.mask(known.unsqueeze(2)).to_event(2))

    return guide


def losses(model, guide, batch, draws):
    with torch.no_grad():
        return np.array([Trace_ELBO().loss(model, guide, batch) for _ in range(draws)])


def copies(batch, number):
    """Return each window many times over: one call then draws many latent paths."""
    many = batch.select(torch.arange(len(batch)).repeat(number))
    return dataclasses.replace(many, population=len(many))


def test_with_the_exact_posterior_every_draw_is_the_evidence(truth):
    """Then log p(x, z) - log q(z) is log p(x), whatever z is drawn."""
    guide = guide_of(*truth.posterior(), truth.known)
    found = -losses(truth.model, guide, truth.batch, 20)
    np.testing.assert_allclose(found, truth.evidence(), rtol=1e-9)


@pytest.mark.parametrize(("shift", "factor"), [(0.0, 2.0), (0.3, 0.5), (-0.5, 1.0)])
def test_another_guide_is_below_by_its_divergence(truth, shift, factor):
    """The ELBO is the evidence less KL(q || posterior), a sum of Gaussian ones."""
    mean, covariance = truth.posterior()
    other = covariance * factor
    number = 100
    guide = guide_of((mean + shift).repeat(number, 1, 1), other, truth.known.repeat(number, 1))
    moved = torch.full((LATENT,), shift, dtype=DOUBLE)
    each = 0.5 * (
        LATENT * factor
        + moved @ torch.linalg.inv(covariance) @ moved
        - LATENT
        - LATENT * math.log(factor)
    )
    divergence = float(each) * int(truth.known.sum())
    assert divergence > 0.5
    found = -losses(truth.model, guide, copies(truth.batch, number), 40) / number
    error = found.std() / math.sqrt(len(found))
    assert abs(found.mean() - (truth.evidence() - divergence)) < 6 * error


def test_mini_batches_are_scaled_to_all_windows(truth):
    """The mean over a pass through the windows is the evidence of all."""
    mean, covariance = truth.posterior()
    parts = []
    for index in torch.tensor([[2], [0], [1]]):
        guide = guide_of(mean[index], covariance, truth.known[index])
        parts.append(-losses(truth.model, guide, truth.batch.select(index), 1)[0])
    assert np.ptp(parts) > 1
    np.testing.assert_allclose(np.mean(parts), truth.evidence(), rtol=1e-9)


def test_a_window_s_weight_counts_it_so_often(truth):
    mean, covariance = truth.posterior()
    weight = torch.tensor([2.0, 0.5, 1.0], dtype=DOUBLE)
    weighted = dataclasses.replace(truth.batch, window_weight=weight)
    one = guide_of(mean, covariance, truth.known)

    def guide(batch):
        with pyro.poutine.scale(scale=weight):
            one(batch)

    windows = []
    for index in range(WINDOWS):
        part = truth.batch.select(torch.tensor([index]))
        single = guide_of(mean[[index]], covariance, truth.known[[index]])
        windows.append(-losses(truth.model, single, part, 1)[0] / WINDOWS)
    expected = float(np.dot(windows, weight.numpy()))
    found = -losses(truth.model, guide, weighted, 1)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_its_gradient_is_that_of_the_evidence(truth):
    """With the exact posterior, the mean gradient is the evidence's; each draw has its noise."""
    draws, number = 40, 50
    mean, posterior = truth.posterior()
    guide = guide_of(mean.repeat(number, 1, 1), posterior, truth.known.repeat(number, 1))
    batch = copies(truth.batch, number)
    weight, bias = (
        p.detach().clone().requires_grad_() for p in truth.model.decoder[0].parameters()
    )
    log_scale = truth.model.log_scale.detach().clone().requires_grad_()
    covariance = weight @ weight.T + (2 * log_scale).exp().diag()
    density = torch.distributions.MultivariateNormal(bias, covariance)
    density.log_prob(truth.following[truth.known]).sum().backward()
    expected = torch.cat([p.grad.flatten() for p in (log_scale, weight, bias)])
    gradients = []
    loss = Trace_ELBO()(truth.model, guide)
    for _ in range(draws):
        truth.model.zero_grad()
        (-loss(batch) / number).backward()
        gradients.append(torch.cat([p.grad.flatten() for p in truth.model.parameters()]))
    truth.model.zero_grad()
    names = [name for name, _ in truth.model.named_parameters()]
    assert names == ["log_scale", "decoder.0.weight", "decoder.0.bias"]
    found = torch.stack(gradients)
    error = found.std(0) / math.sqrt(draws)
    assert ((found.mean(0) - expected).abs() < 6 * error).all()
    assert (expected.abs() > 0.1).all()
