"""What every transition offers: the distribution of the next states, and its linearisation."""

from dataclasses import replace
from typing import ClassVar, NamedTuple

import torch
from pyro.distributions import Normal, TorchDistribution
from torch.func import jacfwd, vmap

from swarmssm.errors import InputError
from swarmssm.graphs import dense
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.distributions.kinematic import Kinematic
from swarmssm.models.distributions.moments import covariance_of, location_of
from swarmssm.models.layers import check_sizes
from swarmssm.models.markov import StepInputs
from swarmssm.models.pyro_modules import LocalPyroModule, priors_in
from swarmssm.models.transitions.protocols import Form

__all__ = ["KinematicTransition", "Linearization", "Transition"]


class Linearization(NamedTuple):
    r"""Next states as an affine function of the whole swarm:
    :math:`z' \approx m' + J (z - m) + \epsilon,\; \epsilon_i \sim N(0, Q_i)`.

    Attributes
    ----------
    mean
        :math:`m'`, ``(..., individual, state)``.
    jacobian
        :math:`J`, ``(..., individual, state, individual, state)``: ``[i, a, j, b]`` is what state b
        of j does to state a of i.
    noise
        :math:`Q`, ``(..., individual, state, state)``.
    """

    mean: torch.Tensor
    jacobian: torch.Tensor
    noise: torch.Tensor


class Transition(LocalPyroModule):
    """Law of motion :math:`p(z_t | z_{t-1}, G_{t-1})` of a swarm.

    A subclass writes :meth:`forward`. Parameters are attributes, given with
    :func:`swarmssm.models.parameters.assign` (or as :class:`pyro.nn.PyroSample`) and broadcast
    against ``(..., individual)``: a scalar for all, ``(individual,)`` for each.

    Parameters
    ----------
    state_dim
        Features of a state.

    Raises
    ------
    ValueError
        If it is no positive whole number.
    """

    def __init__(self, state_dim: int) -> None:
        super().__init__()
        check_sizes(state_dim=state_dim)
        self.state_dim = state_dim

    @property
    def noise_dim(self) -> int:
        """Number of features of a next state that noise moves; the rest follow from them."""
        return self.state_dim

    @property
    def is_smooth(self) -> bool:
        """Whether next states have a density over their free features, without atoms."""
        return True

    def forward(self, states: torch.Tensor, inputs: StepInputs) -> TorchDistribution:
        """Return the distribution of the next states.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        inputs
            Graph, controls and presence at the beginning of the step, whose leading dimensions
            broadcast against those of ``states``.

        Returns
        -------
        Batch shape ``(..., individual)``, event shape ``(state,)``.
        """
        raise TypeError(f"{type(self).__name__} must define forward(states, inputs)")

    #: Parameters that :meth:`pairwise` does without.
    self_parameter_names: ClassVar[tuple[str, ...]] = ()

    def pairwise(self, states: torch.Tensor, inputs: StepInputs) -> torch.Tensor:
        """Return what neighbours change the middle of the free features by.

        Before limits of speed, if there are any. Here the difference between the law with the graph
        and without any edges; a subclass that adds forces up has it at once.

        Parameters
        ----------
        states, inputs
            As in :meth:`forward`, with an adjacency.

        Returns
        -------
        ``(..., individual, noise_dim)``.
        """
        assert inputs.adjacency is not None, "neighbours are those of a graph"
        graph = dense(inputs.adjacency, states.dtype)
        alone = replace(inputs, adjacency=torch.zeros_like(graph))
        return location_of(self(states, inputs)) - location_of(self(states, alone))

    def drop_self_terms(self) -> None:
        """Give up the parameters that :meth:`pairwise` does without, and their priors."""
        for name in self.self_parameter_names:
            if name in priors_in(self) or hasattr(self, name):
                delattr(self, name)

    def augmented(self, batch: SwarmBatch) -> SwarmBatch:
        """Return windows for a step of training: themselves, or where the law of motion has
        symmetries, an image of them at random.
        """
        return batch

    def log_prior(self) -> torch.Tensor | None:
        """Return the log-density of weights that are learned as points; ``None``, it is flat.

        Training maximises it along with the ELBO, in which it counts once however many the data.
        """
        return None

    def stochastic_features(self, states: torch.Tensor) -> torch.Tensor:
        """Return the features that noise moves, ``(..., noise_dim)``."""
        return states

    def path(self, first: torch.Tensor, free: torch.Tensor) -> torch.Tensor:
        """Return the path with given first states and free features of all later ones.

        Parameters
        ----------
        first
            ``(..., individual, state)``.
        free
            ``(..., time - 1, individual, noise_dim)``.

        Returns
        -------
        ``(..., time, individual, state)``.
        """
        return torch.cat([first.unsqueeze(-3), free], dim=-3)

    def linearize(
        self,
        mean: torch.Tensor,
        inputs: StepInputs,
        covariance: torch.Tensor | None = None,
    ) -> Linearization:
        """Linearise at given states of the swarm.

        By forward-mode differentiation of the mean. A subclass that knows its derivatives, or
        how to average over ``covariance``, does it better.

        Parameters
        ----------
        mean
            ``(..., individual, state)``.
        inputs
            As in :meth:`forward`.
        covariance
            How unsure the states are, ``(..., individual, state, state)``, each individual's own;
            for transitions with kinks. Ignored here.
        """
        here = self(mean, inputs)
        shape = mean.shape
        flat = mean.reshape(-1, *shape[-2:])

        def next_mean(states: torch.Tensor, *parts: torch.Tensor) -> torch.Tensor:
            following: torch.Tensor = self(states, inputs.rebuild(parts)).mean
            return following

        jacobian = vmap(jacfwd(next_mean))(flat, *inputs.tensors(shape[:-2]))
        return Linearization(
            here.mean,
            jacobian.reshape(*shape, *shape[-2:]),
            covariance_of(here),
        )


