"""A transition in which edges of different types act by laws of their own."""

import copy
from dataclasses import replace

import pyro.distributions as dist
import torch
from pyro.distributions import TorchDistribution
from torch import Tensor, nn

from swarmssm.errors import InputError
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.distributions.kinematic import Kinematic
from swarmssm.models.distributions.speed_limits import SpeedLimited
from swarmssm.models.emissions.student import DiagonalStudentT
from swarmssm.models.markov import StepInputs
from swarmssm.models.transitions.base import KinematicTransition, Transition

__all__ = ["TypedKinematicTransition", "TypedTransition", "displaced", "typed"]


class TypedTransition(Transition):
    r"""What an individual does by itself, and what neighbours of each type do to it.

    .. math::
        p(z' \mid z, e) = p_1(z' \mid z, A_1) \text{ moved by }
        \sum_{k > 1} \bigl[\mu_k(z, A_k) - \mu_k(z, 0)\bigr]

    with :math:`A_k` the edges of the type k and :math:`\mu_k` the mean of the k-th law
    (:meth:`swarmssm.models.Transition.pairwise`). Forces add up before limits of speed. Without
    types in the inputs, all edges are of the first that acts.

    Parameters
    ----------
    laws
        A transition for each type that acts, all of one kind. Of the first everything counts; of
        the others what neighbours do.
    no_edge
        Whether the first type of the inputs does not act.

    Raises
    ------
    InputError
        If there is no law, or they are of different kinds.
    """

    def __init__(self, laws: list[Transition], *, no_edge: bool = True) -> None:
        if not laws or any(type(law) is not type(laws[0]) for law in laws):
            raise InputError("laws: there must be one for each type, all of the same kind.")
        first = laws[0]
        self._prepare(first)
        self.laws = nn.ModuleList(laws)
        self.no_edge = no_edge

    def _prepare(self, first: Transition) -> None:
        """Initialise the base class."""
        super().__init__(first.state_dim)

    @property
    def first(self) -> Transition:
        """The law of which everything counts."""
        law = self.laws[0]
        assert isinstance(law, Transition)
        return law

    @property
    def is_smooth(self) -> bool:
        """Whether the first law is."""
        return self.first.is_smooth

    @property
    def noise_dim(self) -> int:
        """That of the first law."""
        return self.first.noise_dim

    def augmented(self, batch: SwarmBatch) -> SwarmBatch:
        """Return what the first law makes of the windows."""
        return self.first.augmented(batch)

    def log_prior(self) -> Tensor | None:
        """Return the sum of those of all laws."""
        found = [law.log_prior() for law in self.laws]  # type: ignore[operator]
        known = [one for one in found if one is not None]
        return torch.stack(known).sum() if known else None

    def forward(self, states: Tensor, inputs: StepInputs) -> TorchDistribution:
        """Return the distribution of the next states."""
        if inputs.edge_types is None:
            return self.first(states, inputs)
        types = inputs.edge_types[..., 1:] if self.no_edge else inputs.edge_types
        if types.shape[-1] != len(self.laws):
            raise ValueError(
                f"there are {len(self.laws)} laws, and {types.shape[-1]} types of edges that act"
            )
        own, *others = types.unbind(-1)
        following = self.first(states, replace(inputs, adjacency=own, edge_types=None))
        moved = None
        for law, graph in zip(list(self.laws)[1:], others, strict=True):
            assert isinstance(law, Transition)
            part = law.pairwise(states, replace(inputs, adjacency=graph, edge_types=None))
            moved = part if moved is None else moved + part
        return following if moved is None else displaced(following, moved)

    def stochastic_features(self, states: Tensor) -> Tensor:
        """Return the features that noise moves."""
        return self.first.stochastic_features(states)

    def path(self, first: Tensor, free: Tensor) -> Tensor:
        """Return the path of first states and later free features."""
        return self.first.path(first, free)


class TypedKinematicTransition(TypedTransition, KinematicTransition):
    """The same, of laws in which positions follow from velocities."""

    def _prepare(self, first: Transition) -> None:
        assert isinstance(first, KinematicTransition)
        KinematicTransition.__init__(self, first.space, first.dt)

    def velocity(
        self, positions: Tensor, velocities: Tensor, inputs: StepInputs
    ) -> TorchDistribution:
        """Return the distribution of the next velocities."""
        following = self(torch.cat([positions, velocities], -1), inputs)
        velocity: TorchDistribution = following.velocity
        return velocity


def typed(transition: Transition, laws: int, *, no_edge: bool = True) -> TypedTransition:
    """Return a transition with a law of its own for each type, all beginning as the given one.

    Of the copies only what neighbours do is kept: their walls, limits and noise are gone, with the
    priors. Weights of networks start a little apart.

    Parameters
    ----------
    transition
        The law of the first type, and of what individuals do by themselves.
    laws
        How many types act.
    no_edge
        Whether there is a further type, the first, that does not act.
    """
    others = [_apart(copy.deepcopy(transition)) for _ in range(laws - 1)]
    kind = (
        TypedKinematicTransition if isinstance(transition, KinematicTransition) else TypedTransition
    )
    return kind([transition, *others], no_edge=no_edge)


#: What weights of copies are changed by, relative to their root mean square.
JITTER = 0.1


def _apart(law: Transition) -> Transition:
    """Leave of a law what neighbours do, and move its weights a little."""
    law.drop_self_terms()
    with torch.no_grad():
        for weight in law.parameters():
            if weight.dim() > 1:
                weight += JITTER * weight.square().mean().sqrt() * torch.randn_like(weight)
    return law


def displaced(following: TorchDistribution, shift: Tensor) -> TorchDistribution:
    """Return a distribution of next states, or of next velocities, moved by a shift.

    Parameters
    ----------
    following
        Normal, multivariate normal, Student's t or limited in speed, the last being moved before
        the limits; or of bodies that move with such velocities.
    shift
        ``(..., feature)``, of the features that noise moves.

    Raises
    ------
    InputError
        If the distribution is of another kind.
    """
    if isinstance(following, Kinematic):
        return Kinematic(following.position, displaced(following.velocity, shift), following.dt)
    if isinstance(following, dist.Independent) and isinstance(following.base_dist, dist.Normal):
        base = following.base_dist
        return dist.Normal(base.loc + shift, base.scale).to_event(1)
    if isinstance(following, dist.MultivariateNormal):
        return dist.MultivariateNormal(following.loc + shift, scale_tril=following.scale_tril)
    if isinstance(following, DiagonalStudentT):
        return DiagonalStudentT(following.degrees, following.loc + shift, following.scale)
    if isinstance(following, SpeedLimited):
        return SpeedLimited(
            following.loc + shift,
            following.scale,
            following.low,
            following.high,
            tolerance=following.tolerance,
        )
    raise InputError(
        f"transition: types of edges cannot have laws of their own where next states are of a "
        f"{type(following).__name__}; take laws=common."
    )
