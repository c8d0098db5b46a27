"""Edges whose types are latent: inferred along with the paths."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, get_args

import torch
from torch import Tensor, nn

from swarmssm.errors import InputError
from swarmssm.graphs import Graph
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.edges.encoders import Memory
from swarmssm.models.edges.observed import Edges
from swarmssm.models.edges.seen import Seen, seen_states
from swarmssm.models.edges.types import EdgeTypes, Gradient
from swarmssm.models.layers import check_sizes
from swarmssm.models.markov import Step, StepInputs
from swarmssm.models.pyro_modules import LocalPyroModule
from swarmssm.models.relational import pairs_of
from swarmssm.models.scales import Scales

__all__ = ["EdgeFilter", "EdgeState", "InferredEdges"]


@dataclass(frozen=True)
class EdgeState:
    """What is known of edges at the last frame of a history.

    Attributes
    ----------
    types
        Those of the frame, ``(..., individual, neighbor, type)``: drawn, or their probabilities.
    memory
        Of the recurrence after the frame, if the edges have one.
    """

    types: Tensor
    memory: Memory | None = None

    def __getitem__(self, index: Any) -> "EdgeState":
        """Return a part along the leading dimensions."""
        if self.memory is None:
            return EdgeState(self.types[index])
        hidden, velocities = self.memory
        return EdgeState(self.types[index], Memory(hidden[index], velocities[index]))


class InferredEdges(LocalPyroModule, Edges):
    r"""Edges of K types, the latent site ``"edges"`` of a model.

    Types are drawn by :meth:`prior` in the model and by :meth:`posterior` in the guide, and put
    into the windows (:meth:`with_edge_types`): transitions, emissions, filters and guides see a
    graph like any other, with the weights :math:`A_{ij} = \sum_k s_k e_{ij,k}`, through which
    gradients reach the encoder. A transition that knows types
    (:class:`swarmssm.models.transitions.TypedTransition`) finds them in
    :attr:`swarmssm.models.StepInputs.edge_types`.

    A subclass writes :meth:`prior`, :meth:`encoder`, :meth:`posterior` and :meth:`following`.

    Parameters
    ----------
    scales
        Typical sizes of the tracks.
    num_types
        K.
    no_edge
        Whether the first type is no edge.
    sparsity
        Prior probability of no edge, the rest being shared by the other types; absent, all types
        are equally probable.
    strengths
        Whether the acting types but the first have a learned weight :math:`s_k`, which starts at
        1; else all have 1.
    near
        By how much log-odds of an edge fall with each spacing of distance before anything was
        learned, for encoders (and a learned prior) that begin with the thought that neighbours act
        on each other: 0, as probable at all distances. Learned on from there. ``None``: distance is
        one feature among others. Where laws take means over neighbours, fits that begin without it
        are apt to end with random edges and weak forces.
    hidden
        Width of the encoders.
    temperature
        Of the draws, see :class:`~swarmssm.models.edges.EdgeTypes`.
    gradient
        How the encoder learns. ``"conditional"``: from the probability of each type given the path
        and all other edges (:meth:`conditional_term`), which takes an evaluation of the transition
        for each sender and each other type; ``"straight-through"`` and ``"relaxed"``: by the
        derivative of the ELBO by the weights of the graph, as in the original. That one is blind
        where a law takes means over neighbours, since a mean over one is the same however small
        its weight, and vanishes where the encoder is sure and wrong.

    Raises
    ------
    InputError
        If an option is none of the above.
    """

    def __init__(
        self,
        scales: Scales,
        num_types: int = 2,
        *,
        no_edge: bool = True,
        sparsity: float | None = None,
        strengths: bool = False,
        near: float | None = None,
        hidden: int = 32,
        temperature: float = 0.5,
        gradient: Gradient = "conditional",
    ) -> None:
        super().__init__()
        try:
            check_sizes(num_types=num_types, hidden=hidden)
        except ValueError as error:
            raise InputError(f"edges: {error}.") from None
        if no_edge and num_types < 2:
            raise InputError(
                "edge_types: the first type is no edge, so that at least 2 are needed; or take "
                "no_edge=false."
            )
        if sparsity is not None and not no_edge:
            raise InputError("sparsity: it is the probability of no edge; take no_edge=true.")
        number = isinstance(sparsity, int | float) and not isinstance(sparsity, bool)
        if sparsity is not None and not (number and 0.0 < sparsity < 1.0):
            raise InputError(f"sparsity: it must be between 0 and 1, not {sparsity!r}.")
        number = isinstance(temperature, int | float) and not isinstance(temperature, bool)
        if not (number and 0.0 < temperature < math.inf):
            raise InputError(f"temperature: it must be positive, not {temperature!r}.")
        if gradient not in get_args(Gradient):
            listed = ", ".join(get_args(Gradient))
            raise InputError(f"gradient: it must be one of {listed}, not {gradient!r}.")
        number = isinstance(near, int | float) and not isinstance(near, bool)
        if near is not None and not (number and math.isfinite(near) and no_edge):
            raise InputError(
                f"near: it must be a number, with a type that is no edge, not {near!r}."
            )
        self.scales, self.near = scales, near
        self.num_types, self.no_edge, self.sparsity = num_types, no_edge, sparsity
        self.hidden, self.temperature, self.gradient = hidden, float(temperature), gradient
        acting = num_types - int(no_edge)
        self.has_strengths = strengths and acting > 1
        if self.has_strengths:
            self.log_strengths = nn.Parameter(torch.zeros(acting - 1))
        rest = (1.0 - (sparsity or 0.0)) / acting
        usual = [rest] * acting if sparsity is not None else [1.0 / num_types] * acting
        if no_edge:
            usual = [1.0 - sum(usual), *usual]
        self.register_buffer("usual", torch.tensor(usual).log())

    #: Whether types are fixed over a window.
    is_static: ClassVar[bool] = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the types: ``"none"`` for no edge, then ``"type 1"`` and so on."""
        acting = self.num_types - int(self.no_edge)
        return ("none",) * self.no_edge + tuple(f"type {k}" for k in range(1, acting + 1))

    def acting(self, types: Tensor) -> Tensor:
        """Return the types that act, ``(..., type)``."""
        return types[..., 1:] if self.no_edge else types

    def interacting(self, types: Tensor) -> Tensor:
        """Return the probability of any edge, ``(...)``, from types or their probabilities."""
        return self.acting(types).sum(-1)

    def weights(self, types: Tensor) -> Tensor:
        """Return the graph of types, ``(..., individual, neighbor)``."""
        if not self.has_strengths:
            return self.interacting(types)
        first = self.log_strengths.new_ones(1)
        strengths = torch.cat([first, self.log_strengths.exp()]).to(types.dtype)
        return (self.acting(types) * strengths).sum(-1)

    def forward(self, states: Tensor, inputs: StepInputs) -> Graph | None:
        """Return the graph of the types in the inputs, or the one that is there without them."""
        if inputs.edge_types is None:
            return inputs.adjacency
        return self.weights(inputs.edge_types)

    def with_edge_types(self, batch: SwarmBatch, types: Tensor) -> SwarmBatch:
        """Return windows with given types, ``(batch, time or 1, individual, neighbor, type)``.

        What is learned by :meth:`conditional_term` is not learned through the graph.
        """
        types = types.detach() if self.gradient == "conditional" else types
        types = types.expand(-1, batch.num_times, -1, -1, -1)
        return replace(batch, adjacency=self.weights(types), edge_types=types)

    def conditional_term(
        self,
        step: Step,
        path: Tensor,
        there: Tensor,
        inputs: StepInputs,
        types: Tensor,
        prior: EdgeTypes,
    ) -> Tensor | None:
        r"""Return a number for each window that is 0, and whose gradient teaches the encoder.

        It is that of the cross-entropy with each pair's distribution given all others,

        .. math:: \nabla_\phi \sum_{tij} \sum_k p(e_{tij} = k \mid e_{-tij}, z)
            \log q_\phi(e_{tij} = k \mid x), \qquad e \sim q_\phi, \qquad
            p(e_{tij} = k \mid \ldots) \propto p(e_{tij} = k)\, p(z \mid e_{-tij}, e_{tij} = k).

        Where q is right for the other edges, the mean of these is the posterior of the pair: the
        fixed point is :math:`p(e_{tij} \mid x)` itself, as of the wake phase of reweighted
        wake-sleep (Bornschein and Bengio, 2015, ICLR). All else learns by the ELBO.

        The next state of an individual depends on the edges to it alone, so that those of one
        sender to all receivers, in all steps, are tried together.

        Parameters
        ----------
        step
            From states and inputs to the distribution of the next states.
        path
            ``(batch, time, individual, state)``, held fixed.
        there
            Who is there, ``(batch, time, individual)`` of bool.
        inputs
            Of the steps, with types.
        types
            As they were drawn, ``(batch, time or 1, individual, neighbor, type)``.
        prior
            Of the types.

        Returns
        -------
        ``(batch,)``; ``None`` where there is nothing to learn from it.
        """
        if self.gradient != "conditional" or not types.requires_grad or path.shape[1] < 2:
            return None
        assert inputs.edge_types is not None, "the windows have edges"
        held = path.detach()
        stays = there[:, 1:] & there[:, :-1]

        def score(tried: Tensor) -> Tensor:
            given = replace(inputs, adjacency=self.weights(tried), edge_types=tried)
            found = step(held[:, :-1], given).log_prob(held[:, 1:])
            return torch.where(stays, found, 0.0)

        drawn = types if self.is_static else types[:, :-1]
        known = prior.scores if self.is_static else prior.scores[:, :-1]
        with torch.no_grad():
            targets = self._conditionals(score, inputs.edge_types, known)
        # Conditional draws have the gradient of log q, and no value beside that of the type.
        return (targets * (drawn - drawn.detach())).sum((1, 2, 3, 4))

    def _conditionals(
        self, score: Callable[[Tensor], Tensor], present: Tensor, known: Tensor
    ) -> Tensor:
        """Return the distribution of each type given all others.

        Parameters
        ----------
        score
            From types to the log-density of each step of each individual,
            ``(batch, step, individual)``.
        present
            ``(batch, step, individual, neighbor, type)``.
        known
            Log-probabilities of the prior, of each step or of the whole window; the result has its
            shape.
        """
        gains = torch.zeros_like(present)
        now = score(present)
        for sender in range(present.shape[-2]):
            for turn in range(1, self.num_types):
                other = present[..., sender, :].roll(turn, -1)
                tried = present.clone()
                tried[..., sender, :] = other
                gains[..., sender, :] += (score(tried) - now).unsqueeze(-1) * other
        if self.is_static:
            gains = gains.sum(1, keepdim=True)
        return (known + gains).softmax(-1)

    def seen(self, batch: SwarmBatch) -> Seen:
        """Return what encoders are told of windows."""
        return seen_states(batch, self.scales.space, self.scales.dt)

    def prior(self, batch: SwarmBatch) -> EdgeTypes:
        """Return the prior of the types in windows, batch shape ``(batch,)``."""
        raise TypeError(f"{type(self).__name__} must define prior(batch)")

    def encoder(self) -> nn.Module:
        """Return a new network for :meth:`posterior`."""
        raise TypeError(f"{type(self).__name__} must define encoder()")

    def posterior(self, batch: SwarmBatch, encoder: nn.Module, prior: EdgeTypes) -> EdgeTypes:
        """Return the distribution of types given whole windows, batch shape ``(batch,)``.

        Parameters
        ----------
        batch
            Windows.
        encoder
            Of the guide, made by :meth:`encoder`.
        prior
            Of the same windows.
        """
        raise TypeError(f"{type(self).__name__} must define posterior(batch, encoder, prior)")

    def memory(self, batch: SwarmBatch, types: Tensor) -> EdgeState:
        """Return what is known of edges at the end of windows with given types."""
        return EdgeState(types[:, -1])

    def following(
        self, states: Tensor, present: Tensor, known: EdgeState | None
    ) -> tuple[Tensor, Memory | None]:
        """Return the logits of types in one more frame, and the memory after it.

        Parameters
        ----------
        states
            Of the frame, ``(..., individual, state)``.
        present
            ``(..., individual)`` of bool.
        known
            At the frame before; ``None`` at the first.
        """
        raise TypeError(f"{type(self).__name__} must define following(states, present, known)")

    def drawn_pairs(self, present: Tensor) -> Tensor:
        """Return the pairs whose types are drawn in a frame, ``(..., individual, neighbor)``."""
        return pairs_of(present)

    def walk(self, known: EdgeState | None = None, *, sample: bool = True) -> "EdgeFilter":
        """Return edges of the frames to come, see :class:`EdgeFilter`."""
        return EdgeFilter(self, known, sample=sample)

    def distribution(self, logits: Tensor, pairs: Tensor, *, normalized: bool = True) -> EdgeTypes:
        """Return a distribution of types that draws as these edges do."""
        return EdgeTypes(
            logits, pairs, self.temperature, gradient=self.gradient, normalized=normalized
        )


