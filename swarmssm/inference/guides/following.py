"""Guides that follow their model: its law, at a reference path, with a network's corrections."""

import contextlib
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.func import jacrev

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, Graph
from swarmssm.inference.guides.base import PathGuide
from swarmssm.inference.guides.chains import (
    Chain,
    Law,
    Observations,
    Start,
)
from swarmssm.inference.guides.context import SwarmContext
from swarmssm.inference.guides.full_chain import FullChain
from swarmssm.inference.guides.kinematic_chain import KinematicChain
from swarmssm.models import SwarmBatch
from swarmssm.models.distributions.moments import covariance_of
from swarmssm.models.emissions import Emission
from swarmssm.models.layers import multilayer_perceptron
from swarmssm.models.markov import StepInputs
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions import KinematicTransition

__all__ = ["ModelInformedGuide", "PosteriorParameters"]

#: A correction of a logarithm stays within this; so does one of a mean, in standard deviations.
BOUND = 5.0
#: Variances are at least this fraction of the initial one's, for float32 to tell them from 0.
LEAST_VARIANCE = 1e-12
#: Network inputs stay within this.
INPUT_BOUND = 10.0


@dataclass(frozen=True)
class PosteriorParameters:
    """All that decides the posterior of a batch of paths.

    Attributes
    ----------
    reference
        Path about which the rest is told, ``(batch, time, individual, state)``.
    sightings, law, start
        See :mod:`swarmssm.inference.guides.chains`.
    correction
        What the network says of the posterior's own scales, ``(batch, time, individual, state)``.
    graph
        Of each step; ``None`` where there is none.
    """

    reference: Tensor
    sightings: Observations
    law: Law
    start: Start
    correction: Tensor
    graph: Graph | None


