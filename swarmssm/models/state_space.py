"""The swarm as a state-space model: hidden states that move each other, seen with noise."""

import contextlib
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Self

import pyro
import pyro.distributions as dist
import torch
from pyro.distributions import TorchDistribution
from pyro.nn import PyroModule, pyro_method
from pyro.poutine.runtime import am_i_wrapped

from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import EdgeList, Graph, GraphRule
from swarmssm.models.base import SwarmModel
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.edges import (
    Edges,
    EdgeTypes,
    InferredEdges,
    LatentEdges,
    ObservedEdges,
)
from swarmssm.models.emissions import Emission, ExactEmission
from swarmssm.models.layers import check_sizes
from swarmssm.models.markov import MarkovChain, StepInputs
from swarmssm.models.parameters import convert_priors, fixed, priors_of
from swarmssm.models.pyro_modules import adopt, call_context, priors_in
from swarmssm.models.simulation import (
    Simulation,
    fitting,
    generator,
    seeded,
    stack,
    two_sizes,
    without_last,
)
from swarmssm.models.supports import describe
from swarmssm.models.transitions.base import Transition

__all__ = ["StateSpaceModel"]


class StateSpaceModel(SwarmModel):
    r"""Deep state-space model with explicit dynamics on a graph.

    .. math::
        p(\theta)\, p(z_1) \prod_{t=2}^T p(z_t \mid z_{t-1}, G_{t-1}, \theta)
        \prod_{t=1}^T p(x_t \mid z_t, \theta)

    The path :math:`z_{1:T}` of a window is the one latent site ``"states"``, a
    :class:`~swarmssm.models.MarkovChain` of event shape ``(time, individual, state)``;
    what was seen is the site ``"observations"``. Frames in which an individual was not observed
    have no term: they are marginalised. Individuals enter and leave as ``batch.present`` says.
    Every parameter with a prior is a site of its full name, such as ``"transition.gain"``.

    In a mini-batch of B windows out of M the terms of the windows count M / B times, and the priors
    once.

    Parameters
    ----------
    initial
        Called without arguments, returns the distribution of a first state
        (:class:`~swarmssm.models.InitialStates`).
    transition
        Law of motion.
    emission
        Law of observation; absent, :class:`~swarmssm.models.ExactEmission`: states are observed
        exactly, so that ``"states"`` is an observed site and the transition is scored directly, on
        the steps of which both ends were seen. The first frame after a gap is scored as that of an
        individual that enters.
    edges
        Where the graph comes from; absent, it is the observed one. Those whose types are inferred
        (:class:`~swarmssm.models.InferredEdges`) are a further latent site, ``"edges"``.

    Raises
    ------
    InputError
        If a part is none; in a call, if the parts do not fit each other or the batch, with both
        shapes.
    """

    scaler = "none"

    def __init__(
        self,
        initial: PyroModule,
        transition: Transition,
        emission: Emission | None = None,
        edges: Edges | None = None,
    ) -> None:
        emission = ExactEmission() if emission is None else emission
        edges = ObservedEdges() if edges is None else edges
        _check_parts(initial, transition, emission, edges)
        super().__init__(transition.state_dim)
        self.initial = initial
        self.transition = transition
        self.emission = emission
        self.edges = edges
        adopt(self)

    @property
    def observes(self) -> str:
        """Which features of the tracks are observed."""
        return self.emission.observes

    @property
    def has_exact_states(self) -> bool:
        """Whether states are observed exactly, so that none are latent."""
        return self.emission.is_exact

    @property
    def has_networks(self) -> bool:
        """Whether transition or emission have weights, beside numbers to be inferred.

        Such are learned parameters that are matrices. Without them the latent states are best
        summed out.
        """
        parts = (self.transition, self.emission)
        return any(weight.dim() > 1 for part in parts for weight in part.parameters())

    def augmented(self, batch: SwarmBatch) -> SwarmBatch:
        """Return the windows, or an image in which the law of motion looks the same."""
        return self.transition.augmented(batch)

    def _apply(self, fn: Callable[[torch.Tensor], torch.Tensor], recurse: bool = True) -> Self:
        """Change type or device of everything, the numbers in the priors too."""
        super()._apply(fn, recurse)
        convert_priors(self, fn)
        return self

    @pyro_method  # type: ignore[untyped-decorator]
    def sample_globals(self) -> dict[str, torch.Tensor]:
        """Sample every parameter that has a prior; itself a Pyro model of these sites alone.

        Returns
        -------
        Full name -> value.

        Raises
        ------
        InputError
            If a value that was put in its place (by a guide, by ``poutine.condition``) has another
            shape than the prior.
        """
        values = {}
        for name in priors_of(self):
            place, _, attribute = name.rpartition(".")
            module = self.get_submodule(place)
            value = getattr(module, attribute)
            prior = priors_in(module)[attribute]
            if isinstance(prior, dist.Distribution) and value.shape != prior.event_shape:
                value = _without_plates(name, value, prior.event_shape)
                call_context(self).set(name, value)
            values[name] = value
        return values

    @contextlib.contextmanager
    def fixed(self, values: Mapping[str, torch.Tensor]) -> Iterator[None]:
        """Let parameters with priors have given values for a while, by full name.

        Raises
        ------
        InputError
            If there is no parameter of such a name with a prior.
        """
        self._check_names(values)
        with fixed(self, values):
            yield

    def _check_names(self, values: Mapping[str, torch.Tensor], *, complete: bool = False) -> None:
        """Refuse values of parameters that have no prior, and parameters without a value."""
        names = priors_of(self)
        unknown = sorted(set(values) - set(names))
        missing = [name for name in names if name not in values] if complete else []
        if unknown:
            known = ", ".join(names) if names else "none at all"
            raise InputError(
                f"values: {', '.join(unknown)} is no parameter with a prior. Those there are: "
                f"{known}."
            )
        if missing:
            raise InputError(f"values: {', '.join(missing)} is missing; it has a prior.")

    def step(self, states: torch.Tensor, inputs: StepInputs) -> TorchDistribution:
        """Return the distribution of the next states, on the graph that the edges say."""
        return self.transition(states, self.edges.complete(states, inputs))

    def chain(self, batch: SwarmBatch, values: Mapping[str, torch.Tensor]) -> MarkovChain:
        """Return the prior of the paths of a batch of windows, batch shape ``(batch,)``.

        Parameters
        ----------
        batch
            Windows; of the observations only shape and type matter.
        values
            Those of all parameters with a prior, by full name. They hold whenever the chain is
            sampled or scored.

        Raises
        ------
        InputError
            If a value is missing or unknown, or first states are of another size.
        """
        there, inputs = batch.present, batch.steps()
        if self.emission.is_exact:
            there = batch.mask
            inputs = replace(inputs, present=there[:, :-1])
        return self._chain(there, inputs, values, self.edges)

    def _chain(
        self,
        there: torch.Tensor,
        inputs: StepInputs,
        values: Mapping[str, torch.Tensor],
        edges: Edges,
        first: torch.Tensor | None = None,
    ) -> MarkovChain:
        """Return the prior of paths of those who are there, ``(batch, time, individual)``."""
        self._check_names(values, complete=True)

        def step(states: torch.Tensor, inputs: StepInputs) -> TorchDistribution:
            with fixed(self, values):
                return self.transition(states, edges.complete(states, inputs))

        if first is None:
            with fixed(self, values):
                initial = self.initial()
        else:
            with fixed(self, values):
                dtype = self.initial().sample().dtype
            initial = dist.Delta(first.to(dtype), event_dim=1)
        if initial.event_shape != (self.state_dim,):
            raise InputError(
                f"initial: first states must have the shape of the transition's, "
                f"({self.state_dim},), and they have {tuple(initial.event_shape)}."
            )
        batch, times, individuals = there.shape
        return MarkovChain(
            initial,
            step,
            times,
            individuals,
            inputs=inputs,
            mask=there,
            batch_shape=torch.Size([batch]),
        )

    def forward(self, batch: SwarmBatch) -> torch.Tensor:
        """Score a batch of windows; to be run under a Pyro handler. Returns the paths."""
        values = self.sample_globals()
        # Simply called, as a sampler, a model has no use for it, and Pyro would warn.
        weights = self.transition.log_prior() if self.training and am_i_wrapped() else None
        if weights is not None:
            pyro.factor("weights", weights)
        rows = torch.arange(len(batch), device=batch.mask.device)
        with (
            pyro.plate("windows", batch.population, subsample=rows, dim=-1),
            pyro.poutine.scale(scale=batch.window_weight),
        ):
            self._check_type(batch)
            drawn = None
            if isinstance(self.edges, InferredEdges):
                prior = self.edges.prior(batch)
                drawn = prior, pyro.sample("edges", prior)
                batch = self.edges.with_edge_types(batch, drawn[1])
            chain = self.chain(batch, values)
            if self.emission.is_exact:
                self._check_features(batch, self.state_dim)
                states: torch.Tensor = pyro.sample("states", chain, obs=batch.observations)
                self._add_edge_learning_term(chain, states, drawn)
                return states
            states = pyro.sample("states", chain)
            self._add_edge_learning_term(chain, states, drawn)
            observed = self.emission(states)
            if len(observed.event_shape) != 1:
                raise InputError(
                    "emission: it must return a distribution of event shape (observation,), and "
                    f"this one has {tuple(observed.event_shape)}. .to_event(1) makes features an "
                    "event."
                )
            self._check_features(batch, observed.event_shape[0])
            observed = observed.mask(batch.mask).to_event(2)
            pyro.sample("observations", observed, obs=batch.observations)
        return states

    def _add_edge_learning_term(
        self,
        chain: MarkovChain,
        states: torch.Tensor,
        drawn: tuple[EdgeTypes, torch.Tensor] | None,
    ) -> None:
        """Let inferred edges learn from the path; see :class:`InferredEdges`."""
        if drawn is None or not isinstance(self.edges, InferredEdges):
            return
        there = chain.mask_present
        assert there is not None, "the chain of windows says who is there"
        prior, types = drawn
        term = self.edges.conditional_term(
            chain.transition, states, there, chain.inputs, types, prior
        )
        if term is not None:
            pyro.factor("edge_conditionals", term)

    def _check_type(self, batch: SwarmBatch) -> None:
        """Refuse observations whose products with the model's matrices torch would refuse."""
        wanted = batch.observations.dtype
        for weight in itertools.chain(self.parameters(), self.buffers()):
            if weight.dim() > 1 and weight.is_floating_point() and weight.dtype != wanted:
                raise InputError(
                    f"observations: they are of {wanted}, and the model is of {weight.dtype}. "
                    f"Change one of them, for instance model.to({wanted})."
                )

    def _check_features(self, batch: SwarmBatch, features: int) -> None:
        """Refuse observations of another number of features than the model's."""
        given = tuple(batch.observations.shape)
        if given[-1] != features:
            raise InputError(
                f"observations: the model observes {features} features of each individual "
                f"({self.observes}), and the batch is (batch, time, individual, observation) = "
                f"{given}."
            )

    def simulate(
        self,
        num_steps: int,
        num_individuals: int,
        *,
        num_windows: int = 1,
        values: Mapping[str, Any] | None = None,
        graph: Graph | GraphRule | str | None = None,
        controls: torch.Tensor | None = None,
        present: torch.Tensor | None = None,
        first: torch.Tensor | None = None,
        seed: int | torch.Generator = 0,
    ) -> Simulation:
        """Draw parameters from their priors, and swarms that move by them.

        Parameters
        ----------
        num_steps
            T, the number of frames.
        num_individuals
            In each swarm.
        num_windows
            How many swarms, all with the same parameters.
        values
            Of parameters with a prior, by full name; the others are drawn.
        graph
            Who sees whom: ``(time, individual, individual)`` or ``(batch, time, individual,
            individual)``; a list of edges with leading shape ``(batch, time)``; or a rule such as
            ``"radius:2.5"`` that makes the graph of the states as they go. Absent, the model's own
            edges say it, and a model with observed edges has none: nobody sees anybody.
        controls
            ``(batch, time, control)`` or ``(time, control)``.
        present
            Who is there, ``(batch, time, individual)`` or ``(time, individual)`` of bool; absent,
            all are.
        first
            First states, ``(batch, individual, state)`` or ``(individual, state)``, also of who
            enters later; absent, they are drawn.
        seed
            Whole number or generator.

        Raises
        ------
        InputError
            If a size is no positive whole number, or a shape, name or value does not fit.
        WorkError
            If the swarm runs away so far that numbers end.
        """
        drawn = self._drawn(
            (num_windows, num_steps, num_individuals),
            values,
            graph,
            controls,
            present,
            first,
            seed,
        )
        finite = drawn.states.isfinite().all(-1)
        if not bool(finite.all()):
            frame = int(torch.nonzero(~finite)[:, 1].min())
            raise WorkError(
                f"simulate: the states are no longer finite at frame {frame}. With these "
                "parameters the swarm runs away; take others, or another seed."
            )
        return drawn

    def _drawn(
        self,
        shape: tuple[int, int, int],
        values: Mapping[str, Any] | None,
        graph: Graph | GraphRule | str | None,
        controls: torch.Tensor | None,
        present: torch.Tensor | None,
        first: torch.Tensor | None,
        seed: int | torch.Generator,
    ) -> Simulation:
        """Check what was given to :meth:`simulate`, and draw."""
        num_windows, num_steps, num_individuals = shape
        try:
            check_sizes(
                num_steps=num_steps, num_individuals=num_individuals, num_windows=num_windows
            )
        except ValueError as error:
            raise InputError(f"simulate: {error}.") from None
        given = self._given(values or {})
        edges = self.edges
        if isinstance(graph, str | GraphRule):
            edges, graph = LatentEdges(graph), None
        there = torch.ones(shape, dtype=torch.bool)
        if present is not None:
            there = fitting("present", present, shape).bool()
        if isinstance(graph, EdgeList):
            if (*graph.leading, graph.individuals) != shape:
                raise InputError(
                    f"graph: it must be of frames and individuals {shape}, and it is of "
                    f"{(*graph.leading, graph.individuals)}."
                )
        elif graph is not None:
            graph = fitting("graph", graph, (*shape, num_individuals))
        if controls is not None:
            features = torch.as_tensor(controls).shape[-1:]
            controls = fitting("controls", controls, (*shape[:2], *features))
        if first is not None:
            first = fitting("first", first, (num_windows, num_individuals, self.state_dim))
        # A swarm that runs away is told of at the end, in plainer words than a distribution has.
        with seeded(seed), pyro.validation_enabled(False):
            inputs = StepInputs(graph, controls, there)
            drawn: Simulation = self._simulate(there, inputs, given, edges, first)
        return drawn

    def _given(self, values: Mapping[str, Any]) -> dict[str, torch.Tensor]:
        """Return given values as tensors, if their priors allow them."""
        self._check_names(values)
        ready = {}
        for name, value in values.items():
            place, _, attribute = name.rpartition(".")
            prior = priors_in(self.get_submodule(place))[attribute]
            tensor = torch.as_tensor(value)
            if not tensor.is_floating_point():
                tensor = tensor.to(torch.get_default_dtype())
            if isinstance(prior, dist.Distribution):
                tensor = _without_plates(name, tensor, prior.event_shape)
                if not bool(prior.support.check(tensor).all()):
                    raise InputError(
                        f"values: {name} is not one that its prior can have; it must be "
                        f"{describe(prior.support)}."
                    )
            ready[name] = tensor
        return ready

    def sample_prior(
        self,
        like: SwarmBatch | tuple[int, int],
        num: int = 1,
        *,
        graph: Graph | GraphRule | str | None = None,
        seed: int | torch.Generator = 0,
    ) -> Simulation:
        """Draw parameters and swarms from the prior, each swarm with parameters of its own.

        Parameters
        ----------
        like
            Windows whose sizes, presence, controls and (if edges are observed) graph are taken, or
            ``(num_steps, num_individuals)`` of one.
        num
            How many draws.
        graph
            As in :meth:`simulate`; absent, that of the windows.
        seed
            Whole number or generator.

        Returns
        -------
        Simulation with a leading dimension ``draw``. A swarm may run away with the parameters of
        some draws: its states are then infinite or NaN.

        Raises
        ------
        InputError
            If a size is no positive whole number, or a shape does not fit.
        """
        try:
            check_sizes(num=num)
        except ValueError as error:
            raise InputError(f"sample_prior: {error}.") from None
        options: dict[str, Any] = {
            "num_windows": 1,
            "graph": graph,
            "present": None,
            "controls": None,
            "first": None,
        }
        if isinstance(like, SwarmBatch):
            sizes = (like.num_times, like.num_individuals)
            options |= {"num_windows": len(like), "present": like.present}
            options |= {"controls": like.controls}
            options["graph"] = like.adjacency if graph is None else graph
        else:
            sizes = two_sizes(like)
        shape = (options.pop("num_windows"), *sizes)
        source = generator(seed)
        return stack([self._drawn(shape, None, **options, seed=source) for _ in range(num)])

    @pyro_method  # type: ignore[untyped-decorator]
    def _simulate(
        self,
        there: torch.Tensor,
        inputs: StepInputs,
        values: Mapping[str, torch.Tensor],
        edges: Edges,
        first: torch.Tensor | None,
    ) -> Simulation:
        """Draw from the model; inputs have a value for every frame, the last one included."""
        with fixed(self, values):
            drawn = self.sample_globals()
        walk = edges.walk() if isinstance(edges, InferredEdges) else None
        chain = self._chain(there, without_last(inputs), drawn, walk or edges, first)
        states = chain.sample()
        with fixed(self, drawn):
            observations = self.emission(states).sample()
            if walk is None:
                graph = edges(states, inputs)
            else:
                walk.advance(states[:, -1], there[:, -1])
                graph = walk.graphs()
        return Simulation(
            {name: value.detach().clone() for name, value in drawn.items()},
            states,
            observations.masked_fill(~there.unsqueeze(-1), 0.0),
            there,
            graph,
            inputs.controls,
        )