class EdgeFilter(Edges):
    """Edges of a swarm that goes on freely, frame after frame.

    Parameters
    ----------
    edges
        The model's.
    known
        At the frame where it starts; ``None``: nothing was seen, and the first types are drawn
        from the prior.
    sample
        Whether types are drawn, or take their probabilities.
    """

    def __init__(self, edges: InferredEdges, known: EdgeState | None, *, sample: bool) -> None:
        super().__init__()
        # In a list, or it would be a part of this.
        self._edges = [edges]
        self.known, self.sample = known, sample
        #: Types of the frames that were gone through.
        self.record: list[Tensor] = []

    @property
    def types(self) -> Tensor:
        """Types of the present frame."""
        assert self.known is not None, "no frame was gone through yet"
        return self.known.types

    @property
    def graph(self) -> Tensor:
        """Weights of the present frame."""
        return self._edges[0].weights(self.types)

    def advance(self, states: Tensor, present: Tensor | None) -> None:
        """Go on to a frame.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        present
            ``(..., individual)`` of bool; ``None`` if all are there.
        """
        edges = self._edges[0]
        there = torch.ones(states.shape[:-1], dtype=torch.bool, device=states.device)
        if present is not None:
            there = there & present
        logits, memory = edges.following(states, there, self.known)
        pairs = edges.drawn_pairs(there)
        # Of one frame, which the distribution wants as a dimension.
        law = edges.distribution(logits.unsqueeze(-4), pairs.unsqueeze(-3))
        types = (law.sample() if self.sample else law.mean).squeeze(-4)
        self.known = EdgeState(types, memory)
        self.record.append(types)

    def graphs(self) -> Tensor:
        """Return the weights of all frames, ``(..., frame, individual, neighbor)``."""
        return self._edges[0].weights(torch.stack(self.record, -4))

    def here(self, inputs: StepInputs) -> StepInputs:
        """Return the inputs with the present frame's types and graph."""
        return replace(inputs, adjacency=self.graph, edge_types=self.types)

    def complete(self, states: Tensor, inputs: StepInputs) -> StepInputs:
        """Go on to the frame of these states, and return the inputs with its types and graph."""
        self.advance(states, inputs.present)
        return self.here(inputs)

    def forward(self, states: Tensor, inputs: StepInputs) -> Graph:
        """Go on to the frame of these states, and return its graph."""
        self.advance(states, inputs.present)
        return self.graph