class ModelInformedGuide(PathGuide):
    r"""What is common to the guides that keep up with their model.

    The path is first smoothed with each individual left to itself (a body keeps its velocity, any
    other state stays as it is). About this reference the model says, with the very parameters that
    were drawn, where everybody goes and with how much noise, and how noisy sightings are. A network
    of the swarm (:class:`~swarmssm.inference.guides.context.SwarmContext`) corrects all of these,
    and starts with no correction. So the guide knows a model's forces without learning them, and
    keeps up with a model that learns.

    Where the emission does not show features of the state as they are (its derivative is no
    selection of them), a second network makes sightings of what was observed.

    Parameters
    ----------
    model
        Its transition must be smooth, and either kinematic or one in which all features have noise.
    parameters
        Guide of the parameters with a prior, see :class:`swarmssm.inference.guides.GlobalGuide`.
    hidden
        Width of the network.
    passes
        How many times a reference is made. After the first, it follows the model's law about the
        one before. Gradients do not flow through references.

    Raises
    ------
    InputError
        If the transition's next states have no density, or the guide does not know how its free
        features move the others.
    """

    #: Whether gradients flow through the law that is read off the model.
    differentiates_law: ClassVar[bool]

    def __init__(
        self,
        model: StateSpaceModel,
        parameters: str = "multivariate",
        hidden: int = 32,
        passes: int = 1,
    ) -> None:
        super().__init__(model, parameters)
        self.options: dict[str, Any] = {
            "parameters": parameters,
            "hidden": hidden,
            "passes": passes,
        }
        self.passes = passes
        self.chain = _chain_for(model, type(self).__name__)
        state, free = self.chain.state_dim, self.chain.noise_dim
        shown = None if model.emission.is_exact else _features_shown(model.emission, state)
        self.shown = shown
        if shown is None:
            self.recogniser = multilayer_perceptron([_observed_dim(model), hidden, 2 * state])
        self.is_kinematic = isinstance(self.chain, KinematicChain)
        if not self.is_kinematic:
            own, neighbor = self._typical_gains()
            self.own_gain, self.neighbor_gain = nn.Parameter(own), nn.Parameter(neighbor)
        # Per frame: drift and noise of the step into it; sightings; gains; the guide's own scale.
        self.parts = [free, free, state, state, 2 if self.is_kinematic else 0, state]
        self.context = SwarmContext(2 * state + free + 2, hidden)
        self.correct = nn.Linear(self.context.out_features, sum(self.parts))
        nn.init.zeros_(self.correct.weight)
        nn.init.zeros_(self.correct.bias)

    def setting(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> PosteriorParameters:
        """Return what decides the posterior of a batch's paths.

        Parameters
        ----------
        batch, values
            As in :meth:`PathGuide.path`.
        """
        with self.model.fixed(values):
            return self._setting(batch)

    def mean_path(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> Tensor:
        """Return the mean path of each individual; see :meth:`PathGuide.mean_path`.

        What neighbours add when they leave the reference path is left out.
        """
        known = self.setting(batch, values)
        parts = known.sightings, known.law, known.start, batch.present
        return known.reference + self.chain.mean(*parts)

    def _setting(self, batch: SwarmBatch) -> PosteriorParameters:
        initial = self.model.initial()
        shape = (*batch.observations.shape[:-1], self.chain.state_dim)
        mean, variance = initial.mean.expand(shape), initial.variance.expand(shape)
        there = batch.present.unsqueeze(-1)
        with torch.no_grad():
            reference = self._rough(batch, mean, variance)
        for _ in range(self.passes - 1):
            with torch.no_grad():
                sightings = self._sightings(batch, reference, variance)
                law = self._law(batch, reference, variance)
                start = Start(mean - reference, variance)
                off = self.chain.mean(sightings, law, start, batch.present)
                reference = torch.where(there, reference + off, 0.0)
        sightings = self._sightings(batch, reference, variance)
        with contextlib.nullcontext() if self.differentiates_law else torch.no_grad():
            law = self._law(batch, reference, variance)
        inputs = StepInputs(batch.adjacency, batch.controls, batch.present, batch.edge_types)
        graph = self.model.edges(reference, inputs)
        nodes = self._nodes(batch, reference, mean, variance, sightings, law)
        told = self.correct(self.context(nodes, graph, batch.present))
        told = BOUND * (told / BOUND).tanh()
        drift, noise, seen, sure, gains, own = torch.split(told, self.parts, -1)
        sightings = Observations(
            sightings.location + seen * _inverse_root(sightings.precision),
            sightings.precision * (-sure).exp(),
        )
        law = self._corrected(law, drift[:, 1:], noise[:, 1:], gains[:, 1:], sightings, sure)
        start = Start(mean - reference, variance)
        return PosteriorParameters(reference, sightings, law, start, own, _steps_of(graph))

    def _typical_gains(self) -> tuple[Tensor, Tensor]:
        """Return what the own state, and the mean of the neighbours', do to the next one.

        Of individuals that see each other, at the usual parameters. A model that takes exception to
        their number gets the gains of states that stay as they are: they are learned anyway.
        """
        state = self.chain.state_dim
        try:
            with torch.no_grad(), torch.random.fork_rng():
                torch.manual_seed(0)
                values = self.parameters_guide()
                with self.model.fixed(values):
                    initial = self.model.initial()
                    count = max(2, *initial.batch_shape, 2)
                    states = initial.expand((count,)).sample()
                    everybody = 1.0 - torch.eye(count, dtype=states.dtype)
                    law = self.model.transition.linearize(states, StepInputs(everybody))
                gains = law.jacobian[0]
                return gains[:, 0].clone(), gains[:, 1:].sum(1)
        except (RuntimeError, ValueError):
            return torch.eye(state), torch.zeros(state, state)

    def _corrected(
        self,
        law: Law,
        drift: Tensor,
        noise: Tensor,
        gains: Tensor,
        sightings: Observations,
        sure: Tensor,
    ) -> Law:
        """Return the law with the network's corrections."""
        if self.is_kinematic:
            scale = law.noise.sqrt()
            # An error of a position of one tracking noise, in noises of the velocity.
            space = self.chain.noise_dim
            seen = sightings.precision[:, :-1, :, :space]
            # The 1 keeps the root's slope finite where nothing was seen.
            known = seen > 0
            ratio = (law.noise * torch.where(known, seen, 1.0)).sqrt() * known
            ratio = ratio.mean(-1, keepdim=True)
            k, a = law.gains
            gains_k, gains_a = gains.chunk(2, -1)
            return Law(
                law.drift + drift * scale,
                law.noise * noise.exp(),
                (k + gains_k * ratio, a + gains_a),
            )
        moved = (law.noise @ drift.unsqueeze(-1)).squeeze(-1)
        return Law(law.drift + moved, law.noise * (0.5 * noise).exp().unsqueeze(-2), law.gains)

    def _gains(self, like: Tensor) -> tuple[Tensor, ...]:
        """Return what an individual left to itself does."""
        if self.is_kinematic:
            zero = torch.zeros_like(like[..., :1])
            return zero, zero + 1.0
        return (self.own_gain,)

    def _rough(self, batch: SwarmBatch, mean: Tensor, variance: Tensor) -> Tensor:
        """Smooth each individual by itself; return the path, 0 where absent."""
        about, sightings = self._still(batch, mean, variance)
        start = Start(mean - about, variance)
        # The noise of the law where the window begins stands for all of it.
        steps = batch.steps()
        graph = steps.adjacency
        first = StepInputs(
            _first_step(graph),
            None if steps.controls is None else steps.controls[:, :1],
            None if steps.present is None else steps.present[:, :1],
            None if steps.edge_types is None else steps.edge_types[:, :1],
        )
        if batch.num_times > 1:
            noise = self._noise(self.model.step(about[:, :1], first), variance[:, :1])
            noise = noise.expand(-1, batch.num_times - 1, *noise.shape[2:])
        else:
            noise = self._noise_like(variance)[:, :0]
        drift = torch.zeros_like(mean[:, 1:, :, : self.chain.noise_dim])
        law = Law(drift, noise, self._gains(drift))
        smoothed = about + self.chain.mean(sightings, law, start, batch.present)
        return torch.where(batch.present.unsqueeze(-1), smoothed, 0.0)

    def _still(
        self, batch: SwarmBatch, mean: Tensor, variance: Tensor
    ) -> tuple[Tensor, Observations]:
        """Return a path on which everybody stays in the middle of where it was seen, and what was
        seen as deviations from it.
        """
        sightings = self._sightings(batch, mean, variance)
        weight = sightings.precision.sum(1, keepdim=True)
        middle = (sightings.location * sightings.precision).sum(1, keepdim=True)
        middle = middle / torch.where(weight > 0, weight, 1.0)
        still = mean + middle
        if self.is_kinematic:
            space = self.chain.noise_dim
            still = torch.cat([still[..., :space], torch.zeros_like(still[..., space:])], -1)
        return still, sightings._replace(location=sightings.location - (still - mean))

    def _sightings(self, batch: SwarmBatch, reference: Tensor, variance: Tensor) -> Observations:
        """Return what was seen, as deviations from a reference."""
        observed, mask = batch.observations, batch.mask.unsqueeze(-1)
        if self.shown is None:
            location, precision = self.recogniser(observed).chunk(2, -1)
            initial = self.model.initial()
            location = initial.mean + location * variance.sqrt() - reference
            precision = (BOUND * (precision / BOUND).tanh()).exp() / variance
            return Observations(location, precision * mask)
        assert not self.model.emission.is_exact
        seen = self.model.emission(reference)
        width = observed.shape[-1]
        noise = seen.variance.expand(observed.shape)
        noise = noise.clamp(min=LEAST_VARIANCE * variance[..., self.shown])
        known = torch.where(mask, (observed - seen.mean).nan_to_num(), 0.0)
        location = torch.zeros_like(reference)
        precision = torch.zeros_like(reference)
        if self.shown == list(range(width)):
            rest = torch.zeros_like(reference[..., width:])
            return Observations(torch.cat([known, rest], -1), torch.cat([mask / noise, rest], -1))
        index = torch.tensor(self.shown, device=observed.device)
        return Observations(
            location.index_copy(-1, index, known), precision.index_copy(-1, index, mask / noise)
        )

    def _law(self, batch: SwarmBatch, reference: Tensor, variance: Tensor) -> Law:
        """Return the model's law about a reference."""
        if batch.num_times == 1:
            drift = reference[:, :0, :, : self.chain.noise_dim]
            return Law(drift, self._noise_like(variance)[:, :0], self._gains(drift))
        following = self.model.step(reference[:, :-1], batch.steps())
        expected = self.model.transition.stochastic_features(following.mean)
        drift = expected - self.model.transition.stochastic_features(reference[:, 1:])
        persists = (batch.present[:, 1:] & batch.present[:, :-1]).unsqueeze(-1)
        drift = torch.where(persists, drift, 0.0)
        return Law(drift, self._noise(following, variance[:, 1:]), self._gains(drift))

    def _noise(self, following: Any, variance: Tensor) -> Tensor:
        """Return variances of free features, or square roots of covariances."""
        if self.is_kinematic:
            free = self.model.transition.stochastic_features(following.variance)
            least = LEAST_VARIANCE * variance[..., self.chain.noise_dim :]
            return torch.maximum(free.expand(least.shape), least)
        matrix = covariance_of(following)
        matrix = matrix.expand(*variance.shape, matrix.shape[-1])
        root: Tensor = torch.linalg.cholesky(matrix + LEAST_VARIANCE * torch.diag_embed(variance))
        return root

    def _noise_like(self, variance: Tensor) -> Tensor:
        """Return any noise of the right shape, for windows without a step."""
        if self.is_kinematic:
            return variance[..., self.chain.noise_dim :]
        return torch.diag_embed(variance)

    def _nodes(
        self,
        batch: SwarmBatch,
        reference: Tensor,
        mean: Tensor,
        variance: Tensor,
        sightings: Observations,
        law: Law,
    ) -> Tensor:
        """Return the inputs of the network, of about size 1."""
        known = sightings.precision > 0
        off = sightings.location * torch.where(known, sightings.precision, 1.0).sqrt() * known
        place = (reference - mean) / variance.sqrt()
        if self.is_kinematic:
            pushed = law.drift / law.noise.sqrt()
        else:
            pushed = torch.linalg.solve_triangular(
                law.noise, law.drift.unsqueeze(-1), upper=False
            ).squeeze(-1)
        pushed = torch.cat([torch.zeros_like(reference[:, :1, :, : pushed.shape[-1]]), pushed], 1)
        flags = torch.stack([batch.mask, batch.present], -1).to(reference.dtype)
        nodes = torch.cat([off, place, pushed], -1)
        return torch.cat([nodes.clamp(-INPUT_BOUND, INPUT_BOUND), flags], -1)

    @abstractmethod
    def path(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Draw a path for each window; see :meth:`PathGuide.path`."""


def _chain_for(model: StateSpaceModel, guide: str) -> Chain:
    """Return the kind of law that a model's transition has, or say why there is none."""
    transition = model.transition
    name = type(transition).__name__
    if not transition.is_smooth:
        raise InputError(
            f"guide: a {guide} needs next states that have a density, and those of this {name} "
            "may sit exactly at a limit; choose a transition without hard limits."
        )
    if isinstance(transition, KinematicTransition):
        return KinematicChain(transition.space, transition.dt)
    if transition.noise_dim == transition.state_dim:
        return FullChain(transition.state_dim)
    raise InputError(
        f"guide: a {guide} needs a KinematicTransition, or a transition that moves all "
        f"{transition.state_dim} features of a state by noise, and {name} moves "
        f"{transition.noise_dim} of them."
    )


def _observed_dim(model: StateSpaceModel) -> int:
    """Return the number of features that are observed."""
    if model.emission.is_exact:
        return model.state_dim
    with torch.no_grad(), torch.random.fork_rng():
        weight = next(iter(model.emission.parameters()), torch.zeros(()))
        seen = model.emission(torch.zeros(1, model.state_dim, dtype=weight.dtype))
        return int(seen.event_shape[0])


def _features_shown(emission: Emission, state_dim: int) -> list[int] | None:
    """Return which feature of a state each observed one shows, if each shows one as it is."""

    def mean_of(state: Tensor) -> Tensor:
        mean: Tensor = emission(state.expand(1, -1)).mean
        return mean.reshape(-1, mean.shape[-1])[0]

    with torch.random.fork_rng():
        weight = next((p for p in emission.parameters()), None)
        zero = torch.zeros(state_dim, dtype=None if weight is None else weight.dtype)
        jacobian = jacrev(mean_of)(zero)
    shown = jacobian.abs().argmax(-1)
    selection = torch.nn.functional.one_hot(shown, state_dim).to(jacobian.dtype)
    if not torch.equal(jacobian, selection) or len(set(shown.tolist())) < len(shown):
        return None
    return [int(feature) for feature in shown]


def _first_step(graph: Graph | None) -> Graph | None:
    """Return the graph of the first step, its time dimension kept."""
    if isinstance(graph, EdgeList):
        return graph.select(1, 0, 1)
    return None if graph is None else graph[:, :1]


def _steps_of(graph: Graph | None) -> Graph | None:
    """Return the graph at the beginning of each step, of those of all frames."""
    if isinstance(graph, EdgeList):
        return graph.select(1, 0, graph.leading[1] - 1)
    return None if graph is None else graph[:, :-1]


def _inverse_root(precision: Tensor) -> Tensor:
    """Return standard deviations, 0 where nothing was seen."""
    seen = precision > 0
    return torch.where(seen, torch.where(seen, precision, 1.0).rsqrt(), 0.0)
