"""Forces between pairs as smooth functions of their distance, to be inferred with bands."""

import math
from typing import Any, Literal, get_args

import torch
from pyro.distributions import constraints
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, Graph, degree, dense, pair_sum
from swarmssm.models.distributions.speed_limits import TOLERANCE
from swarmssm.models.transitions.force import ForceTransition, Noise, PairDerivative
from swarmssm.models.transitions.kernel_pairs import KernelPairs, angular_factor
from swarmssm.models.transitions.perception import any_in_sight, sight
from swarmssm.models.transitions.protocols import PairKernel, PairWeights, View
from swarmssm.models.transitions.radial_basis import RadialBasis

__all__ = ["Aggregation", "KernelTransition"]

Aggregation = Literal["mean", "sum"]


class KernelTransition(ForceTransition):
    r"""Accelerations by kernels of distance, which show the rule that a group follows.

    Of what an individual i sees, each neighbour j at the distance r, in the direction
    :math:`\hat u` from i, at the angle :math:`\varphi` from its heading, adds

    .. math:: M(\varphi)\,\bigl[f(r)\,\hat u + g(r)\,(v_j - v_i)\bigr],
       \qquad M(\varphi) = 1 + \sum_l a_l \cos(l\varphi),

    and the mean over neighbours is the social force; with a *repulsion*, a further
    :math:`\sum_j M(\varphi)\, q(r)\,\hat u` comes to it, which is not averaged: neighbours crowd.
    Where f or q is negative, an individual moves away (separation), where f is positive, closer
    (cohesion); g is alignment. Walls, speed regulation, limits of speed and noise are those of
    :class:`~swarmssm.models.transitions.ForceTransition`.

    Turned, mirrored or moved, a group does the same (walls and all turned with it): kernels know
    distances and angles alone. :class:`~swarmssm.models.transitions.BoidsTransition` is the special
    case :math:`f = k_c r,\; q = -k_s r^{-n},\; g = k_a`, M = 1.

    Parameters
    ----------
    space
        Number of spatial dimensions, 2 or 3.
    dt
        Seconds from one frame to the next.
    basis
        In which the kernels are written, for instance
        :class:`~swarmssm.models.transitions.SplineBasis`.
    attraction, alignment
        Coefficients of f and g, ``(size,)``, in multiples of the units.
    process_noise
        See :meth:`ForceTransition.assign_self_terms`.
    units
        An acceleration, in which attraction and repulsion are written, and one over a time, for the
        alignment. Parameters of the size of 1 are learned best.
    repulsion
        Coefficients of q. Absent: there is none, and f says both.
    modulation
        :math:`a_l`, ``(l,)``. Absent: M = 1.
    influence
        How much each individual moves others: ``(individual,)``, or ``(individual, individual)``
        for each pair, the receiver first. Positive; a pair counts so many times. It scales what
        kernels say, so that one of the two should be held by its prior. Absent: 1.
    responsiveness
        How much each is moved by others, ``(individual,)``, likewise.
    aggregation
        ``"mean"`` or ``"sum"`` over the neighbours, of attraction and alignment. Whoever has no
        neighbour feels nothing.
    radius, radius_width
        How far an individual sees among those whom the graph lets it see, see
        :class:`~swarmssm.models.transitions.BoidsTransition`.
    noise, limit_tolerance
        See :class:`~swarmssm.models.transitions.ForceTransition`.
    **own
        For :meth:`ForceTransition.assign_self_terms`: walls, speed regulation, limits of speed.

    All parameters may be fixed, learned or have a prior, as those of ``BoidsTransition``.

    Raises
    ------
    InputError
        If an option is none of the above, or a value is out of range.

    References
    ----------
    F. Lu, M. Zhong, S. Tang and M. Maggioni (2019), Nonparametric inference of interaction laws in
    systems of agents from trajectory data, PNAS 116.
    """

    def __init__(
        self,
        space: int,
        dt: float,
        *,
        basis: RadialBasis,
        attraction: Any,
        alignment: Any,
        process_noise: Any,
        units: tuple[float, float] = (1.0, 1.0),
        repulsion: Any = None,
        modulation: Any = None,
        influence: Any = None,
        responsiveness: Any = None,
        aggregation: Aggregation = "mean",
        radius: Any = None,
        radius_width: Any = 0.0,
        noise: Noise = "additive",
        limit_tolerance: float = TOLERANCE,
        **own: Any,
    ) -> None:
        super().__init__(space, dt, noise=noise, limit_tolerance=limit_tolerance)
        if aggregation not in get_args(Aggregation):
            raise InputError(f"aggregation: it must be 'mean' or 'sum', not {aggregation!r}.")
        if not all(0.0 < unit < math.inf for unit in units):
            raise InputError(f"units: they must be positive, not {units!r}.")
        self.aggregation = aggregation
        self.units = units
        self.basis = basis
        self.has_repulsion, self.is_modulated = repulsion is not None, modulation is not None
        self.has_influence = influence is not None
        self.has_responsiveness = responsiveness is not None
        self.has_radius = radius is not None
        self.is_sharp = isinstance(radius_width, int | float) and radius_width == 0
        whole: list[tuple[int, ...]] = [(basis.size,)]
        self.assign_parameter("attraction", attraction, constraints.real, whole)
        if self.has_repulsion:
            self.assign_parameter("repulsion", repulsion, constraints.real, whole)
        self.assign_parameter("alignment", alignment, constraints.real, whole)
        if self.is_modulated:
            self.assign_parameter("modulation", modulation, constraints.real, [(-1,)])
        if self.has_influence:
            self.assign_parameter(
                "influence", influence, constraints.nonnegative, [(-1,), (-1, -1)]
            )
        if self.has_responsiveness:
            self.assign_parameter(
                "responsiveness", responsiveness, constraints.nonnegative, [(-1,)]
            )
        if self.has_radius:
            self.assign_parameter("radius", radius, constraints.positive)
            if not self.is_sharp:
                self.assign_parameter("radius_width", radius_width, constraints.positive)
        self.assign_self_terms(process_noise=process_noise, **own)

    @property
    def pair_terms(self) -> tuple[str, ...]:
        """Cohesion, separation, alignment."""
        return ("cohesion", "separation", "alignment")

    @property
    def kernel_kinds(self) -> dict[str, PairKernel]:
        """How each of :meth:`kernels` becomes a force."""
        kinds = {
            "attraction": PairKernel("offset", self.aggregation),
            "alignment": PairKernel("velocity", self.aggregation),
        }
        return kinds | ({"repulsion": PairKernel("offset", "sum")} if self.has_repulsion else {})

    def view(self) -> View | None:
        """Return how far an individual sees; ``None``, if only the graph says so."""
        return View(self.radius, self._width) if self.has_radius else None

    def pair_weights(self) -> PairWeights:
        """Return how much each individual moves others, and how much it is moved."""
        return PairWeights(
            self.influence if self.has_influence else None,
            self.responsiveness if self.has_responsiveness else None,
        )

    def kernels(self, distance: Tensor) -> dict[str, Tensor]:
        """Return f, g and q: what a neighbour at given distances does, straight ahead or not.

        Parameters
        ----------
        distance
            ``(distance,)``, positive.

        Returns
        -------
        ``"attraction"``, ``"alignment"`` and, if there is one, ``"repulsion"``, ``(distance,)``
        each. Beyond a radius all are 0; at one that fades, they are weighted with the view.
        """
        values = self.basis(distance, self._coefficients(distance.dtype)).value
        names = ("attraction", "repulsion", "alignment")
        found = dict(zip(names, values.unbind(-1), strict=True))
        if not self.has_repulsion:
            del found["repulsion"]
        if self.has_radius:
            share, _ = sight(distance, self.radius.unsqueeze(-1), self._width)
            found = {name: share * value for name, value in found.items()}
        return found

    def angular(self, angle: Tensor) -> Tensor:
        """Return M at given angles between heading and direction to the neighbour, in rad."""
        if not self.is_modulated:
            return torch.ones_like(angle)
        return angular_factor(torch.cos(angle), self.modulation.to(angle.dtype)).factor

    def pair_forces(self, states: Tensor, graph: Graph) -> Tensor:
        """Return cohesion, separation and alignment; see :meth:`ForceTransition.pair_forces`.

        With a repulsion, that is separation, and the attraction cohesion, whatever their signs.
        Without one, the attraction is cohesion where it is positive and separation where it is not.
        """
        space = self.space
        coefficients = self._coefficients(states.dtype)
        columns = torch.cat([states, *self._sight_columns(states)], -1)

        def message(mine: Tensor, theirs: Tensor) -> Tensor:
            away = theirs[..., : 2 * space] - mine[..., : 2 * space]
            offset, relative = away[..., :space], away[..., space:]
            squared = offset.square().sum(-1)
            apart = squared > 0
            distance = torch.where(apart, squared, 1.0).sqrt()
            toward = offset / distance.unsqueeze(-1)
            weight = torch.where(apart, 1.0, 0.0).to(states.dtype)
            if self.has_radius:
                width = None if self.is_sharp else mine[..., 2 * space + 1]
                weight = weight * sight(distance, mine[..., 2 * space], width)[0]
            if self.is_modulated:
                velocity = mine[..., space : 2 * space]
                speed = velocity.square().sum(-1, keepdim=True)
                heading = torch.where(
                    speed > 0, velocity * torch.where(speed > 0, speed, 1.0).rsqrt(), 0.0
                )
                cosine = (toward * heading).sum(-1)
                weight = weight * angular_factor(cosine, self.modulation).factor
            attraction, repulsion, aligning = self.basis(distance, coefficients).value.unbind(-1)
            if self.has_repulsion:
                pull, push = attraction, repulsion
            else:
                pull = attraction.clamp(min=0.0)
                # Not clamped again: where f is 0 the two must still add up to its derivative.
                push = attraction - pull
            parts = [
                (weight * pull).unsqueeze(-1) * toward,
                (weight * push).unsqueeze(-1) * toward,
                (weight * aligning).unsqueeze(-1) * relative,
            ]
            return torch.cat(parts, -1)

        summed = pair_sum(columns, self._weighted(graph), message)
        cohesion, separation, alignment = torch.split(summed, space, -1)
        share = self._share(columns, graph)
        if not self.has_repulsion:
            separation = share * separation
        return torch.stack([share * cohesion, separation, share * alignment], -3)

    def pair_derivative(self, states: Tensor, adjacency: Tensor, rate: float) -> PairDerivative:
        """Return the sum of the terms and its derivatives; see the base class."""
        return KernelPairs(
            self.basis,
            rate * self._coefficients(states.dtype),
            self.modulation if self.is_modulated else None,
            self._weights,
            self.radius if self.has_radius else None,
            self._width if self.has_radius else None,
            self.aggregation == "mean",
        )(states, adjacency)

    def _coefficients(self, dtype: torch.dtype) -> Tensor:
        """Return the coefficients of attraction, repulsion and alignment, ``(3, size)``."""
        attraction = self.attraction
        repulsion = self.repulsion if self.has_repulsion else torch.zeros_like(attraction)
        force, rate = self.units
        return torch.stack([force * attraction, force * repulsion, rate * self.alignment]).to(dtype)

    @property
    def _width(self) -> Tensor | None:
        return None if self.is_sharp else self.radius_width

    @property
    def _weights(self) -> Tensor | None:
        """How often each pair counts, to broadcast against ``(individual, individual)``."""
        influence, responsiveness = self.pair_weights()
        weights: Tensor | None = None
        if influence is not None:
            weights = influence if influence.dim() > 1 else influence.unsqueeze(-2)
        if responsiveness is not None:
            own = responsiveness.unsqueeze(-1)
            weights = own if weights is None else own * weights
        return weights

    def _weighted(self, graph: Graph) -> Graph:
        """Return the graph with the weights of pairs in it."""
        weights = self._weights
        if weights is None:
            return graph
        if isinstance(graph, EdgeList):
            graph = dense(graph, weights.dtype)
        return graph * weights

    def _sight_columns(self, states: Tensor) -> list[Tensor]:
        """Return radius and width as features of each individual."""
        if not self.has_radius:
            return []
        own = [self.radius] if self.is_sharp else [self.radius, self.radius_width]
        return [value.expand(states.shape[:-1]).unsqueeze(-1) for value in own]

    def _share(self, columns: Tensor, graph: Graph) -> Tensor:
        """Return what a sum over neighbours is to be multiplied by, ``(..., individual, 1)``."""
        space = self.space
        if not self.has_radius:
            if self.aggregation == "sum":
                return torch.ones_like(columns[..., :1])
            total = degree(columns, graph)
            return torch.where(total > 0, 1.0 / torch.where(total > 0, total, 1.0), 0.0)

        def message(mine: Tensor, theirs: Tensor) -> Tensor:
            offset = theirs[..., :space] - mine[..., :space]
            squared = offset.square().sum(-1)
            distance = torch.where(squared > 0, squared, 1.0).sqrt()
            width = None if self.is_sharp else mine[..., 2 * space + 1]
            seen = sight(distance, mine[..., 2 * space], width)
            apart = (squared > 0).to(mine.dtype)
            return torch.stack([apart * part for part in seen], -1)

        total, hazard = torch.split(pair_sum(columns, graph, message), 1, -1)
        if self.aggregation == "sum":
            return torch.ones_like(total)
        some = any_in_sight(hazard, self._width)
        return torch.where(total > 0, some / torch.where(total > 0, total, 1.0), 0.0)
