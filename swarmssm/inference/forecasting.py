"""Going on from where tracks end: one step at a time, on tensors."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import pyro
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.inference.guides import SwarmGuide
from swarmssm.models import SwarmModel
from swarmssm.scaling import Scaler

__all__ = ["EDGE_SOURCES", "Stepper", "Trajectory", "seeded"]

EDGE_SOURCES = ("decoder", "rule")


@dataclass(frozen=True)
class Trajectory:
    """Forecast steps.

    Attributes
    ----------
    states
        ``(..., step, individual, state)``, scaled.
    edge_probability
        ``(..., step, individual, individual)``: that the edge is there after the step.
    adjacency
        Same shape, of bool: the graph on which the step after it runs.
    """

    states: torch.Tensor
    edge_probability: torch.Tensor
    adjacency: torch.Tensor


@dataclass(frozen=True)
class Stepper:
    """The learned one-step rule x(t), A(t) -> x(t + 1), A(t + 1), applied again and again.

    Attributes
    ----------
    model, guide
        Fitted. The guide's ``encode(states, adjacency)`` gives the latent state of a frame, the
        model's ``decode`` the next frame.
    scaler, rule
        Of the fit; the rule is needed where ``edges`` is ``"rule"``.
    edges
        Where the next graph comes from: ``"decoder"``, the model's own edge probabilities, as in
        the thesis; ``"rule"``, made anew from the predicted states.
    """

    model: SwarmModel
    guide: SwarmGuide
    scaler: Scaler
    rule: GraphRule | None
    edges: str

    def __post_init__(self) -> None:
        if self.edges not in EDGE_SOURCES:
            raise InputError(
                f"edges: {self.edges!r} is unknown; choose one of {', '.join(EDGE_SOURCES)}."
            )
        if self.edges == "rule" and self.rule is None:
            raise InputError(
                "edges: the rule that makes the graph is not known, as it came with the data; "
                "choose edges='decoder'."
            )

    @torch.no_grad()
    def run(
        self,
        states: torch.Tensor,
        adjacency: torch.Tensor,
        present: torch.Tensor,
        steps: int,
        *,
        sample: bool,
    ) -> Trajectory:
        """Take ``steps`` steps from one frame.

        Parameters
        ----------
        states
            Scaled, ``(..., individual, state)``; what stands at absent individuals is ignored.
        adjacency
            ``(..., individual, individual)``.
        present
            ``(..., individual)`` of bool: who takes part; the others stay absent throughout.
        steps
            How many.
        sample
            Whether latent states, next states and edges are drawn, or their means (edges: those
            more likely than not) are taken.

        Returns
        -------
        Trajectory with ``steps`` frames after the given one; absent individuals are NaN.
        """
        pairs = present.unsqueeze(-1) & present.unsqueeze(-2)
        pairs = pairs & ~torch.eye(present.shape[-1], dtype=torch.bool, device=present.device)
        gone = ~present.unsqueeze(-1)
        frames, probabilities, graphs = [], [], []
        states = states.masked_fill(gone, 0.0)
        graph = adjacency.to(states.dtype) * pairs
        # A run that leaves all bounds is for the caller to judge, not for the distributions.
        with pyro.validation_enabled(False):
            for _ in range(steps):
                posterior = self.guide.encode(states, graph)
                latent = posterior.sample() if sample else posterior.mean
                following = self.model.decode(latent)
                drawn = following.states.sample() if sample else following.states.mean
                probability = following.edge_logits.sigmoid().nan_to_num() * pairs
                states = drawn.masked_fill(gone, 0.0)
                graph = self._graph(states, probability, gone, sample) * pairs
                frames.append(states.masked_fill(gone, torch.nan))
                probabilities.append(probability)
                graphs.append(graph.bool())
        return Trajectory(
            *(torch.stack(column, dim=-3) for column in (frames, probabilities, graphs))
        )

    def _graph(
        self, states: torch.Tensor, probability: torch.Tensor, gone: torch.Tensor, sample: bool
    ) -> torch.Tensor:
        """Return the graph on which the next step runs."""
        if self.edges == "decoder" or self.rule is None:
            drawn = torch.rand_like(probability) < probability if sample else probability > 0.5
            return drawn.to(states.dtype)
        positions, velocities = self.scaler.inverse_tensor(states).chunk(2, dim=-1)
        return self.rule(positions.masked_fill(gone, torch.nan), velocities).to(states.dtype)


@contextlib.contextmanager
def seeded(seed: int | torch.Generator) -> Iterator[None]:
    """Make torch's draws follow a seed or generator, and leave its global state as it was.

    A generator is advanced, so that two calls with the same one differ.
    """
    if isinstance(seed, torch.Generator):
        seed = int(torch.randint(2**62, (), generator=seed, device=seed.device))
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield
