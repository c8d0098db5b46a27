"""A law of motion without given forms: a gated graph network on physical kinematics."""

import math
from typing import Any, Literal, get_args

import pyro.distributions as dist
import torch
from pyro.distributions import constraints
from pyro.nn import PyroParam
from torch import nn

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, Graph, Pairs
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.distributions.moments import covariance_of
from swarmssm.models.emissions.student import DiagonalStudentT
from swarmssm.models.interaction_network import USUAL_DEGREE, InteractionNetwork
from swarmssm.models.markov import StepInputs
from swarmssm.models.parameters import assign
from swarmssm.models.reflections import reflected
from swarmssm.models.scales import Scales
from swarmssm.models.transitions.base import (
    KinematicTransition,
    Linearization,
)
from swarmssm.models.transitions.soft_limits import SoftSpeedLimits

__all__ = ["GraphTransition", "Noise", "Symmetries", "Tails"]

Noise = Literal["constant", "state"]
Tails = Literal["gaussian", "student"]
Symmetries = Literal["none", "mirror", "square", "circle"]

#: The noise of an individual may be this many times the common one, or that part of it.
NOISE_RANGE = 100.0
#: The common noise is at least this part of what a velocity usually changes by.
LEAST_NOISE = 1e-3
#: Matrices with fewer entries are left as they are.
FEW_PAIRS = 4096
#: Share of all pairs that are edges, up to which messages along edges alone are faster.
LIST_UP_TO_DENSITY = 0.7
#: What the network's result is the sum of, see :meth:`GraphTransition.parts`.
PARTS = (
    "displacement",
    "relative velocity",
    "push",
    "distance",
    "own",
    "messages",
    "hidden",
)
#: Degrees of freedom of Student's t start here; below 2 there would be no variance.
START_DEGREES, LEAST_DEGREES = 6.0, 2.1