def _check_parts(initial: Any, transition: Any, emission: Any, edges: Any) -> None:
    """Refuse parts of a model that are none, saying what each has to be."""
    wanted = {
        "initial": (initial, PyroModule, "a module that returns a distribution (InitialStates)"),
        "transition": (transition, Transition, "a Transition"),
        "emission": (emission, Emission, "an Emission"),
        "edges": (edges, Edges, "ObservedEdges, LatentEdges or RelationalEdges"),
    }
    for name, (part, kind, words) in wanted.items():
        if not isinstance(part, kind):
            what = part.__name__ if isinstance(part, type) else type(part).__name__
            mend = f" Call it: {what}(...)." if isinstance(part, type) else ""
            raise InputError(f"{name}: it must be {words}, and {what} is not.{mend}")


def _without_plates(name: str, value: torch.Tensor, shape: torch.Size) -> torch.Tensor:
    """Return a value without the dimensions of size 1 that Predictive gives it for plates."""
    place = value.dim() - len(shape)
    if place < 0 or value.shape[place:] != shape or value.numel() != shape.numel():
        raise InputError(
            f"{name}: a value must have the shape of its prior, {tuple(shape)}, and this one has "
            f"{tuple(value.shape)}. Many draws at once are made one by one: parallel=False in "
            "Predictive, vectorize_particles=False in an ELBO."
        )
    return value.reshape(shape)
