"""Bootstrap particle filter: slow, and right for any model."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.models import StateSpaceModel, SwarmBatch

__all__ = ["ParticleCloud", "bootstrap_particle_filter"]


@dataclass(frozen=True)
class ParticleCloud:
    """Weighted draws of a swarm's states given the past.

    Attributes
    ----------
    states
        ``(particle, batch, time, individual, state)``; 0 where nobody is present.
    log_weights
        ``(particle, batch, time)``: normalised, given the frames up to the same one.
    log_increments
        ``(batch, time)``: estimated log-density of each frame's observations given those before.
    """

    states: Tensor
    log_weights: Tensor
    log_increments: Tensor

    @property
    def log_evidence(self) -> Tensor:
        """Logarithm of an unbiased estimate of the evidence of each window, ``(batch,)``."""
        return self.log_increments.sum(-1)

    @property
    def effective_size(self) -> Tensor:
        """Effective number of particles, ``(batch, time)``."""
        return (-(2 * self.log_weights).logsumexp(0)).exp()

    @property
    def mean(self) -> Tensor:
        """Weighted mean, ``(batch, time, individual, state)``."""
        return (self.log_weights.exp()[..., None, None] * self.states).sum(0)

    @property
    def variance(self) -> Tensor:
        """Weighted variance of each feature, ``(batch, time, individual, state)``."""
        square = (self.states - self.mean).square()
        return (self.log_weights.exp()[..., None, None] * square).sum(0)

    def draw(self, num: int, seed: int | torch.Generator = 0) -> Tensor:
        """Draw states of each frame given the past, each frame for itself.

        Returns
        -------
        ``(num, batch, time, individual, state)``.
        """
        generator = torch.Generator().manual_seed(seed) if isinstance(seed, int) else seed
        weights = self.log_weights.exp().movedim(0, -1)
        shape = weights.shape[:-1]
        index = torch.multinomial(
            weights.reshape(-1, weights.shape[-1]), num, replacement=True, generator=generator
        )
        index = index.mT.reshape(num, *shape, 1, 1).expand(num, *self.states.shape[1:])
        return self.states.gather(0, index)


def bootstrap_particle_filter(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor],
    particles: int,
    seed: int | torch.Generator,
    *,
    resample_below: float = 0.5,
) -> ParticleCloud:
    r"""Filter by drawing from the transition and weighing with the emission.

    The exponential of the log-evidence is an unbiased estimate of the evidence, whatever the model
    and however few the particles (Del Moral, 2004, section 7.4.2); resampling is systematic,
    window by window. The variance of its logarithm grows with the number of frames and fast with
    that of individuals: for a reference on small swarms.

    Parameters
    ----------
    model, batch, values
        As in :func:`swarmssm.inference.filtering.extended_kalman`. Nothing is differentiable.
    particles
        Their number in each window.
    seed
        Of all draws; torch's own generator is left as it was.
    resample_below
        Resample where the effective number is below this part of ``particles``; 1: always.

    Raises
    ------
    InputError
        If ``particles`` is below 1 or ``resample_below`` not within 0 and 1.
    ValueError
        If the model has no emission.
    """
    if particles < 1:
        raise InputError(f"particles must be at least 1, and it is {particles}.")
    if not 0 <= resample_below <= 1:
        raise InputError(f"resample_below must be within 0 and 1, and it is {resample_below}.")
    if model.emission.is_exact:
        raise ValueError("a model that observes states exactly has nothing to filter")
    if isinstance(seed, torch.Generator):
        seed = int(torch.randint(2**62, (), generator=seed))
    present, seen = batch.present, batch.mask & batch.present
    inputs = batch.steps()
    clouds, weights, increments = [], [], []
    with torch.no_grad(), torch.random.fork_rng(devices=[]), model.fixed(values):
        torch.manual_seed(seed)
        initial = model.initial().expand((particles, len(batch), batch.num_individuals))
        states = initial.sample() * present[:, 0, :, None]
        carried = states.new_full((particles, len(batch)), -math.log(particles))
        for time in range(batch.num_times):
            if time:
                states, carried = _resample(states, carried, resample_below)
                following = model.step(states, inputs.at(time - 1)).sample()
                before, after = present[:, time - 1, :, None], present[:, time, :, None]
                states = torch.where(before, following, initial.sample()) * after
            score = model.emission(states).log_prob(batch.observations[:, time])
            joint = carried + torch.where(seen[:, time], score, 0.0).sum(-1)
            increment = joint.logsumexp(0)
            # A cloud that can explain nothing has evidence 0; its weights mean nothing more.
            carried = torch.where(increment.isinf(), carried, joint - increment)
            clouds.append(states)
            weights.append(carried)
            increments.append(increment)
    return ParticleCloud(
        torch.stack(clouds, 2), torch.stack(weights, 2), torch.stack(increments, 1)
    )


def _resample(states: Tensor, log_weights: Tensor, below: float) -> tuple[Tensor, Tensor]:
    """Resample windows whose effective number of particles is too small.

    Parameters
    ----------
    states
        ``(particle, batch, individual, state)``.
    log_weights
        Normalised, ``(particle, batch)``.
    below
        Part of the number of particles.
    """
    particles, windows = log_weights.shape
    poor = -(2 * log_weights).logsumexp(0) <= math.log(max(below, 1e-300) * particles)
    if not bool(poor.any()):
        return states, log_weights
    ends = log_weights.exp().cumsum(0).mT.contiguous()
    ends = ends / ends[:, -1:]
    combs = (torch.rand(windows, 1, dtype=ends.dtype) + torch.arange(particles)) / particles
    index = torch.searchsorted(ends, combs.to(ends)).clamp_max(particles - 1).mT
    taken = states.gather(0, index[..., None, None].expand_as(states))
    return (
        torch.where(poor[:, None, None], taken, states),
        torch.where(poor, -math.log(particles), log_weights),
    )
