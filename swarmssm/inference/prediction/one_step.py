"""Predictions of a one-step model: encode a frame, decode the next."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import pyro
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.inference.data import Prepared
from swarmssm.inference.guides import OneStepGuide
from swarmssm.inference.prediction.base import InitialCondition, Predictor, Trajectory, owning
from swarmssm.inference.starting import extrapolate_missing
from swarmssm.models import OneStepModel
from swarmssm.tracks.scaling import Scaler

__all__ = ["OneStepPredictor"]

#: Elements of the largest tensor of one chunk of frames, so that memory stays bounded.
CHUNK = 20_000_000


@dataclass(frozen=True)
class OneStepPredictor(Predictor):
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

    model: OneStepModel
    guide: OneStepGuide
    scaler: Scaler
    rule: GraphRule | None
    edges: str

    def __post_init__(self) -> None:
        if self.edges == "rule" and self.rule is None:
            raise InputError(
                "edges: the rule that makes the graph is not known, as it came with the data; "
                "choose edges='decoder'."
            )

    @owning
    def posterior(
        self, prepared: Prepared, draws: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Encode each frame; see :meth:`Predictor.posterior`."""
        hidden = ~prepared.mask.unsqueeze(-1)

        def encode(observations: torch.Tensor, adjacency: torch.Tensor) -> tuple[torch.Tensor, ...]:
            posterior = self.guide.encode(observations, adjacency)
            return posterior.mean, posterior.stddev

        mean, sd = _by_chunks(prepared, encode)
        states = None
        if draws:
            states = mean + sd * torch.randn(draws, *mean.shape)
            states = states.masked_fill(hidden, torch.nan)
        return mean.masked_fill(hidden, torch.nan), sd.masked_fill(hidden, torch.nan), states

    @owning
    def paths(
        self, prepared: Prepared, draws: int
    ) -> tuple[torch.Tensor, tuple[Mapping[str, torch.Tensor], ...]]:
        """Return the observed states, which are taken as exact; see :meth:`Predictor.paths`."""
        exact = prepared.observations.masked_fill(~prepared.mask.unsqueeze(-1), torch.nan)
        return exact.expand(draws, *exact.shape), ({},) * draws

    @owning
    def one_step(self, prepared: Prepared, *, sample: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Encode each frame and decode the next; see :meth:`Predictor.one_step`."""
        absent = ~prepared.mask

        def step(observations: torch.Tensor, adjacency: torch.Tensor) -> tuple[torch.Tensor, ...]:
            posterior = self.guide.encode(observations, adjacency)
            following = self.model.decode(posterior.sample() if sample else posterior.mean)
            states = following.states.sample() if sample else following.states.mean
            return states, following.edge_logits.sigmoid()

        states, edges = _by_chunks(prepared, step)
        alone = absent.unsqueeze(-1) | absent.unsqueeze(-2)
        return (
            states.masked_fill(absent.unsqueeze(-1), torch.nan),
            edges.masked_fill(alone, torch.nan),
        )

    @owning
    def begin(
        self,
        prepared: Prepared,
        trials: torch.Tensor,
        rows: torch.Tensor,
        draws: int,
        *,
        carry: bool = False,
    ) -> InitialCondition:
        """Return the frames as they are: latent states are drawn on the way."""
        if carry:
            own, adjacency, present = extrapolate_missing(
                prepared, self.scaler, self.rule, trials, rows
            )
        else:
            present = prepared.mask[trials, rows]
            adjacency = prepared.adjacency[trials, rows]
            own = torch.from_numpy(prepared.states)[trials, rows]
        absent = ~present.unsqueeze(-1)
        scaled = self.scaler.transform_tensor(own).masked_fill(absent, 0.0).to(torch.float32)
        shape = (draws,) * bool(draws)
        return InitialCondition(
            scaled.expand(*shape, *scaled.shape),
            adjacency.expand(*shape, *adjacency.shape),
            present.expand(*shape, *present.shape),
            own.masked_fill(absent, torch.nan).expand(*shape, *own.shape),
        )

    @owning
    def begin_at(self, states: torch.Tensor, adjacency: torch.Tensor) -> InitialCondition:
        """Return a beginning at given states, all present."""
        scaled = self.scaler.transform_tensor(states).to(torch.float32)
        present = torch.ones(states.shape[:-1], dtype=torch.bool)
        return InitialCondition(scaled, adjacency, present, states)

    @owning
    @torch.no_grad()
    def run(self, beginning: InitialCondition, steps: int, *, sample: bool) -> Trajectory:
        """Go on freely; see :meth:`Predictor.run`.

        With ``sample`` latent states, next states and edges are drawn; else their means, and the
        edges that are more likely than not, are taken.
        """
        states, present = beginning.states, beginning.present
        pairs = present.unsqueeze(-1) & present.unsqueeze(-2)
        pairs = pairs & ~torch.eye(present.shape[-1], dtype=torch.bool, device=present.device)
        gone = ~present.unsqueeze(-1)
        frames, probabilities, graphs = [], [], []
        states = states.masked_fill(gone, 0.0)
        graph = beginning.adjacency.to(states.dtype) * pairs
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


def _by_chunks(
    prepared: Prepared,
    function: Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, ...]],
) -> tuple[torch.Tensor, ...]:
    """Apply a function of frames to all frames, a bounded number at once."""
    observations = prepared.observations.flatten(0, 1)
    adjacency = prepared.adjacency.flatten(0, 1)
    size = max(1, CHUNK // max(1, adjacency.shape[-1] ** 2))
    with torch.no_grad():
        pieces = [
            function(x, a.to(torch.float32))
            for x, a in zip(
                torch.split(observations, size), torch.split(adjacency, size), strict=True
            )
        ]
    shape = prepared.mask.shape[:2]
    columns = zip(*pieces, strict=True)
    return tuple(torch.unflatten(torch.cat(column), 0, shape) for column in columns)