class GraphTransition(KinematicTransition):
    r"""Velocities changed by a graph network, whatever the forms of the interactions.

    .. math::
        v'_i \sim \mathrm{limits}\bigl(v_i + s\, f_i(p, v, G)\bigr) + \sigma_i \epsilon_i,
        \qquad p'_i = p_i + dt\, v'_i

    where f is an :class:`~swarmssm.models.interaction_network.InteractionNetwork`, 0 before
    training, so that an untrained model is constant velocity. It is told, of a pair, the
    displacement :math:`d/r_0`, the relative velocity, the distance and its inverse, :math:`d/|d|^2`
    and the receiver's velocity; of an individual, its velocity, speed and place. Inverse distances
    are softened by a learned length; :math:`r_0` and s are typical sizes
    (:class:`~swarmssm.models.Scales`).

    Parameters
    ----------
    scales
        Typical sizes of the tracks.
    width, rounds
        Of the network; with k rounds an individual feels those that are k edges away.
    positions
        Whether an individual knows its place in the arena, which it needs to feel walls. Without
        it the law is the same everywhere.
    speed_limits
        Whether speeds are drawn into a learned interval
        (:class:`~swarmssm.models.transitions.SoftSpeedLimits`).
    symmetries
        Those of the arena: ``"none"``; ``"mirror"``, along each axis, as in a rectangle;
        ``"square"``, with the axes exchanged as well; ``"circle"``, turned by any angle. Training
        then sees images of the windows (:meth:`augmented`), and the centre is learned: one that is
        wrong by a fiftieth of the arena costs more than all else that is left to learn.
    noise
        ``"constant"``: one :math:`\sigma`; ``"state"``: it depends on the state, through a further
        output of the network.
    tails
        ``"gaussian"``; or ``"student"``, with learned degrees of freedom, for animals that dart.
    noise_scale
        :math:`\sigma` in the unit of velocity, a number, prior or parameter; absent, learned.
    weight_prior
        Standard deviation of a normal prior of each weight of the network, times the root of the
        number of inputs of its layer; ``None``, none. It keeps the law at constant velocity where
        the data are few, and is lost among many.
    controls
        Number of exogenous inputs, which all individuals are told.

    Raises
    ------
    InputError
        If an option is none of the above.
    """

    origin: torch.Tensor

    def __init__(
        self,
        scales: Scales,
        *,
        width: int = 64,
        rounds: int = 1,
        positions: bool = True,
        speed_limits: bool = True,
        symmetries: Symmetries = "none",
        noise: Noise = "constant",
        tails: Tails = "gaussian",
        noise_scale: Any = None,
        weight_prior: float | None = None,
        controls: int = 0,
    ) -> None:
        super().__init__(scales.space, scales.dt)
        for name, value, kind in (
            ("symmetries", symmetries, Symmetries),
            ("noise", noise, Noise),
            ("tails", tails, Tails),
        ):
            if value not in get_args(kind):
                choices = " or ".join(repr(choice) for choice in get_args(kind))
                raise InputError(f"{name}: it must be {choices}, not {value!r}.")
        if symmetries != "none" and controls:
            raise InputError(
                "symmetries: it must be 'none' where there are controls, of which nobody knows how "
                "they look in a mirror."
            )
        self.sees_place = positions
        self.noise, self.tails, self.symmetries = noise, tails, symmetries
        if weight_prior is not None and not 0.0 < weight_prior < math.inf:
            raise InputError(f"weight_prior: it must be positive or null, not {weight_prior!r}.")
        self.weight_prior = weight_prior
        self.controls = controls
        space = self.space
        self.length, self.spacing = _positive(scales.length), _positive(scales.spacing)
        self.speed, self.change = _positive(scales.speed), _positive(scales.step)
        self.register_buffer("origin", torch.tensor(scales.centre))
        if symmetries != "none":
            self.shift = nn.Parameter(torch.zeros(space))
        # Far below the spacing, so that hardly a pair is told anything but its inverse distance.
        self.softening = PyroParam(torch.tensor(0.02), constraint=constraints.greater_than(1e-3))
        self.network = InteractionNetwork(
            space + 1 + (space + 1 if positions else 0) + controls,
            4 * space + 3,
            3 * space + 2,
            space + (1 if noise == "state" else 0),
            width=width,
            num_rounds=rounds,
            usual_degree=float(max(1, min(USUAL_DEGREE, scales.individuals - 1))),
        )
        self.limits = _limits(scales) if speed_limits else None
        if noise_scale is None:
            noise_scale = _start_noise(scales)
        assign(
            self,
            "noise_scale",
            noise_scale,
            constraint=constraints.positive,
            shapes=[(), (scales.individuals,)],
        )
        if tails == "student":
            self.degrees = PyroParam(
                torch.tensor(START_DEGREES), constraint=constraints.greater_than(LEAST_DEGREES)
            )

    @property
    def centre(self) -> torch.Tensor:
        """Fixed point of the symmetries, ``(space,)``: learned, or if there are none, given."""
        if self.symmetries == "none":
            return self.origin
        return self.origin + self.length * self.shift

    def log_prior(self) -> torch.Tensor | None:
        """Return the log-density of the network's weights, up to a constant."""
        if self.weight_prior is None:
            return None
        squares = [
            weight.square().sum() * weight.shape[-1]
            for weight in self.network.parameters()
            if weight.dim() > 1
        ]
        return -0.5 * torch.stack(squares).sum() / self.weight_prior**2

    def augmented(self, batch: SwarmBatch) -> SwarmBatch:
        """Return the windows, each at random in one of the mirrors where the law looks the same.

        Differentiable by the centre, which is learned as that about which the windows and their
        images obey one law.
        """
        if self.symmetries == "none":
            return batch
        return reflected(batch, self.centre, self.symmetries)

    def velocity(
        self, positions: torch.Tensor, velocities: torch.Tensor, inputs: StepInputs
    ) -> dist.TorchDistribution:
        """Return the distribution of the next velocities."""
        pairs = Pairs(_shorter(_graph(inputs), velocities), velocities)
        states = torch.cat([positions, velocities], dim=-1)
        mean, scale = self._moments(
            states, pairs.receivers(states), pairs.senders(states), inputs, pairs
        )
        if self.tails == "student":
            return DiagonalStudentT(self.degrees, mean, scale)
        return dist.Normal(mean, scale).to_event(1)

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of what :meth:`features` returns, ``"message 1"`` and so on."""
        width = self.network.enter.out_features
        return tuple(f"message {place}" for place in range(1, width + 1))

    def features(self, states: torch.Tensor, inputs: StepInputs) -> torch.Tensor:
        """Return what the network makes of the neighbours of each individual.

        The messages to it, summed, in the last round
        (:meth:`swarmssm.models.interaction_network.InteractionNetwork.messages`): together with
        its own state and sums that need no learning they determine its next velocity.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        inputs
            As in :meth:`forward`.

        Returns
        -------
        ``(..., individual, width)``.
        """
        own, pair, pairs = self._told(states, inputs)
        return self.network.messages(own, pair, pairs)

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the :meth:`parts`, in their order."""
        return PARTS

    def parts(self, states: torch.Tensor, inputs: StepInputs) -> torch.Tensor:
        r"""Return the acceleration before limits of speed, in the parts that it is the sum of.

        The network is linear in the last step, so that what it returns is a sum: of what it makes
        of the displacements of the neighbours, of their relative velocities, of the
        :math:`d/|d|^2`, of distances; of an individual's own features; of messages; and of its last
        hidden state, in which all of these meet.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        inputs
            As in :meth:`forward`.

        Returns
        -------
        ``(..., part, individual, space)``, all 0 before training.
        """
        space = self.space
        own, pair, pairs = self._told(states, inputs)
        found = self.network.contributions(own, pair, pairs, [space, space, space, 2])
        return found[..., :space].transpose(-3, -2) * (self.change / self.dt)

    def _told(
        self, states: torch.Tensor, inputs: StepInputs
    ) -> tuple[torch.Tensor, torch.Tensor, Pairs]:
        """Return what the network is told, and the graph."""
        velocities = states[..., self.space :]
        pairs = Pairs(_shorter(_graph(inputs), velocities), velocities)
        own = self._own(states[..., : self.space], velocities, inputs.controls)
        return own, self._pair(pairs.receivers(states), pairs.senders(states)), pairs

    def linearize(
        self,
        mean: torch.Tensor,
        inputs: StepInputs,
        covariance: torch.Tensor | None = None,
    ) -> Linearization:
        """Linearise at given states of the swarm.

        With one round of messages each of them has one receiver, and the derivative by a copy of
        its sender's state is a block of the Jacobian: as many backward passes as there are axes
        give all of it. More rounds are differentiated forwards, as in the base class.
        """
        inputs = inputs.dense()
        if len(self.network.update) > 1:
            return super().linearize(mean, inputs, covariance)
        recorded = torch.is_grad_enabled()
        individuals = mean.shape[-2]
        with torch.enable_grad():
            start = mean if mean.requires_grad else mean.detach().requires_grad_()
            # Two separate nodes, so that derivatives by the one do not run through the other.
            own = start.clone()
            sender = start.unsqueeze(-3).expand(*mean.shape[:-1], *mean.shape[-2:]).clone()
            pairs = Pairs(_graph(inputs), own)
            velocity, _ = self._moments(own, own.unsqueeze(-2), sender, inputs, pairs)
            rows = []
            for axis in range(self.space):
                by_own, by_sender = torch.autograd.grad(
                    velocity[..., axis].sum(),
                    (own, sender),
                    create_graph=recorded,
                    retain_graph=True,
                )
                eye = torch.eye(individuals, dtype=mean.dtype, device=mean.device)
                rows.append(by_sender + eye.unsqueeze(-1) * by_own.unsqueeze(-2))
            slope = torch.stack(rows, dim=-3)
        whole = torch.eye(self.space, 2 * self.space, dtype=mean.dtype, device=mean.device)
        stay = torch.einsum("ij,ab->iajb", eye, whole)
        jacobian = torch.cat([stay + self.dt * slope, slope], dim=-3)
        here = self(mean, inputs)
        if not recorded:
            jacobian = jacobian.detach()
        return Linearization(here.mean, jacobian, covariance_of(here))

    def _moments(
        self,
        states: torch.Tensor,
        receiver: torch.Tensor,
        sender: torch.Tensor,
        inputs: StepInputs,
        pairs: Pairs,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and scale of the next velocities, the latter to broadcast."""
        velocities = states[..., self.space :]
        own = self._own(states[..., : self.space], velocities, inputs.controls)
        out = self.network(own, self._pair(receiver, sender), pairs)
        mean = velocities + self.change * out[..., : self.space]
        if self.limits is not None:
            mean = self.limits(mean)
        scale = self.noise_scale.unsqueeze(-1)
        if self.noise == "state":
            bound = math.log(NOISE_RANGE)
            scale = scale * torch.exp(bound * torch.tanh(out[..., self.space :] / bound))
        return mean, scale

    def _own(
        self, positions: torch.Tensor, velocities: torch.Tensor, controls: torch.Tensor | None
    ) -> torch.Tensor:
        """Return the features of each individual, of size 1."""
        velocity = velocities / self.speed
        parts = [velocity, _norm(velocity)]
        if self.sees_place:
            place = (positions - self.centre) / self.length
            parts += [place, _norm(place)]
        given = 0 if controls is None else controls.shape[-1]
        if given != self.controls:
            raise ValueError(
                f"the transition was built for {self.controls} controls, and there are {given}"
            )
        if controls is not None:
            parts.append(controls.unsqueeze(-2).expand(*velocities.shape[:-1], given))
        return torch.cat(parts, dim=-1)

    def _pair(self, receiver: torch.Tensor, sender: torch.Tensor) -> torch.Tensor:
        """Return the features of each pair, of size 1; finite for an individual with itself."""
        apart = sender - receiver
        displacement = apart[..., : self.space] / self.spacing
        squared = displacement.square().sum(-1, keepdim=True) + self.softening**2
        inverse = squared.rsqrt()
        own = receiver[..., self.space :] / self.speed
        own = torch.cat([own, _norm(own)], dim=-1).expand(*apart.shape[:-1], self.space + 1)
        relative = apart[..., self.space :] / self.speed
        return torch.cat(
            [displacement, relative, displacement / squared, squared * inverse, inverse, own],
            dim=-1,
        )


def _graph(inputs: StepInputs) -> Graph:
    """Return the graph, which there must be."""
    if inputs.adjacency is None:
        raise ValueError("a GraphTransition needs a graph, and the inputs have no adjacency")
    return inputs.adjacency


def _shorter(graph: Graph, like: torch.Tensor) -> Graph:
    """Return a matrix as a list of edges, where that saves many messages between pairs."""
    if isinstance(graph, EdgeList) or graph.numel() < FEW_PAIRS:
        return graph
    # Compiled code likes shapes that do not depend on the data.
    if graph.requires_grad or graph.dim() > like.dim() or torch.compiler.is_compiling():
        return graph
    try:
        edges = EdgeList.from_dense(graph)
    except RuntimeError:
        # Within `vmap` nothing may depend on how many edges there are.
        return graph
    return edges if edges.num_edges < LIST_UP_TO_DENSITY * graph.numel() else graph


def _limits(scales: Scales) -> SoftSpeedLimits:
    """Return limits that start where few speeds lie beyond them."""
    speed = _positive(scales.speed)
    low, high = max(scales.slow, 0.01 * speed), max(scales.fast, 0.02 * speed)
    return SoftSpeedLimits(low, high, 0.1 * max(high - low, 0.1 * speed))


def _start_noise(scales: Scales) -> PyroParam:
    """Return a parameter that starts at the noise of constant velocity."""
    change = _positive(scales.step)
    # What tracking noise alone makes of the change of a velocity is not motion.
    own = change**2 - 6.0 * (scales.noise / scales.dt) ** 2
    start = torch.tensor(math.sqrt(max(own, 0.01 * change**2)))
    return PyroParam(start, constraint=constraints.greater_than(LEAST_NOISE * change))


def _positive(size: float) -> float:
    """Return a typical size that can be divided by."""
    return size if size > 0.0 else 1.0


def _norm(vectors: torch.Tensor) -> torch.Tensor:
    """Return lengths ``(..., 1)``, smooth at 0."""
    return (vectors.square().sum(-1, keepdim=True) + 1e-6).sqrt()
