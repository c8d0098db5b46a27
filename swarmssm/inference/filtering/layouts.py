"""How the states of a swarm are laid out in a filter: all in one vector, or each on its own."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from swarmssm.inference.filtering.adjoint import AffineChain
from swarmssm.inference.filtering.affine import AffineMap, AffineSwarm, Window
from swarmssm.inference.filtering.blocks import linearize_own
from swarmssm.inference.filtering.matrices import block_diagonal, own_blocks
from swarmssm.models import (
    Emission,
    KinematicTransition,
    StateSpaceModel,
    StepInputs,
    SwarmBatch,
)
from swarmssm.models.distributions.moments import covariance_of

__all__ = ["JOINT_LIMIT", "Frames", "Layout", "Points", "frames_of"]

Layout = Literal["auto", "joint", "blocks"]
#: Up to so many individuals the covariance of the whole swarm is kept.
JOINT_LIMIT = 30


class Points(NamedTuple):
    """Where a model is linearised: a path, and how sure it is.

    Attributes
    ----------
    mean
        ``(batch, time, individual, state)``.
    covariance
        Each individual's own, ``(batch, time, individual, state, state)``.
    """

    mean: Tensor
    covariance: Tensor


class Frames(ABC):
    """Windows of a model at fixed parameters, as a filter sees them.

    A filter works on ``row`` vectors side by side, in double precision; model and batch may be of
    single precision.
    """

    window: Window

    def __init__(self, model: StateSpaceModel, batch: SwarmBatch) -> None:
        self.model = model
        self.inputs = batch.steps()
        self.shape = (len(batch), batch.num_individuals, model.state_dim)
        self.dtype = batch.observations.dtype

    @property
    def emission(self) -> Emission:
        """The law of observation."""
        if self.model.emission.is_exact:
            raise ValueError("a model that observes states exactly has nothing to filter")
        return self.model.emission

    def still(self) -> AffineChain:
        """Return the chain of a linear emission, without its steps."""
        batch, individuals, features = self.shape
        times = self.window.num_times
        zero = self.window.initial_mean.new_zeros(batch, times, individuals, features)
        start = self.window.initial_mean
        none, square = start.new_zeros(len(start), 0, 1), start.new_zeros(len(start), 0, 1, 1)
        steps = AffineMap(none, none, square, square)
        observations = _as_double(self._observe(zero.to(self.dtype)))
        observations = self.window.settle_observation(observations, self.window.mask)
        return AffineChain.of(AffineSwarm(self.window, steps, observations))

    def system(self, points: Points) -> AffineSwarm:
        """Return the system linearised at points."""
        mean = points.mean.to(self.dtype)
        covariance = points.covariance[:, :-1].to(self.dtype)
        steps = _as_double(self._steps(mean[:, :-1], self.inputs, covariance))
        observations = self.window.settle_observation(
            _as_double(self._observe(mean)), self.window.mask
        )
        return AffineSwarm(self.window, self.window.settle_steps(steps), observations)

    def about(self, points: Points, *, offsets: bool = True) -> AffineChain:
        """Return the chain linearised at points; else with next means in place of offsets."""
        system = self.system(points)
        if not offsets:
            steps = system.steps._replace(point=torch.zeros_like(system.steps.point))
            system = replace(system, steps=steps)
        return AffineChain.of(system)

    def step(self, step: int, states: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the next means, F and Q of one step.

        Parameters
        ----------
        step
            Its number.
        states, covariance
            ``(batch, individual, state)`` and each individual's own ``(..., state, state)``.
        """
        line = self._steps(states.to(self.dtype), self.inputs.at(step), covariance.to(self.dtype))
        line = self.window.settle_step(_as_double(line), step)
        return line.mean, line.jacobian, line.noise

    @abstractmethod
    def _steps(self, states: Tensor, inputs: StepInputs, covariance: Tensor) -> AffineMap:
        """Linearise the transition at ``(batch, [time,] individual, state)``."""

    @abstractmethod
    def _observe(self, states: Tensor) -> AffineMap:
        """Linearise the emission at ``(batch, time, individual, state)``."""

    @abstractmethod
    def split(self, rows: Tensor) -> Tensor:
        """Return vectors ``(row, state of the row)`` as ``(batch, individual, state)``."""

    @abstractmethod
    def flat(self, states: Tensor) -> Tensor:
        """Undo :meth:`split`."""

    @abstractmethod
    def own(self, covariance: Tensor) -> Tensor:
        """Return covariances of rows as ``(batch, individual, state, state)``."""

    @abstractmethod
    def total(self, evidence: Tensor) -> Tensor:
        """Return what belongs to each window, ``(batch,)``, from that of rows ``(row,)``."""

    @abstractmethod
    def paths(self, rows: Tensor) -> Tensor:
        """Return paths of rows as ``(batch, time, individual, state)``."""

    def points(self, mean: Tensor, covariance: Tensor) -> Points:
        """Return moments of all frames, time first, as points."""
        return Points(
            torch.stack([self.split(m) for m in mean], 1),
            torch.stack([self.own(c) for c in covariance], 1),
        )


