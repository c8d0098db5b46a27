"""Cohesion, separation and alignment, with gains, walls and limits of speed to be inferred."""

import math
from typing import Any, Literal, get_args

import pyro.distributions as dist
import torch
from pyro.distributions import constraints
from torch import Tensor

from swarmssm import forces
from swarmssm.errors import InputError
from swarmssm.graphs import Graph, dense
from swarmssm.models.markov import StepInputs
from swarmssm.models.speed_limits import TOLERANCE, SpeedLimited, limited_moments
from swarmssm.models.transitions.base import KinematicTransition, Linearization
from swarmssm.models.transitions.boids_pairs import PairLaw, wall_push
from swarmssm.models.transitions.hierarchy import assign_hierarchical
from swarmssm.models.transitions.perception import perceive, without_absent

__all__ = ["BoidsTransition", "Form", "Noise"]

Form = Literal["acceleration", "velocity"]
Noise = Literal["additive", "multiplicative"]
#: Under multiplicative noise a speed below this counts as this, so that the density stays finite.
LEAST_SPEED = 1e-6


class BoidsTransition(KinematicTransition):
    r"""The boids law, (3.16)-(3.20) of the thesis, with soft walls and limits of speed.

    With the terms C, S and :math:`\bar v` of :mod:`swarmssm.forces` among the neighbours, the wall
    W and the speed regulation :math:`R = (v_0 - |v|)\, v / |v|`,

    * ``form="acceleration"``:
      :math:`v' = v + dt\,(k_c C + k_s S + k_a (\bar v_j - v) + k_w W + k_d R) + \epsilon`;
    * ``form="velocity"``, (3.19):
      :math:`v' = k_c C + k_s S + k_a \bar v_j + k_w W + k_d R + \epsilon`,

    its length then brought between the limits of speed, if there are any, and
    :math:`p' = p + dt\, v'`. It is the law of :func:`swarmssm.simulate.simulate_boids`.

    Parameters
    ----------
    space
        Number of spatial dimensions, 2 or 3.
    dt
        Seconds from one frame to the next.
    form
        ``"acceleration"`` or ``"velocity"``.
    noise
        ``"additive"``: :math:`\epsilon` has the standard deviation ``process_noise * sqrt(dt)`` in
        each coordinate; ``"multiplicative"``: ``process_noise * |v|``.
    cohesion_gain, separation_gain, alignment_gain
        :math:`k_c, k_s, k_a`.
    process_noise
        Its strength.
    exponent
        n of (3.17): a neighbour at distance d pushes with ``d ** -n``.
    wall_gain, half_width, center
        :math:`k_w`, and half the sides and the middle of the box: a number for all axes or
        ``(space,)``. Without a gain there is no wall.
    relaxation_gain, preferred_speed
        :math:`k_d, v_0`. Without a gain there is no speed regulation.
    min_speed, max_speed
        Limits of speed. With one of them the next velocity has the density of
        :class:`~swarmssm.models.speed_limits.SpeedLimited`, which has atoms.
    radius
        How far an individual sees, among those whom the graph lets it see. Absent, the graph is
        taken as it stands.
    radius_width
        Over what distance the view fades out at the radius, see
        :mod:`swarmssm.models.transitions.perception`. 0: at once, and nothing can be learned of the
        radius by gradients.
    softening
        Length that bounds the push of (3.17) at short distance; see
        :func:`swarmssm.forces.separation`.
    limit_tolerance
        What counts as being at a limit of speed, relative to it.

    All from ``cohesion_gain`` to ``radius_width`` are parameters: a number or tensor is fixed, a
    distribution is a prior, a :class:`torch.nn.Parameter` is learned
    (:func:`swarmssm.models.parameters.assign`), and a
    :class:`~swarmssm.models.transitions.Hierarchical` is inferred for each individual and for the
    population. But for those of the box, each is one for all or ``(individual,)``.

    Raises
    ------
    InputError
        If an option is none of the above, a parameter lacks the one it goes with, or a value is
        out of range.
    """

    def __init__(
        self,
        space: int,
        dt: float,
        *,
        cohesion_gain: Any,
        separation_gain: Any,
        alignment_gain: Any,
        process_noise: Any,
        form: Form = "acceleration",
        noise: Noise = "additive",
        exponent: Any = 1.0,
        wall_gain: Any = None,
        half_width: Any = None,
        center: Any = 0.0,
        relaxation_gain: Any = None,
        preferred_speed: Any = None,
        min_speed: Any = None,
        max_speed: Any = None,
        radius: Any = None,
        radius_width: Any = 0.0,
        softening: float = 0.0,
        limit_tolerance: float = TOLERANCE,
    ) -> None:
        super().__init__(space, dt)
        for option, given, allowed in (
            ("form", form, get_args(Form)),
            ("noise", noise, get_args(Noise)),
        ):
            if given not in allowed:
                raise InputError(
                    f"{option}: it must be one of {', '.join(allowed)}, not {given!r}."
                )
        for needs, needed, gain, other in (
            ("wall_gain", "half_width", wall_gain, half_width),
            ("relaxation_gain", "preferred_speed", relaxation_gain, preferred_speed),
        ):
            if gain is not None and other is None:
                raise InputError(f"{needed}: with a {needs} it must be given.")
        self.form = form
        self.noise = noise
        self.softening = softening
        self.limit_tolerance = limit_tolerance
        self.has_wall = wall_gain is not None
        self.has_regulation = relaxation_gain is not None
        self.has_low, self.has_high = min_speed is not None, max_speed is not None
        self.has_radius = radius is not None
        self.is_sharp = isinstance(radius_width, int | float) and radius_width == 0

        each: list[tuple[int, ...]] = [(), (-1,)]
        self._give("cohesion_gain", cohesion_gain, constraints.real, each)
        self._give("separation_gain", separation_gain, constraints.real, each)
        self._give("alignment_gain", alignment_gain, constraints.real, each)
        self._give("exponent", exponent, constraints.nonnegative, each)
        if self.has_wall:
            box: list[tuple[int, ...]] = [(), (space,)]
            self._give("wall_gain", wall_gain, constraints.real, each)
            self._give("half_width", half_width, constraints.positive, box)
            self._give("center", center, constraints.real, box)
        if self.has_regulation:
            self._give("relaxation_gain", relaxation_gain, constraints.real, each)
            self._give("preferred_speed", preferred_speed, constraints.positive, each)
        if self.has_radius:
            self._give("radius", radius, constraints.positive, each)
            if not self.is_sharp:
                self._give("radius_width", radius_width, constraints.positive, each)
        if self.has_low:
            self._give("min_speed", min_speed, constraints.nonnegative, each)
        if self.has_high:
            self._give("max_speed", max_speed, constraints.positive, each)
        self._give("process_noise", process_noise, constraints.positive, each)

    def _give(self, name: str, value: Any, constraint: Any, shapes: list[tuple[int, ...]]) -> None:
        assign_hierarchical(self, name, value, constraint=constraint, shapes=shapes)

    @property
    def has_limits(self) -> bool:
        """Whether speed is limited."""
        return self.has_low or self.has_high

    @property
    def is_smooth(self) -> bool:
        """Whether next velocities have a density without atoms: not with limits of speed."""
        return not self.has_limits

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms of :meth:`forces`, in their order."""
        names = ["cohesion", "separation", "alignment"]
        names += ["wall"] if self.has_wall else []
        names += ["speed_regulation"] if self.has_regulation else []
        return tuple(names)

    def forces(self, states: Tensor, inputs: StepInputs) -> Tensor:
        """Return what each term contributes, its gain included.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        inputs
            As in :meth:`forward`.

        Returns
        -------
        ``(..., term, individual, space)``, in the order of :attr:`terms`: accelerations, or
        velocities in the velocity form. 0 for an individual that is absent.
        """
        positions, velocities = states[..., : self.space], states[..., self.space :]
        graph = self._graph(states, inputs)
        relative = self.form == "acceleration"
        if self.has_radius:
            seen = perceive(
                positions,
                velocities,
                graph,
                self.radius,
                self._radius_width,
                self.exponent,
                self.softening,
            )
            social = [
                seen.cohesion,
                seen.separation,
                seen.alignment if relative else seen.mean_velocity,
            ]
        else:
            social = [
                forces.cohesion(positions, graph),
                forces.separation(positions, graph, self.exponent, self.softening),
                forces.alignment(velocities, graph, relative=relative),
            ]
        gains = [self.cohesion_gain, self.separation_gain, self.alignment_gain]
        if self.has_wall:
            gains.append(self.wall_gain)
            social.append(
                forces.wall(positions, self._by_axis("half_width"), self._by_axis("center"))
            )
        if self.has_regulation:
            gains.append(self.relaxation_gain)
            social.append(forces.speed_regulation(velocities, self.preferred_speed))
        weighted = [g.unsqueeze(-1) * term for g, term in zip(gains, social, strict=True)]
        summed = torch.stack(torch.broadcast_tensors(*weighted), -3)  # type: ignore[no-untyped-call]
        if inputs.present is not None:
            summed = summed * inputs.present[..., None, :, None].to(summed.dtype)
        return summed

    def velocity(
        self, positions: Tensor, velocities: Tensor, inputs: StepInputs
    ) -> dist.TorchDistribution:
        """Return the distribution of the next velocities."""
        force = self.forces(torch.cat([positions, velocities], -1), inputs).sum(-3)
        moved = velocities + self.dt * force if self.form == "acceleration" else force
        scale = self._variance(velocities, inputs).sqrt()
        if not self.has_limits:
            return dist.Normal(moved, scale.unsqueeze(-1)).to_event(1)
        return SpeedLimited(moved, scale, *self._limits, tolerance=self.limit_tolerance)

    def linearize(
        self, mean: Tensor, inputs: StepInputs, covariance: Tensor | None = None
    ) -> Linearization:
        """Linearise at given states, in closed form; see :meth:`linearize_velocity`."""
        space, dt = self.space, self.dt
        eye = torch.eye(space, dtype=mean.dtype, device=mean.device)
        each = torch.eye(mean.shape[-2], dtype=mean.dtype, device=mean.device)[:, None, :, None]
        moved, jacobian, noise = self.linearize_velocity(mean, inputs, covariance)
        still = torch.cat([eye, torch.zeros_like(eye)], -1)
        jacobian = torch.cat([dt * jacobian + each * still[:, None, :], jacobian], -3)
        following = torch.cat([mean[..., :space] + dt * moved, moved], -1)
        # The same noise moves the position, dt times as far.
        block = torch.cat([dt * noise, noise], -1)
        return Linearization(following, jacobian, torch.cat([dt * block, block], -2))

    def linearize_velocity(
        self, mean: Tensor, inputs: StepInputs, covariance: Tensor | None = None
    ) -> Linearization:
        r"""Linearise the next velocities at given states, in closed form.

        Walls and limits have kinks, and multiplicative noise depends on the speed. With a
        covariance these are averaged over the uncertainty of each individual's own state, so that
        all is smooth in the parameters: the expected push of the wall and its expected derivative,
        :math:`E|v|^2` in the variance, and the limits statistically linearised
        (:func:`~swarmssm.models.speed_limits.limited_moments`) with the covariance of the next
        velocity. Without one, walls and noise are those of the given states, and the limits are
        linearised with the noise alone.

        Parameters
        ----------
        mean, inputs, covariance
            As in :meth:`KinematicTransition.linearize_velocity`.
        """
        space = self.space
        eye = torch.eye(space, dtype=mean.dtype, device=mean.device)
        each = torch.eye(mean.shape[-2], dtype=mean.dtype, device=mean.device)[:, None, :, None]
        velocities = mean[..., space:]
        social = self._pair_law()(mean, dense(self._graph(mean, inputs), mean.dtype))
        moved, own = self._own(mean, inputs, covariance)
        moved = moved + social.force
        # By one's own state, the derivative of what depends on differences is minus that by others.
        diagonal = own - social.pairs.sum(-2)
        if self.form == "velocity":
            lift = torch.cat([torch.zeros_like(eye), eye], -1)
            diagonal = diagonal + social.own[..., None, None] * lift
        jacobian = social.pairs + each * diagonal.unsqueeze(-2)
        variance = self._variance(velocities, inputs, covariance)
        noise = variance[..., None, None] * eye
        if self.has_limits:
            spread = noise
            if covariance is not None:
                # The diagonal blocks, (..., individual, space, state).
                block = jacobian.diagonal(dim1=-4, dim2=-2).movedim(-1, -3)
                spread = spread + block @ covariance @ block.mT
            limited = limited_moments(moved, spread, *self._limits)
            moved = limited.mean
            shape = jacobian.shape
            jacobian = (limited.gain @ jacobian.flatten(-2)).reshape(shape)
            noise = variance[..., None, None] * (limited.gain @ limited.gain.mT) + limited.residual
        return Linearization(moved, jacobian, noise)

    @property
    def _limits(self) -> tuple[Tensor | float, Tensor | float]:
        low = self.min_speed if self.has_low else 0.0
        return low, self.max_speed if self.has_high else math.inf

    @property
    def _radius_width(self) -> Tensor | None:
        return None if self.is_sharp else self.radius_width

    def _graph(self, states: Tensor, inputs: StepInputs) -> Graph:
        """Return the graph of those who are there; without any, nobody sees anybody."""
        if inputs.adjacency is None:
            return states.new_zeros(states.shape[-2], states.shape[-2])
        return without_absent(inputs.adjacency, inputs.present)

    def _pair_law(self) -> PairLaw:
        """Return the social terms with gains as they add to the next velocity."""
        rate = self.dt if self.form == "acceleration" else 1.0
        return PairLaw(
            rate * self.cohesion_gain,
            rate * self.separation_gain,
            rate * self.alignment_gain,
            self.exponent,
            self.softening,
            self.radius if self.has_radius else None,
            self._radius_width if self.has_radius else None,
            self.form == "acceleration",
        )

    def _by_axis(self, name: str) -> Tensor:
        """Return a parameter of the box, which broadcasts against ``(..., space)``."""
        value: Tensor = getattr(self, name)
        prior = self._pyro_samples.get(name)
        dims = len(prior.event_shape) if isinstance(prior, dist.Distribution) else value.dim()
        return value if dims == 1 else value.unsqueeze(-1)

    def _variance(
        self, velocities: Tensor, inputs: StepInputs, covariance: Tensor | None = None
    ) -> Tensor:
        """Return the variance of a coordinate of the noise, ``(..., individual)``."""
        if self.noise == "additive":
            variance: Tensor = self.process_noise.square() * self.dt
            return variance.expand(
                torch.broadcast_shapes(variance.shape, velocities.shape[:-1])  # type: ignore[no-untyped-call]
            )
        squared = velocities.square().sum(-1)
        if covariance is not None:
            own = covariance[..., self.space :, self.space :]
            squared = squared + own.diagonal(dim1=-2, dim2=-1).sum(-1)
        if inputs.present is not None:
            squared = torch.where(inputs.present, squared, 1.0)
        strength: Tensor = self.process_noise.square()
        return strength * squared.clamp(min=LEAST_SPEED**2)

    def _own(
        self, mean: Tensor, inputs: StepInputs, covariance: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Return what an individual does by itself to its next velocity, and the derivative.

        ``(..., individual, space)`` and ``(..., individual, space, state)``.
        """
        space = self.space
        positions, velocities = mean[..., :space], mean[..., space:]
        eye = torch.eye(space, dtype=mean.dtype, device=mean.device)
        accelerates = self.form == "acceleration"
        rate: float | Tensor = self.dt if accelerates else 1.0
        force = velocities if accelerates else torch.zeros_like(velocities)
        by_position = torch.zeros_like(eye)
        by_velocity = eye if accelerates else torch.zeros_like(eye)
        if inputs.present is not None:
            rate = rate * inputs.present.to(mean.dtype)
        if self.has_wall:
            gain = (rate * self.wall_gain).unsqueeze(-1)
            spread = None
            if covariance is not None:
                spread = covariance[..., :space, :space].diagonal(dim1=-2, dim2=-1)
            offset = positions - self._by_axis("center")
            push = wall_push(offset, self._by_axis("half_width"), spread)
            force = force + gain * push.mean
            by_position = by_position + torch.diag_embed(gain * push.slope)
        if self.has_regulation:
            gain = (rate * self.relaxation_gain).unsqueeze(-1)
            squared = velocities.square().sum(-1, keepdim=True)
            moving = squared > 0
            squared = torch.where(moving, squared, 1.0)
            ratio = self.preferred_speed.unsqueeze(-1) * squared.rsqrt()
            factor = torch.where(moving, gain * (ratio - 1.0), 0.0)
            pull = torch.where(moving, gain * ratio / squared, 0.0)
            force = force + factor * velocities
            outer = velocities.unsqueeze(-1) * velocities.unsqueeze(-2)
            by_velocity = by_velocity + factor.unsqueeze(-1) * eye - pull.unsqueeze(-1) * outer
        by_position, by_velocity = torch.broadcast_tensors(by_position, by_velocity)  # type: ignore[no-untyped-call]
        return force, torch.cat([by_position, by_velocity], -1)