class KinematicTransition(Transition):
    r"""A transition in which bodies move with their next velocity: ``p' = p + dt v'``.

    A subclass writes :attr:`terms` and :meth:`forces`, which add up to the acceleration
    (:math:`v' = v + dt \sum_k F_k + \sigma \sqrt{dt}\, \epsilon`), and gives itself the parameter
    ``process_noise``, :math:`\sigma`; or it writes :meth:`velocity`.

    Parameters
    ----------
    space
        Number of spatial dimensions.
    dt
        Seconds from one frame to the next.
    """

    def __init__(self, space: int, dt: float) -> None:
        super().__init__(2 * space)
        self.space = space
        self.dt = dt

    @property
    def noise_dim(self) -> int:
        """Velocities are free, positions follow."""
        return self.space

    @property
    def form(self) -> Form:
        """What :meth:`forces` add up to."""
        return "acceleration"

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the :meth:`forces`, in their order; none, if they are not told apart."""
        return ()

    def forces(self, states: torch.Tensor, inputs: StepInputs) -> torch.Tensor:
        """Return what each force contributes to the acceleration.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        inputs
            As in :meth:`Transition.forward`.

        Returns
        -------
        ``(..., term, individual, space)``, in the order of :attr:`terms`.
        """
        raise TypeError(
            f"{type(self).__name__} must define terms and forces(states, inputs), or "
            "velocity(positions, velocities, inputs)"
        )

    def velocity(
        self, positions: torch.Tensor, velocities: torch.Tensor, inputs: StepInputs
    ) -> TorchDistribution:
        """Return the distribution of the next velocities.

        Parameters
        ----------
        positions, velocities
            ``(..., individual, space)``.
        inputs
            As in :meth:`Transition.forward`.

        Returns
        -------
        Batch shape ``(..., individual)``, event shape ``(space,)``.
        """
        found = self.forces(torch.cat([positions, velocities], -1), inputs)
        if found.shape[-3:] != (len(self.terms), *positions.shape[-2:]):
            raise InputError(
                f"forces: they must be (..., term, individual, space) = "
                f"(..., {len(self.terms)}, {positions.shape[-2]}, {positions.shape[-1]}) for the "
                f"terms {', '.join(self.terms)}, and they are {tuple(found.shape)}."
            )
        noise = (self.process_noise * self.dt**0.5).unsqueeze(-1)
        return Normal(velocities + self.dt * found.sum(-3), noise).to_event(1)

    def forward(self, states: torch.Tensor, inputs: StepInputs) -> Kinematic:
        """Return the distribution of the next states."""
        positions, velocities = states[..., : self.space], states[..., self.space :]
        following = self.velocity(positions, velocities, inputs)
        if following.batch_shape[-1:] != positions.shape[-2:-1]:
            raise InputError(
                "velocity: it must return a distribution of batch shape (..., individual) = "
                f"(..., {positions.shape[-2]}) and event shape (space,) = ({self.space},), and "
                f"this one has {tuple(following.batch_shape)} and {tuple(following.event_shape)}."
            )
        return Kinematic(positions, following, self.dt)

    def linearize_velocity(
        self,
        mean: torch.Tensor,
        inputs: StepInputs,
        covariance: torch.Tensor | None = None,
    ) -> Linearization:
        """Return what :meth:`linearize` says of the next velocities, from which positions follow.

        Parameters
        ----------
        mean, inputs, covariance
            As in :meth:`linearize`.

        Returns
        -------
        Means ``(..., individual, space)``, Jacobian ``(..., individual, space, individual, state)``
        and noise ``(..., individual, space, space)``.
        """
        line = self.linearize(mean, inputs, covariance)
        half = self.space
        return Linearization(
            line.mean[..., half:],
            line.jacobian[..., half:, :, :],
            line.noise[..., half:, half:],
        )

    def stochastic_features(self, states: torch.Tensor) -> torch.Tensor:
        """Return the velocities."""
        return states[..., self.space :]

    def path(self, first: torch.Tensor, free: torch.Tensor) -> torch.Tensor:
        """Return the path with given first states and later velocities."""
        first = first.unsqueeze(-3)
        positions = first[..., : self.space] + self.dt * torch.cumsum(free, dim=-3)
        return torch.cat([first, torch.cat([positions, free], dim=-1)], dim=-3)
