"""The linear-Gaussian swarm, which can be solved exactly."""

from typing import Any, ClassVar

import pyro.distributions as dist
import torch
from torch.distributions import constraints

from swarmssm.graphs import Graph, neighbor_mean
from swarmssm.models.markov import StepInputs
from swarmssm.models.parameters import assign
from swarmssm.models.transitions.base import Linearization, Transition

__all__ = ["LinearTransition", "pull_matrix", "pull_to_neighbors"]


class LinearTransition(Transition):
    r"""Linear dynamics, with the mean of the neighbours as input.

    .. math::
        z'_i \sim N\bigl(F z_i + G\, (\bar z_{\mathcal{N}_i} - z_i) + b,\; L L^\top\bigr)

    where :math:`\bar z_{\mathcal{N}_i}` is the mean over those whom i sees, and the second term 0
    for who sees nobody.

    Parameters
    ----------
    matrix
        F, ``(state, state)``.
    coupling
        G, ``(state, state)``.
    offset
        b, ``(state,)``.
    noise_tril
        L, lower triangular ``(state, state)`` with a positive diagonal.

    Each is a tensor, a prior, or a parameter (:func:`swarmssm.models.parameters.assign`); a number
    stands for this times the identity, and for as many of them in b.

    Raises
    ------
    InputError
        If one has another shape, or L is not lower triangular with a positive diagonal.
    """

    def __init__(
        self, state_dim: int, matrix: Any, noise_tril: Any, coupling: Any = 0.0, offset: Any = 0.0
    ) -> None:
        super().__init__(state_dim)
        square = (state_dim, state_dim)
        for name, value, shape, constraint in (
            ("matrix", matrix, square, constraints.real),
            ("coupling", coupling, square, constraints.real),
            ("offset", offset, (state_dim,), constraints.real),
            ("noise_tril", noise_tril, square, constraints.lower_cholesky),
        ):
            if isinstance(value, int | float):
                whole = torch.eye(state_dim) if shape == square else torch.ones(state_dim)
                value = value * whole
            assign(self, name, value, constraint=constraint, shapes=[shape])

    #: See :class:`~swarmssm.models.Transition`.
    self_parameter_names: ClassVar[tuple[str, ...]] = ("matrix", "offset", "noise_tril")

    def pairwise(self, states: torch.Tensor, inputs: StepInputs) -> torch.Tensor:
        """Return what the mean of the neighbours adds to the next state."""
        assert inputs.adjacency is not None, "neighbours are those of a graph"
        pull: torch.Tensor = pull_to_neighbors(states, inputs.adjacency) @ self.coupling.mT
        return pull

    def forward(self, states: torch.Tensor, inputs: StepInputs) -> dist.MultivariateNormal:
        """Return the distribution of the next states."""
        moved = states @ self.matrix.mT + self.offset
        if inputs.adjacency is not None:
            moved = moved + pull_to_neighbors(states, inputs.adjacency) @ self.coupling.mT
        return dist.MultivariateNormal(moved, scale_tril=self.noise_tril)

    def linearize(
        self,
        mean: torch.Tensor,
        inputs: StepInputs,
        covariance: torch.Tensor | None = None,
    ) -> Linearization:
        """Return the transition itself: it is linear."""
        following = self(mean, inputs)
        individuals = mean.shape[-2]
        eye = torch.eye(individuals, dtype=mean.dtype, device=mean.device)
        jacobian = torch.einsum("ij,ab->iajb", eye, self.matrix)
        if inputs.adjacency is not None:
            pull = pull_matrix(mean, inputs.adjacency)
            jacobian = jacobian + torch.einsum("...ij,ab->...iajb", pull, self.coupling)
        shape = (*mean.shape, *mean.shape[-2:])
        noise = following.covariance_matrix.expand(*mean.shape, mean.shape[-1])
        return Linearization(following.mean, jacobian.expand(shape), noise)


def pull_to_neighbors(states: torch.Tensor, graph: Graph) -> torch.Tensor:
    """Return how far each individual is from the mean of its neighbours; 0 without any.

    Parameters
    ----------
    states
        ``(..., individual, feature)``.
    graph
        See :func:`swarmssm.graphs.neighbor_mean`.
    """
    mean, has_neighbor = neighbor_mean(states, graph)
    return torch.where(has_neighbor, mean - states, 0.0)


def pull_matrix(states: torch.Tensor, graph: Graph) -> torch.Tensor:
    """Return the matrix ``(..., individual, individual)`` of :func:`pull_to_neighbors`.

    Parameters
    ----------
    states
        ``(..., individual, feature)``; only shape and type matter.
    graph
        Of the same frames.
    """
    individuals = states.shape[-2]
    units = torch.eye(individuals, dtype=states.dtype, device=states.device)
    return pull_to_neighbors(units.expand(*states.shape[:-1], individuals), graph)