def frames_of(model: StateSpaceModel, batch: SwarmBatch, layout: Layout) -> Frames:
    """Lay out the windows of a model whose parameters are fixed.

    Raises
    ------
    ValueError
        If the layout is unknown, or the model has no emission.
    """
    if layout not in ("auto", "joint", "blocks"):
        raise ValueError(f"layout must be 'auto', 'joint' or 'blocks', not {layout!r}")
    if layout == "auto":
        layout = "joint" if batch.num_individuals <= JOINT_LIMIT else "blocks"
    return _Joint(model, batch) if layout == "joint" else _Blocks(model, batch)


def _as_double(line: AffineMap) -> AffineMap:
    return AffineMap(*(part.double() for part in line))


def _double_window(window: Window) -> Window:
    return replace(
        window,
        initial_mean=window.initial_mean.double(),
        initial_covariance=window.initial_covariance.double(),
        observations=window.observations.double(),
    )


class _Joint(Frames):
    """A row is a window: the states of all individuals in one vector."""

    def __init__(self, model: StateSpaceModel, batch: SwarmBatch) -> None:
        super().__init__(model, batch)
        self.window = _double_window(Window.of(model, batch))

    def _steps(self, states: Tensor, inputs: StepInputs, covariance: Tensor) -> AffineMap:
        inputs = self.model.edges.complete(states, inputs)
        line = self.model.transition.linearize(states, inputs, covariance)
        joint = states.shape[-2] * states.shape[-1]
        return AffineMap(
            states.flatten(-2),
            line.mean.flatten(-2),
            line.jacobian.reshape(*states.shape[:-2], joint, joint),
            block_diagonal(line.noise),
        )

    def _observe(self, states: Tensor) -> AffineMap:
        line = self.emission.linearize(states)
        return AffineMap(
            states.flatten(-2),
            line.mean.flatten(-2),
            block_diagonal(line.jacobian),
            block_diagonal(line.noise),
        )

    def split(self, rows: Tensor) -> Tensor:
        return rows.view(self.shape)

    def flat(self, states: Tensor) -> Tensor:
        return states.flatten(-2)

    def own(self, covariance: Tensor) -> Tensor:
        return own_blocks(covariance, self.shape[1])

    def total(self, evidence: Tensor) -> Tensor:
        return evidence

    def paths(self, rows: Tensor) -> Tensor:
        return rows


class _Blocks(Frames):
    """A row is an individual; see :mod:`swarmssm.inference.filtering.blocks`."""

    def __init__(self, model: StateSpaceModel, batch: SwarmBatch) -> None:
        super().__init__(model, batch)
        _, _, features = self.shape
        initial = model.initial()
        if model.emission.is_exact:
            raise ValueError("a model that observes states exactly has nothing to filter")
        seen = batch.mask & batch.present
        size = batch.observations.shape[-1]
        values = torch.where(seen.unsqueeze(-1), batch.observations, 0.0)
        kinematic = isinstance(model.transition, KinematicTransition)
        window = Window(
            initial.mean.expand(self.shape).flatten(0, 1),
            covariance_of(initial).expand(*self.shape, features).flatten(0, 1),
            self._rows(values),
            self._rows(seen.unsqueeze(-1).expand(*seen.shape, size)),
            self._rows(batch.present.unsqueeze(-1)),
            self.inputs,
            features,
            model.transition.dt if kinematic else None,
        )
        self.window = _double_window(window)

    def _rows(self, values: Tensor, inner: int = 1) -> Tensor:
        """Return ``(batch, [time,] individual, ...)`` as ``(batch * individual, [time,] ...)``."""
        return values.movedim(-1 - inner, 1).flatten(0, 1)

    def _steps(self, states: Tensor, inputs: StepInputs, covariance: Tensor) -> AffineMap:
        inputs = self.model.edges.complete(states, inputs)
        line = linearize_own(self.model.transition, states, inputs, covariance)
        return AffineMap(
            self._rows(states),
            self._rows(line.mean),
            self._rows(line.jacobian, 2),
            self._rows(line.noise, 2),
        )

    def _observe(self, states: Tensor) -> AffineMap:
        line = self.emission.linearize(states)
        return AffineMap(
            self._rows(states),
            self._rows(line.mean),
            self._rows(line.jacobian, 2),
            self._rows(line.noise, 2),
        )

    def split(self, rows: Tensor) -> Tensor:
        return rows.view(self.shape)

    def flat(self, states: Tensor) -> Tensor:
        return states.flatten(0, 1)

    def own(self, covariance: Tensor) -> Tensor:
        return covariance.view(*self.shape, self.shape[-1])

    def total(self, evidence: Tensor) -> Tensor:
        return evidence.view(self.shape[:2]).sum(-1)

    def paths(self, rows: Tensor) -> Tensor:
        return torch.unflatten(rows.squeeze(-2), 0, self.shape[:2]).transpose(1, 2)
