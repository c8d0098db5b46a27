"""A swarm's window as one linear Gaussian system, and how a model is made into one."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from swarmssm.inference.filtering.matrices import block_diagonal, own_blocks
from swarmssm.models import KinematicTransition, StateSpaceModel, StepInputs, SwarmBatch
from swarmssm.models.distributions.moments import covariance_of

__all__ = [
    "AffineMap",
    "AffineSwarm",
    "Linearizer",
    "Taylor",
    "Window",
    "no_steps",
]


class AffineMap(NamedTuple):
    r"""Affine function of the joint state of a swarm:
    :math:`y = m' + J (z - m) + \epsilon,\; \epsilon \sim N(0, Q)`.

    Attributes
    ----------
    point
        :math:`m`, where it was linearised, ``(..., joint)``.
    mean
        :math:`m'`, ``(..., out)``.
    jacobian
        :math:`J`, ``(..., out, joint)``.
    noise
        :math:`Q`, ``(..., out, out)``.
    """

    point: Tensor
    mean: Tensor
    jacobian: Tensor
    noise: Tensor

    def at(self, time: int) -> "AffineMap":
        """Return the map of one step or frame."""
        return AffineMap(
            self.point[..., time, :],
            self.mean[..., time, :],
            self.jacobian[..., time, :, :],
            self.noise[..., time, :, :],
        )

    def __call__(self, value: Tensor) -> Tensor:
        """Return the mean at joint states ``(..., joint)``."""
        return self.mean + (self.jacobian @ (value - self.point).unsqueeze(-1)).squeeze(-1)


class Linearizer(Protocol):
    """How a model is made affine about uncertain states; see :class:`Taylor`.

    States are ``(..., individual, state)``, their joint covariances ``(..., joint, joint)`` with
    ``joint = individual * state``.
    """

    def step(
        self, model: StateSpaceModel, mean: Tensor, covariance: Tensor, inputs: StepInputs
    ) -> AffineMap:
        """Return the transition as an affine map."""

    def observe(self, model: StateSpaceModel, mean: Tensor, covariance: Tensor) -> AffineMap:
        """Return the emission as an affine map, ``out = individual * observation``."""


class Taylor:
    """First order about the mean: what a transition and an emission say of themselves."""

    def step(
        self, model: StateSpaceModel, mean: Tensor, covariance: Tensor, inputs: StepInputs
    ) -> AffineMap:
        """Return the transition by its ``linearize``."""
        own = own_blocks(covariance, mean.shape[-2])
        line = model.transition.linearize(mean, model.edges.complete(mean, inputs), own)
        point = mean.flatten(-2)
        joint = point.shape[-1]
        return AffineMap(
            point,
            line.mean.flatten(-2),
            line.jacobian.reshape(*line.jacobian.shape[:-4], joint, joint),
            block_diagonal(line.noise),
        )

    def observe(self, model: StateSpaceModel, mean: Tensor, covariance: Tensor) -> AffineMap:
        """Return the emission by its ``linearize``."""
        if model.emission.is_exact:
            raise ValueError("a model that observes states exactly has nothing to filter")
        line = model.emission.linearize(mean)
        return AffineMap(
            mean.flatten(-2),
            line.mean.flatten(-2),
            block_diagonal(line.jacobian),
            block_diagonal(line.noise),
        )


@dataclass(frozen=True)
class Window:
    """What a filter knows of a batch of windows besides the law of motion.

    Attributes
    ----------
    initial_mean, initial_covariance
        Of an individual that enters: ``(batch, joint)``, ``(batch, joint, joint)``.
    observations
        ``(batch, time, individual * observation)``; 0 where there is none.
    mask
        Which of them were made, of bool.
    present
        ``(batch, time, individual)`` of bool: who is there.
    inputs
        Of the steps.
    features
        Number of features of a state.
    dt
        Seconds of a step if positions follow from velocities, ``p' = p + dt v'``; else ``None``.
    """

    initial_mean: Tensor
    initial_covariance: Tensor
    observations: Tensor
    mask: Tensor
    present: Tensor
    inputs: StepInputs
    features: int
    dt: float | None

    @classmethod
    def of(cls, model: StateSpaceModel, batch: SwarmBatch) -> "Window":
        """Ask the model, whose parameters must be fixed."""
        if model.emission.is_exact:
            raise ValueError("a model that observes states exactly has nothing to filter")
        individuals, features = batch.num_individuals, model.state_dim
        initial = model.initial()
        shape = (len(batch), individuals, features)
        seen = batch.mask & batch.present
        size = batch.observations.shape[-1]
        kinematic = isinstance(model.transition, KinematicTransition)
        return cls(
            initial.mean.expand(shape).flatten(-2),
            block_diagonal(covariance_of(initial).expand(*shape, features)),
            torch.where(seen.unsqueeze(-1), batch.observations, 0.0).flatten(-2),
            seen.repeat_interleave(size, -1),
            batch.present,
            batch.steps(),
            features,
            model.transition.dt if kinematic else None,
        )

    @property
    def num_times(self) -> int:
        """Number of frames."""
        return self.present.shape[-2]

    @property
    def individuals(self) -> int:
        """Number of individuals, present or not."""
        return self.present.shape[-1]

    @property
    def there(self) -> Tensor:
        """Which features of the joint state belong to somebody, ``(batch, time, joint)``."""
        return self.present.repeat_interleave(self.features, -1)

    @property
    def persists(self) -> Tensor:
        """Features of those who are there at both ends of a step, ``(batch, time - 1, joint)``."""
        there = self.there
        return there[..., 1:, :] & there[..., :-1, :]

    @property
    def stochastic_features(self) -> Tensor:
        """Which features noise moves, ``(batch, time, joint)``: not positions that follow."""
        there = self.there
        if self.dt is None:
            return there
        position = torch.arange(self.features, device=there.device) < self.features // 2
        follow = self.persists & position.repeat(self.individuals)
        return torch.cat([there[..., :1, :], there[..., 1:, :] & ~follow], -2)

    def split(self, joint: Tensor) -> Tensor:
        """Return joint states as ``(..., individual, state)``."""
        return joint.reshape(*joint.shape[:-1], self.individuals, self.features)

    def settle_steps(self, steps: AffineMap) -> AffineMap:
        """Let individuals enter with the initial distribution and leave with nothing behind.

        Parameters
        ----------
        steps
            All of them, ``(batch, time - 1, ...)``, as if everybody stayed.
        """
        there = self.there
        return self._settle(steps, there[..., :-1, :], there[..., 1:, :], 1)

    def settle_step(self, step: AffineMap, time: int) -> AffineMap:
        """Do so for the one step from frame ``time``."""
        there = self.there
        return self._settle(step, there[..., time, :], there[..., time + 1, :], 0)

    def _settle(self, steps: AffineMap, before: Tensor, after: Tensor, dims: int) -> AffineMap:
        persists, enters = before & after, after & ~before
        if bool(persists.all()):
            return steps
        shape = steps.mean.shape
        fresh = self.initial_mean[(..., *[None] * dims, slice(None))].expand(shape)
        spread = self.initial_covariance[(..., *[None] * dims, slice(None), slice(None))]
        mean = torch.where(persists, steps.mean, torch.where(enters, fresh, 0.0))
        return AffineMap(
            steps.point,
            mean,
            # Who leaves has moved the others for the last time.
            torch.where(_outer(persists, before), steps.jacobian, 0.0),
            torch.where(_outer(persists, persists), steps.noise, 0.0)
            + torch.where(_outer(enters, enters), spread, 0.0),
        )

    def settle_observation(self, observation: AffineMap, seen: Tensor) -> AffineMap:
        """Let observations that were not made say nothing: 0 = 0 + noise of variance 1."""
        if bool(seen.all()):
            return observation
        eye = torch.eye(seen.shape[-1], dtype=observation.mean.dtype, device=seen.device)
        return AffineMap(
            observation.point,
            torch.where(seen, observation.mean, 0.0),
            torch.where(seen.unsqueeze(-1), observation.jacobian, 0.0),
            torch.where(_outer(seen, seen), observation.noise, eye),
        )


@dataclass(frozen=True)
class AffineSwarm:
    r"""Linear Gaussian system :math:`z_{t+1} = a_t + F_t z_t + q_t,\; x_t = c_t + H_t z_t + r_t`.

    Attributes
    ----------
    window
        Observations, and who is there.
    steps
        Transitions ``(batch, time - 1, ...)``. One that enters comes with the initial
        distribution as noise; absent ones have 0 everywhere.
    observations
        Emissions ``(batch, time, ...)``. Those not made have jacobian 0 and noise 1.
    """

    window: Window
    steps: AffineMap
    observations: AffineMap

    @classmethod
    def about(
        cls,
        model: StateSpaceModel,
        batch: SwarmBatch,
        values: Mapping[str, Tensor],
        mean: Tensor,
        covariance: Tensor,
        linearizer: Linearizer,
    ) -> "AffineSwarm":
        """Linearise all frames in one call about states that are known already.

        Parameters
        ----------
        model, batch, values
            As in :func:`swarmssm.inference.filtering.extended_kalman`.
        mean, covariance
            ``(batch, time, individual, state)`` and ``(batch, time, joint, joint)``.
        linearizer
            First order (:class:`Taylor`) or by sigma points.
        """
        with model.fixed(values):
            window = Window.of(model, batch)
            observations = linearizer.observe(model, mean, covariance)
            if window.num_times == 1:
                steps = no_steps(window.initial_mean)
            else:
                before = mean[..., :-1, :, :], covariance[..., :-1, :, :]
                steps = window.settle_steps(linearizer.step(model, *before, window.inputs))
        return cls(
            window,
            steps,
            window.settle_observation(observations, window.mask),
        )


def no_steps(mean: Tensor) -> AffineMap:
    """Return the steps of a single frame: none.

    Parameters
    ----------
    mean
        ``(..., joint)``; only shape and type matter.
    """
    *leading, joint = mean.shape
    vector = mean.new_zeros(*leading, 0, joint)
    matrix = mean.new_zeros(*leading, 0, joint, joint)
    return AffineMap(vector, vector, matrix, matrix)


def _outer(rows: Tensor, columns: Tensor) -> Tensor:
    return rows.unsqueeze(-1) & columns.unsqueeze(-2)
