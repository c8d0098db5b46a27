"""Cohesion, separation and alignment, with gains, walls and limits of speed to be inferred."""

from typing import Any, ClassVar

import torch
from pyro.distributions import constraints
from torch import Tensor

from swarmssm import forces
from swarmssm.graphs import Graph
from swarmssm.models.distributions.speed_limits import TOLERANCE
from swarmssm.models.pyro_modules import priors_in
from swarmssm.models.transitions.boids_pairs import BoidsPairs
from swarmssm.models.transitions.force import ForceTransition, Noise, PairDerivative
from swarmssm.models.transitions.perception import perceive, sight
from swarmssm.models.transitions.protocols import Form, PairKernel, View
from swarmssm.models.units import Dimension

__all__ = ["BoidsTransition"]


class BoidsTransition(ForceTransition):
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
        :class:`~swarmssm.models.distributions.speed_limits.SpeedLimited`, which has atoms.
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
        super().__init__(space, dt, form=form, noise=noise, limit_tolerance=limit_tolerance)
        self.softening = softening
        self.has_radius = radius is not None
        self.is_sharp = isinstance(radius_width, int | float) and radius_width == 0
        self.assign_parameter("cohesion_gain", cohesion_gain, constraints.real)
        self.assign_parameter("separation_gain", separation_gain, constraints.real)
        self.assign_parameter("alignment_gain", alignment_gain, constraints.real)
        self.assign_parameter("exponent", exponent, constraints.nonnegative)
        if self.has_radius:
            self.assign_parameter("radius", radius, constraints.positive)
            if not self.is_sharp:
                self.assign_parameter("radius_width", radius_width, constraints.positive)
        self.assign_self_terms(
            process_noise=process_noise,
            wall_gain=wall_gain,
            half_width=half_width,
            center=center,
            relaxation_gain=relaxation_gain,
            preferred_speed=preferred_speed,
            min_speed=min_speed,
            max_speed=max_speed,
        )

    @property
    def dimensions(self) -> dict[str, Dimension]:
        """See :attr:`ForceTransition.dimensions`; separation has a unit where n is known."""
        time = self.force_time
        own: dict[str, Dimension] = {
            "cohesion_gain": (0, -1 - time),
            "alignment_gain": (0, -time),
            "exponent": (0, 0),
            "radius": (1, 0),
            "radius_width": (1, 0),
        }
        if "exponent" not in priors_in(self):
            own["separation_gain"] = (1 + float(self.exponent.mean()), -1 - time)
        return super().dimensions | own

    @property
    def pair_terms(self) -> tuple[str, ...]:
        """Cohesion, separation, alignment."""
        return ("cohesion", "separation", "alignment")

    def pair_forces(self, states: Tensor, graph: Graph) -> Tensor:
        """Return the three terms; see :meth:`ForceTransition.pair_forces`."""
        positions, velocities = states[..., : self.space], states[..., self.space :]
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
        weighted = [g.unsqueeze(-1) * term for g, term in zip(gains, social, strict=True)]
        return torch.stack(torch.broadcast_tensors(*weighted), -3)  # type: ignore[no-untyped-call]

    def pair_derivative(self, states: Tensor, adjacency: Tensor, rate: float) -> PairDerivative:
        """Return the sum of the terms and its derivatives; see the base class."""
        return BoidsPairs(
            rate * self.cohesion_gain,
            rate * self.separation_gain,
            rate * self.alignment_gain,
            self.exponent,
            self.softening,
            self.radius if self.has_radius else None,
            self._radius_width if self.has_radius else None,
            self.form == "acceleration",
        )(states, adjacency)

    #: How each of :meth:`kernels` becomes a force.
    kernel_kinds: ClassVar[dict[str, PairKernel]] = {
        "attraction": PairKernel("offset", "mean"),
        "repulsion": PairKernel("offset", "sum"),
        "alignment": PairKernel("velocity", "mean"),
    }

    def kernels(self, distance: Tensor) -> dict[str, Tensor]:
        r"""Return what a neighbour at a distance does: :math:`k_c r, -k_s r^{-n}` and :math:`k_a`.

        Parameters
        ----------
        distance
            ``(distance,)``, positive.

        Returns
        -------
        ``"attraction"`` and ``"repulsion"`` along the unit vector to the neighbour, negative for
        away, and ``"alignment"``, the factor of the difference of velocities; each ``(distance,)``,
        or ``(individual, distance)`` where gains differ. Beyond a radius all are 0; at one that
        fades, they are weighted with the view.
        """
        shape = self.cohesion_gain.unsqueeze(-1)
        strength = (distance.square() + self.softening**2) ** (
            -0.5 * (self.exponent.unsqueeze(-1) + 1.0)
        )
        found = {
            "attraction": shape * distance,
            "repulsion": -self.separation_gain.unsqueeze(-1) * strength * distance,
            "alignment": self.alignment_gain.unsqueeze(-1) * torch.ones_like(distance),
        }
        if not self.has_radius:
            return found
        width = None if self.is_sharp else self.radius_width.unsqueeze(-1)
        share, _ = sight(distance, self.radius.unsqueeze(-1), width)
        return {name: share * value for name, value in found.items()}

    def view(self) -> View | None:
        """Return how far an individual sees; ``None``, if only the graph says so."""
        return View(self.radius, self._radius_width) if self.has_radius else None

    @property
    def _radius_width(self) -> Tensor | None:
        return None if self.is_sharp else self.radius_width
