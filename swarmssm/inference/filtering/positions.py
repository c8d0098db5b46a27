r"""The path of a kinematic swarm as a band of positions.

Where positions follow from velocities, :math:`p_t = p_{t-1} + dt\, v_t`, a path is told by its
positions alone: :math:`v_t = (p_t - p_{t-1}) / dt`. Individual i that enters at frame t has one
position more, :math:`p_{t-1} = p_t - dt\, v_t`. A step couples three frames, so that the
posterior of the linearised model is a Gaussian whose precision is a band of blocks
(:mod:`swarmssm.inference.filtering.banded`), two thirds as wide and half as deep as what a Kalman
filter works on, and the linearisation of all frames is one batched call.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from swarmssm.inference.filtering.banded import band_mean, band_moments
from swarmssm.inference.filtering.integral import (
    PathTerms,
    assemble,
    own_blocks_of,
    path_integral,
)
from swarmssm.inference.filtering.layouts import Points
from swarmssm.models import (
    Emission,
    KinematicTransition,
    PositionEmission,
    StateEmission,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.distributions.moments import covariance_of

__all__ = ["Expansion", "PositionPath"]

#: A path stands when no window gains so many nats by a step.
GAIN = 1e-2
#: How often a step is halved.
SHORTER = 2
#: Least variance of a transition with limits in any direction, relative to the greatest.
LEAST_NOISE = 1e-6


class Expansion(NamedTuple):
    """Log-density of paths and observations about a path, to second order.

    Attributes
    ----------
    value
        What the frames have of the log-density there, ``(batch,)``.
    terms
        The rest, by displacements of the positions.
    """

    value: Tensor
    terms: PathTerms


class PositionPath:
    """Windows of a model with a kinematic transition, at fixed parameters.

    Parameters
    ----------
    model
        Its parameters must be fixed as long as this is used.
    batch
        Windows.
    """

    def __init__(self, model: StateSpaceModel, batch: SwarmBatch) -> None:
        if model.emission.is_exact or not isinstance(model.transition, KinematicTransition):
            raise ValueError("an emission and a kinematic transition are needed")
        self.model, self.batch = model, batch
        self.emission, self.transition = model.emission, model.transition
        self.space, self.dt = model.transition.space, model.transition.dt
        self.inputs = batch.steps()
        self.dtype = batch.observations.dtype
        self.there = batch.present
        self.seen = batch.mask & batch.present
        self.enters = batch.present.clone()
        self.enters[:, 1:] &= ~batch.present[:, :-1]
        self.persists = batch.present[:, 1:] & batch.present[:, :-1]
        self.everybody = bool(batch.present.all())
        none = torch.zeros_like(batch.present[:, :1])
        #: Which positions are free, ``(batch, time + 1, individual)``.
        self.free = torch.cat([none, batch.present], 1) | torch.cat([self.enters, none], 1)

    def positions(self, states: Tensor) -> Tensor:
        """Return the positions of a path, ``(batch, time + 1, individual, space)``."""
        here, velocity = states[..., : self.space], states[..., self.space :]
        before = here - self.dt * velocity
        found = torch.cat([before[:, :1], here], 1)
        if self.everybody:
            return found
        entering = torch.cat([self.enters, torch.zeros_like(self.enters[:, :1])], 1).unsqueeze(-1)
        return torch.where(entering, torch.cat([before, here[:, -1:]], 1), found)

    def states(self, positions: Tensor) -> Tensor:
        """Return the path ``(batch, time, individual, state)``; 0 where nobody is present."""
        velocity = (positions[:, 1:] - positions[:, :-1]) / self.dt
        found = torch.cat([positions[:, 1:], velocity], -1)
        return found if self.everybody else torch.where(self.there.unsqueeze(-1), found, 0.0)

    def expand(self, points: Points) -> Expansion:
        """Linearise transition and emission at points, and expand the log-density there.

        Parameters
        ----------
        points
            A path on which positions follow from velocities.
        """
        states = points.mean.to(self.dtype)
        frames = self._frames(states)
        if states.shape[1] == 1:
            return self._collect(frames, None)
        return self._collect(frames, self._steps(states, points.covariance))

    def evidence(self, expansion: Expansion) -> Tensor:
        """Return the log of the integral over paths, ``(batch,)``."""
        # From first states and later velocities to positions.
        counted = self.there.sum((1, 2)).double() * self.space
        return expansion.value + path_integral(expansion.terms) - math.log(self.dt) * counted

    def newton_step(self, expansion: Expansion) -> tuple[Tensor, Tensor, Tensor]:
        """Return the log-density at the path, and where the maximum of the expansion is.

        Returns
        -------
        ``(batch,)``; displacements of positions, ``(batch, time + 1, individual, space)``; and by
        how much the expansion promises to be greater there, ``(batch,)``.
        """
        with torch.no_grad():
            band, value = assemble(expansion.terms)
            shift = band_mean(band)
            predicted_gain = 0.5 * (shift * band.linear).sum((0, 2))
        split = torch.unflatten(shift, -1, (self.there.shape[-1], self.space)).transpose(0, 1)
        return expansion.value + value, split, predicted_gain

    def spread(self, expansion: Expansion) -> Tensor:
        """Return each individual's own covariance, ``(batch, time, individual, state, state)``."""
        with torch.no_grad():
            found = band_moments(assemble(expansion.terms)[0])
        joint = own_blocks_of(found, self.there.shape[-1])
        turn = self._turn(joint)
        spread = turn @ joint @ turn.mT
        if self.everybody:
            return spread
        return torch.where(self.there[..., None, None], spread, 0.0)

    def start(self) -> Points:
        """Return a path to begin with: smoothed as if nobody minded anybody.

        Velocities wander with twice the noise of the transition.
        """
        space, batch = self.space, self.batch
        initial = self.model.initial().mean.expand(*self.there[:, 0].shape, 2 * space)
        states = initial.unsqueeze(1).expand(*self.there.shape, 2 * space).clone()
        if _shows_positions(self.emission):
            shown = _filled(batch.observations[..., :space], self.seen)
            somewhere = self.seen.any(1)[:, None, :, None]
            states[..., :space] = torch.where(somewhere, shown, states[..., :space])
            difference = (states[:, 1:, :, :space] - states[:, :-1, :, :space]) / self.dt
            states[:, 1:, :, space:] = difference
            states[:, :1, :, space:] = difference[:, :1] if difference.shape[1] else 0.0
        spread = states.new_zeros(*states.shape, 2 * space)
        if states.shape[1] > 1:
            _, _, noise = self._steps(states, spread)
        positions = self.positions(states)
        states = self.states(positions)
        if states.shape[1] == 1:
            expansion = self._collect(self._frames(states), None)
        else:
            joint = states.shape[2] * space
            eye = torch.eye(joint, dtype=torch.float64, device=states.device) / self.dt
            slopes = torch.cat([-2.0 * eye, eye], -1).expand(*noise.shape[:2], joint, 2 * joint)
            change = (states[:, 1:, :, space:] - states[:, :-1, :, space:]).double()
            change = torch.where(self.persists.unsqueeze(-1), change, 0.0).flatten(-2)
            expansion = self._collect(self._frames(states), (change, slopes, 4.0 * noise))
        positions = positions + self.newton_step(expansion)[1]
        return Points(self.states(positions), self.spread(expansion))

    def maximise(self, start: Points, iterations: int) -> Points:
        """Return the most probable path and its spread.

        Steps of Gauss and Newton; in windows where one does not make the path more probable, it
        is shortened.

        Parameters
        ----------
        start
            Where to begin.
        iterations
            At most.
        """
        points = start._replace(mean=self.states(self.positions(start.mean)))
        expansion = self.expand(points)
        value, shift, predicted_gain = self.newton_step(expansion)
        for _ in range(iterations):
            if not bool((predicted_gain > GAIN).any()):
                break
            positions = self.positions(points.mean)
            length, worse = torch.ones_like(predicted_gain), torch.zeros_like(predicted_gain).bool()
            for halving in range(SHORTER + 1):
                if halving == SHORTER:
                    length = torch.where(worse, 0.0, length)
                moved = self.states(positions + length[:, None, None, None] * shift)
                trial = self.expand(points._replace(mean=moved))
                gained, ahead, further = self.newton_step(trial)
                worse = ~(gained >= value)
                if not bool(worse.any()):
                    break
                length = torch.where(worse, 0.5 * length, length)
            rise = gained - value
            points, expansion = points._replace(mean=moved), trial
            value, shift, predicted_gain = gained, ahead, further
            if not bool((rise > GAIN).any()):
                break
        return points._replace(covariance=self.spread(expansion))

    def _turn(self, like: Tensor) -> Tensor:
        """Return the map from positions ``[p_t, p_{t-1}]`` of an individual to its state."""
        eye = torch.eye(self.space, dtype=like.dtype, device=like.device)
        none = torch.zeros_like(eye)
        return torch.cat(
            [torch.cat([eye, none], -1), torch.cat([eye / self.dt, -eye / self.dt], -1)], -2
        )

    def _frames(self, states: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return value, gradient and curvature of what each individual has in each frame."""
        batch, space = self.batch, self.space
        line = self.emission.linearize(states)
        residual = (batch.observations - line.mean).double()
        seen = self.seen
        noise = line.noise.double()
        weights = self.emission.weights(residual)
        value, gradient, curvature = _gaussian(
            residual, line.jacobian.double(), noise / weights[..., None, None]
        )
        if self.emission.has_heavy_tails:
            # The reweighted Gaussian has the slope of the heavy-tailed density, not its value.
            value = self.emission(states).log_prob(batch.observations).double()
        if not bool(seen.all()):
            value = torch.where(seen, value, 0.0)
            gradient = torch.where(seen.unsqueeze(-1), gradient, 0.0)
            curvature = torch.where(seen[..., None, None], curvature, 0.0)
        initial = self.model.initial()
        rows = self.enters if not self.everybody else self.enters[:, :1]
        count = rows.shape[1]
        mean = initial.mean.expand(len(seen), seen.shape[-1], 2 * space).unsqueeze(1)
        spread = covariance_of(initial).expand(len(seen), seen.shape[-1], 2 * space, 2 * space)
        eye = torch.eye(2 * space, dtype=torch.float64, device=mean.device)
        first = _gaussian(
            (mean - states[:, :count]).double(),
            eye.expand(*rows.shape, *eye.shape),
            spread.unsqueeze(1).double(),
        )
        first_value = torch.where(rows, first[0], 0.0)
        first_gradient = torch.where(rows.unsqueeze(-1), first[1], 0.0)
        first_curvature = torch.where(rows[..., None, None], first[2], 0.0)
        if count == value.shape[1]:
            return value + first_value, gradient + first_gradient, curvature + first_curvature
        return (
            torch.cat([value[:, :1] + first_value, value[:, 1:]], 1),
            torch.cat([gradient[:, :1] + first_gradient, gradient[:, 1:]], 1),
            torch.cat([curvature[:, :1] + first_curvature, curvature[:, 1:]], 1),
        )

    def _steps(self, states: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return residuals, Jacobians by ``[p_t, p_{t-1}]`` and precisions of all steps.

        ``(batch, step, joint)``, ``(batch, step, joint, 2 * joint)`` and
        ``(batch, step, individual, space, space)`` with ``joint = individual * space``.
        """
        space, dt = self.space, self.dt
        before = states[:, :-1]
        inputs = self.model.edges.complete(before, self.inputs)
        covariance = covariance[:, :-1].to(self.dtype)
        velocity, jacobian, noise = self.transition.linearize_velocity(before, inputs, covariance)
        residual = (states[:, 1:, :, space:] - velocity).double()
        noise = noise.double()
        if not self.transition.is_smooth:
            # Behind a limit of speed nothing is left of the noise along the velocity.
            size = noise.diagonal(dim1=-2, dim2=-1).amax(-1)[..., None, None]
            eye = torch.eye(space, dtype=noise.dtype, device=noise.device)
            noise = noise + LEAST_NOISE * size * eye
        if not self.everybody:
            persists, there = self.persists, self.there[:, :-1]
            residual = torch.where(persists.unsqueeze(-1), residual, 0.0)
            linked = persists[..., :, None, None, None] & there[..., None, None, :, None]
            jacobian = torch.where(linked, jacobian, 0.0)
            eye = torch.eye(space, dtype=noise.dtype, device=noise.device)
            noise = torch.where(persists[..., None, None], noise, eye)
        joint = residual.shape[-2] * space
        by_position = jacobian[..., :space].flatten(-4, -3).flatten(-2).double()
        by_velocity = jacobian[..., space:].flatten(-4, -3).flatten(-2).double() / dt
        eye = torch.eye(joint, dtype=torch.float64, device=residual.device) / dt
        # Of v_{t+1} - f(z_t), with v_{t+1} = (p_{t+1} - p_t) / dt.
        slopes = torch.cat([-(eye + by_position + by_velocity), by_velocity], -1)
        return residual.flatten(-2), slopes, noise

    def _collect(
        self,
        frames: tuple[Tensor, Tensor, Tensor],
        steps: tuple[Tensor, Tensor, Tensor] | None,
    ) -> Expansion:
        """Put frames and steps together."""
        value, gradient, curvature = frames
        turn = self._turn(curvature)
        if steps is None:
            joint = self.there.shape[-1] * self.space
            none = gradient.new_zeros(len(gradient), 0, joint)
            square = gradient.new_zeros(len(gradient), 0, joint, 2 * joint)
            noise = gradient.new_zeros(len(gradient), 0, self.there.shape[-1], *[self.space] * 2)
            steps = none, square, noise
        idle = None if self.everybody else (~self.free).repeat_interleave(self.space, -1)
        terms = PathTerms(
            gradient @ turn, turn.mT @ curvature @ turn, *steps, self.persists, idle, self.dt
        )
        return Expansion(value.sum((-1, -2)), terms)


def _shows_positions(emission: Emission) -> bool:
    """Return whether the first observed features are positions."""
    return isinstance(emission, PositionEmission | StateEmission)


def _filled(values: Tensor, seen: Tensor) -> Tensor:
    """Return values with gaps filled by the last ones before, or else the first ones after."""
    times = torch.arange(seen.shape[1], device=seen.device).view(1, -1, 1)
    last = torch.where(seen, times, -1).cummax(1).values
    first = torch.where(seen, times, seen.shape[1]).flip(1).cummin(1).values.flip(1)
    index = torch.where(last >= 0, last, first.clamp(max=seen.shape[1] - 1))
    return values.gather(1, index.unsqueeze(-1).expand(values.shape))


def _gaussian(residual: Tensor, jacobian: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return log-density, gradient and curvature of ``residual - J dz`` with covariance noise."""
    factor = torch.linalg.cholesky(noise)
    both = torch.cat([jacobian, residual.unsqueeze(-1)], -1)
    white = torch.linalg.solve_triangular(factor, both, upper=False)
    inner = white[..., :-1].mT @ white
    spread = 2.0 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    penalty = spread + residual.shape[-1] * math.log(2.0 * math.pi)
    value = -0.5 * (white[..., -1].square().sum(-1) + penalty)
    return value, inner[..., -1], inner[..., :-1]
