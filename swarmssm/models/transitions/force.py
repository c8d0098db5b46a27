"""Transitions made of forces: of neighbours, walls, speed regulation, limits of speed, noise."""

import math
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import pyro.distributions as dist
import torch
from pyro.distributions import constraints
from torch import Tensor
from torch.func import jacfwd, vmap

from swarmssm import forces
from swarmssm.errors import InputError
from swarmssm.graphs import Graph, dense
from swarmssm.models.distributions.speed_limits import TOLERANCE, SpeedLimited, limited_moments
from swarmssm.models.markov import StepInputs
from swarmssm.models.pyro_modules import priors_in
from swarmssm.models.transitions.base import KinematicTransition, Linearization
from swarmssm.models.transitions.hierarchy import assign_hierarchical
from swarmssm.models.transitions.perception import without_absent
from swarmssm.models.transitions.protocols import Box, Form
from swarmssm.models.transitions.walls import wall_push
from swarmssm.models.units import Dimension

__all__ = ["ForceTransition", "Noise", "PairDerivative"]

Noise = Literal["additive", "multiplicative"]
#: Under multiplicative noise a speed below this counts as this, so that the density stays finite.
LEAST_SPEED = 1e-6


class PairDerivative(NamedTuple):
    """The sum of the pair forces, and how it changes with what a pair differs by.

    Attributes
    ----------
    force
        ``(..., individual, space)``.
    jacobian
        ``(..., individual, space, individual, state)``: ``[i, a, j, b]`` is the derivative of the
        force's coordinate a on i by feature b of ``state_j - state_i``.
    own
        ``(..., individual, space, state)``: derivative by one's own state beside that; ``None`` if
        there is none.
    """

    force: Tensor
    jacobian: Tensor
    own: Tensor | None = None


