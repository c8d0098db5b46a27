"""A small swarm, and a model that was fitted to it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr

from swarmssm.inference import Fit, fit
from swarmssm.models import StateSpaceModel, SwarmBatch
from swarmssm.simulate import simulate_boids
from swarmssm.tracks import make_tracks

#: Enough for a test of what stays the same, whatever was learned.
BRIEF: dict[str, Any] = {
    "model": "graph-vae",
    "epochs": 3,
    "window": 20,
    "batch_windows": 4,
    "seed": 3,
}


@pytest.fixture(scope="session")
def brief() -> dict[str, Any]:
    """Settings of a fit that takes about a second."""
    return BRIEF


@pytest.fixture(scope="session")
def swarm() -> xr.Dataset:
    """Four boids in two trials of 100 frames, with velocities and the graph of a radius."""
    return simulate_boids(individuals=4, steps=100, trials=2, seed=0)


@pytest.fixture(scope="session")
def fitted(swarm: xr.Dataset) -> Fit:
    """Return a model that has hardly learned anything."""
    return fit(tracks=swarm, **BRIEF)


@pytest.fixture(scope="session")
def with_gaps(swarm: xr.Dataset) -> xr.Dataset:
    """The swarm with gaps: one individual is never seen in the first trial, others now and then.

    It has neither velocities nor a graph, so that both have to be made.
    """
    position = swarm["position"].transpose("trial", "time", "individual", "space").to_numpy().copy()
    hidden = np.random.default_rng(1).random(position.shape[:3]) < 0.1
    hidden[0, :, 2] = True
    hidden[1, 60:, :] = True
    position[hidden] = np.nan
    return make_tracks(position, fps=swarm.attrs["fps"])


@pytest.fixture(scope="session")
def weights_of() -> Callable[[Fit], dict[str, torch.Tensor]]:
    """Return a function that gives all weights of a fit by name."""

    def weights(fitted: Fit) -> dict[str, torch.Tensor]:
        parts = (("model", fitted.model), ("guide", fitted.guide))
        return {f"{p}.{n}": v for p, module in parts for n, v in module.state_dict().items()}

    return weights


def _dense_evidence(model: StateSpaceModel, batch: SwarmBatch) -> torch.Tensor:
    """Return the log-density of each window of a linear-Gaussian swarm, from one big Gaussian."""
    batches, times, individuals, _ = batch.observations.shape
    size = individuals * model.state_dim
    initial = model.initial()
    start_mean = initial.mean.expand(individuals, -1).reshape(-1)
    start_root = initial.stddev.expand(individuals, -1).reshape(-1).diag()
    eye, densities = torch.eye(size, dtype=start_mean.dtype), []
    for b in range(batches):
        there = batch.present[b].repeat_interleave(model.state_dim, -1).to(start_mean)
        # The whole path as an affine function of standard noise, `size` of it for each frame.
        mean, root = start_mean * there[0], torch.zeros(size, times * size, dtype=eye.dtype)
        root[:, :size] = start_root * there[0, :, None]
        means, roots = [mean], [root]
        for t in range(1, times):
            inputs = batch.select(torch.tensor([b])).steps().at(t - 1)
            law = model.transition.linearize(mean.reshape(1, individuals, -1), inputs)
            noise = torch.linalg.eigh(law.noise[0])
            half = noise.eigenvectors * noise.eigenvalues.clamp(min=0).sqrt().unsqueeze(-2)
            persists = (there[t] * there[t - 1]).unsqueeze(-1)
            enters = (there[t] * (1 - there[t - 1])).unsqueeze(-1)
            root = persists * (law.jacobian[0].reshape(size, size) @ root)
            root[:, t * size : (t + 1) * size] = persists * torch.block_diag(*half)
            root[:, t * size : (t + 1) * size] += enters * start_root
            mean = persists[:, 0] * law.mean[0].reshape(-1) + enters[:, 0] * start_mean
            means.append(mean)
            roots.append(root)
        states = torch.stack(means).reshape(times, individuals, -1)
        seen = model.emission.linearize(states)
        show = torch.block_diag(*seen.jacobian.flatten(0, 1))
        mixed = show @ torch.cat(roots)
        covariance = mixed @ mixed.T + torch.block_diag(*seen.noise.flatten(0, 1))
        known = batch.mask[b].flatten().repeat_interleave(batch.observations.shape[-1])
        gaussian = torch.distributions.MultivariateNormal(
            seen.mean.flatten()[known], covariance[known][:, known]
        )
        densities.append(gaussian.log_prob(batch.observations[b].flatten()[known]))
    return torch.stack(densities)


@pytest.fixture(scope="session")
def dense_evidence() -> Callable[[StateSpaceModel, SwarmBatch], torch.Tensor]:
    """Return a function that knows the exact evidence of a linear-Gaussian swarm."""
    return _dense_evidence