class ForceTransition(KinematicTransition):
    r"""Velocities that are changed by pair forces and by what an individual does by itself.

    With the sum F of the pair forces of a subclass, the wall W and the speed regulation
    :math:`R = (v_0 - |v|)\, v / |v|` of :mod:`swarmssm.forces`,

    * ``form="acceleration"``: :math:`v' = v + dt\,(F + k_w W + k_d R) + \epsilon`;
    * ``form="velocity"``: :math:`v' = F + k_w W + k_d R + \epsilon`,

    its length then brought between the limits of speed, if there are any, and
    :math:`p' = p + dt\, v'`.

    A subclass writes :attr:`pair_terms` and :meth:`pair_forces`, may write
    :meth:`pair_derivative` in closed form, and calls :meth:`assign_self_terms` after it has
    assigned parameters of its own.

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
    limit_tolerance
        What counts as being at a limit of speed, relative to it.

    Raises
    ------
    InputError
        If an option is none of the above.
    """

    def __init__(
        self,
        space: int,
        dt: float,
        *,
        form: Form = "acceleration",
        noise: Noise = "additive",
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
        self._form = form
        self.noise = noise
        self.limit_tolerance = limit_tolerance

    @property
    def dimensions(self) -> dict[str, Dimension]:
        """Powers of length and time in the units of parameters, see :mod:`swarmssm.models.units`.

        A force times ``force_time`` is a velocity.
        """
        time = self.force_time
        additive = self.noise == "additive"
        return {
            "process_noise": (1, -1.5) if additive else (0, 0),
            "wall_gain": (0, -1 - time),
            "half_width": (1, 0),
            "center": (1, 0),
            "relaxation_gain": (0, -time),
            "preferred_speed": (1, -1),
            "min_speed": (1, -1),
            "max_speed": (1, -1),
        }

    @property
    def force_time(self) -> int:
        """Power of time between a velocity and a force: 1 of accelerations, 0 of velocities."""
        return 1 if self.form == "acceleration" else 0

    def assign_self_terms(
        self,
        *,
        process_noise: Any,
        wall_gain: Any = None,
        half_width: Any = None,
        center: Any = 0.0,
        relaxation_gain: Any = None,
        preferred_speed: Any = None,
        min_speed: Any = None,
        max_speed: Any = None,
    ) -> None:
        r"""Assign the parameters of what an individual does by itself.

        Each is one for all or ``(individual,)``, but for those of the box.

        Parameters
        ----------
        process_noise
            Strength of the noise.
        wall_gain, half_width, center
            :math:`k_w`, and half the sides and the middle of the box: a number for all axes or
            ``(space,)``. Without a gain there is no wall.
        relaxation_gain, preferred_speed
            :math:`k_d, v_0`. Without a gain there is no speed regulation.
        min_speed, max_speed
            Limits of speed. With one of them the next velocity has the density of
            :class:`~swarmssm.models.distributions.speed_limits.SpeedLimited`, which has atoms.

        Raises
        ------
        InputError
            If a parameter lacks the one it goes with, or a value is out of range.
        """
        for needs, needed, gain, other in (
            ("wall_gain", "half_width", wall_gain, half_width),
            ("relaxation_gain", "preferred_speed", relaxation_gain, preferred_speed),
        ):
            if gain is not None and other is None:
                raise InputError(f"{needed}: with a {needs} it must be given.")
        self.has_wall = wall_gain is not None
        self.has_regulation = relaxation_gain is not None
        self.has_low, self.has_high = min_speed is not None, max_speed is not None
        if self.has_wall:
            box: list[tuple[int, ...]] = [(), (self.space,)]
            self.assign_parameter("wall_gain", wall_gain, constraints.real)
            self.assign_parameter("half_width", half_width, constraints.positive, box)
            self.assign_parameter("center", center, constraints.real, box)
        if self.has_regulation:
            self.assign_parameter("relaxation_gain", relaxation_gain, constraints.real)
            self.assign_parameter("preferred_speed", preferred_speed, constraints.positive)
        if self.has_low:
            self.assign_parameter("min_speed", min_speed, constraints.nonnegative)
        if self.has_high:
            self.assign_parameter("max_speed", max_speed, constraints.positive)
        self.assign_parameter("process_noise", process_noise, constraints.positive)

    def assign_parameter(
        self,
        name: str,
        value: Any,
        constraint: Any,
        shapes: list[tuple[int, ...]] | None = None,
    ) -> None:
        """Assign a parameter, one for all or ``(individual,)`` unless shapes are given."""
        shapes = [(), (-1,)] if shapes is None else shapes
        assign_hierarchical(self, name, value, constraint=constraint, shapes=shapes)

    @property
    def pair_terms(self) -> tuple[str, ...]:
        """Names of the terms of :meth:`pair_forces`, in their order."""
        raise TypeError(f"{type(self).__name__} must define pair_terms")

    def pair_forces(self, states: Tensor, graph: Graph) -> Tensor:
        """Return what each pair force contributes, its gain included.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        graph
            Of those who are there.

        Returns
        -------
        ``(..., term, individual, space)``.
        """
        raise TypeError(f"{type(self).__name__} must define pair_forces(states, graph)")

    def pair_derivative(self, states: Tensor, adjacency: Tensor, rate: float) -> PairDerivative:
        """Return the sum of the pair forces, and its derivatives.

        Here by forward-mode differentiation; a closed form takes a fraction of the time.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        adjacency
            ``(..., individual, individual)``, of those who are there.
        rate
            Factor of it all, best put into the gains, which are the smallest tensors.
        """

        def summed(at: Tensor, weights: Tensor) -> Tensor:
            force: Tensor = rate * self.pair_forces(at, weights).sum(-3)
            return force

        shape, graph = states.shape, adjacency.shape[-2:]
        weights = adjacency.expand(*shape[:-2], *graph).reshape(-1, *graph)
        jacobian = vmap(jacfwd(summed))(states.reshape(-1, *shape[-2:]), weights)
        jacobian = jacobian.reshape(*shape[:-1], self.space, *shape[-2:])
        return PairDerivative(summed(states, adjacency), jacobian, jacobian.sum(-2))

    def pairwise(self, states: Tensor, inputs: StepInputs) -> Tensor:
        """Return what the pair forces add to the next velocity."""
        found = self.pair_forces(states, self._graph(states, inputs)).sum(-3)
        if inputs.present is not None:
            found = found * inputs.present.unsqueeze(-1).to(found.dtype)
        return self._rate * found

    #: See :class:`~swarmssm.models.Transition`.
    self_parameter_names: ClassVar[tuple[str, ...]] = (
        "wall_gain",
        "half_width",
        "center",
        "relaxation_gain",
        "preferred_speed",
        "min_speed",
        "max_speed",
        "process_noise",
    )

    def drop_self_terms(self) -> None:
        """Give up walls, speed regulation, limits and noise."""
        super().drop_self_terms()
        self.has_wall = self.has_regulation = self.has_low = self.has_high = False

    def box(self) -> Box | None:
        """Return where the walls are; ``None``, if there are none."""
        return Box(self.half_width, self.center) if self.has_wall else None

    @property
    def form(self) -> Form:
        """``"acceleration"`` or ``"velocity"``."""
        return self._form

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
        names = [*self.pair_terms]
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
        social = self.pair_forces(states, self._graph(states, inputs))
        own = []
        if self.has_wall:
            push = forces.wall(positions, self._by_axis("half_width"), self._by_axis("center"))
            own.append(self.wall_gain.unsqueeze(-1) * push)
        if self.has_regulation:
            pull = forces.speed_regulation(velocities, self.preferred_speed)
            own.append(self.relaxation_gain.unsqueeze(-1) * pull)
        terms = torch.broadcast_tensors(*social.unbind(-3), *own)  # type: ignore[no-untyped-call]
        summed = torch.stack(terms, -3)
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
        (``limited_moments``) with the covariance of the next
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
        graph = dense(self._graph(mean, inputs), mean.dtype)
        pairs = self.pair_derivative(mean, graph, self._rate)
        moved, own = self._own(mean, inputs, covariance)
        moved = moved + pairs.force
        # By one's own state, the derivative of what depends on differences is minus that by others.
        diagonal = own - pairs.jacobian.sum(-2)
        if pairs.own is not None:
            diagonal = diagonal + pairs.own
        jacobian = pairs.jacobian + each * diagonal.unsqueeze(-2)
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
    def _rate(self) -> float:
        """What a force adds to the next velocity by."""
        return self.dt if self.form == "acceleration" else 1.0

    @property
    def _limits(self) -> tuple[Tensor | float, Tensor | float]:
        low = self.min_speed if self.has_low else 0.0
        return low, self.max_speed if self.has_high else math.inf

    def _graph(self, states: Tensor, inputs: StepInputs) -> Graph:
        """Return the graph of those who are there; without any, nobody sees anybody."""
        if inputs.adjacency is None:
            return states.new_zeros(states.shape[-2], states.shape[-2])
        return without_absent(inputs.adjacency, inputs.present)

    def _by_axis(self, name: str) -> Tensor:
        """Return a parameter of the box, which broadcasts against ``(..., space)``."""
        value: Tensor = getattr(self, name)
        prior = priors_in(self).get(name)
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
        rate: float | Tensor = self._rate
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
