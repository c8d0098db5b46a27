"""Predictions of a state-space model: filter the history, then let the dynamics run."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import pyro
import torch

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule, dense
from swarmssm.inference.data import Prepared, frames_of
from swarmssm.inference.guides import LinearizedGuide, PathGuide
from swarmssm.inference.guides.base import MEAN_DRAWS
from swarmssm.inference.prediction.base import (
    InitialCondition,
    PredictiveMixture,
    Predictor,
    Trajectory,
    owning,
)
from swarmssm.inference.prediction.over_draws import OverDraws, in_pieces
from swarmssm.inference.starting import MAX_CARRY
from swarmssm.models import InferredEdges, ObservedEdges, StateSpaceModel, StepInputs, SwarmBatch
from swarmssm.models.parameters import priors_of
from swarmssm.tracks.scaling import Scaler

__all__ = ["StateSpacePredictor"]

#: Longest piece of a trial that is smoothed at once, and how far it looks beyond its ends.
PIECE, MARGIN = 500, 50
#: Elements of the largest tensor of one chunk of windows.
CHUNK = 20_000_000

Values = Mapping[str, torch.Tensor]


@dataclass(frozen=True)
class StateSpacePredictor(Predictor):
    """The posterior of the states given the past, and the transition from there.

    The posterior at a frame is the guide's, of the last state of a window of the history that ends
    there: no later frame is looked at.

    Attributes
    ----------
    model, guide
        Fitted. The guide samples ``"states"`` and the parameters.
    scaler, rule
        Of the fit; without a rule a graph that came with the data stays as it was last seen.
    window
        Frames of history from which a state is filtered.
    """

    model: StateSpaceModel
    guide: Callable[[SwarmBatch], Any]
    scaler: Scaler
    rule: GraphRule | None
    window: int

    @owning
    def posterior(
        self, prepared: Prepared, draws: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Smooth whole trials; see :meth:`Predictor.posterior`.

        A trial that is too long for one window is cut into pieces that overlap.
        """
        if self.model.emission.is_exact:
            hidden = ~prepared.mask.unsqueeze(-1)
            exact = prepared.observations.masked_fill(hidden, torch.nan)
            repeated = exact.expand(draws, *exact.shape) if draws else None
            return exact, torch.zeros_like(exact), repeated
        means, sds, states = [], [], []
        for batch, kept in self._pieces(prepared):
            # The parameters of a draw would have to be those of the pieces before: few draws of
            # them are not worth a seam, so each piece draws its own.
            drawn = self._draw(batch, max(draws, MEAN_DRAWS))
            drawn = drawn.masked_fill(~batch.present.unsqueeze(-1), torch.nan)[:, :, kept]
            means.append(drawn.mean(0))
            sds.append(drawn.std(0))
            states.append(drawn[:draws])
        whole = torch.cat(states, 2) if draws else None
        return torch.cat(means, 1), torch.cat(sds, 1), whole

    @owning
    @torch.no_grad()
    def mean_states(self, prepared: Prepared) -> torch.Tensor:
        """Return the mean of whole paths, given all frames, in the middle of the parameters.

        Returns
        -------
        ``(trial, time, individual, state)``, scaled; NaN where nobody is. States that are observed
        exactly are what was observed, and a guide that can only draw is asked for the mean of its
        draws.
        """
        if self.model.emission.is_exact or not isinstance(self.guide, PathGuide):
            return self.posterior(prepared, 0)[0]
        pieces, values = [], self._middle()
        with pyro.validation_enabled(False):
            for batch, kept in self._pieces(prepared):
                mean = self.guide.mean_path(self.guide.with_edges(batch, sample=False), values)
                mean = mean.masked_fill(~batch.present.unsqueeze(-1), torch.nan)
                pieces.append(mean[:, kept])
        return torch.cat(pieces, 1)

    @owning
    @torch.no_grad()
    def paths(self, prepared: Prepared, draws: int) -> tuple[torch.Tensor, tuple[Values, ...]]:
        """Draw parameters, and whole trials with them; see :meth:`Predictor.paths`.

        All pieces of a long trial are drawn with the same parameters; states of different pieces
        are independent given these.
        """
        if self.model.emission.is_exact:
            exact = prepared.observations.masked_fill(~prepared.mask.unsqueeze(-1), torch.nan)
            return exact.expand(draws, *exact.shape), self._draw_parameters(draws) or ({},) * draws
        pieces = []
        with pyro.validation_enabled(False):
            values = self._draw_values(prepared, draws)
            for batch, kept in self._pieces(prepared):
                drawn = self._paths_given(batch, values)
                drawn = drawn.masked_fill(~batch.present.unsqueeze(-1), torch.nan)
                pieces.append(drawn[:, :, kept])
        return torch.cat(pieces, 2), values

    def _draw_values(self, prepared: Prepared, draws: int) -> tuple[Values, ...]:
        """Draw the parameters, by a guide that may know them only along with paths."""
        if not priors_of(self.model):
            return ({},) * draws
        if isinstance(self.guide, PathGuide):
            return tuple(self.guide.parameters_guide() for _ in range(draws))
        batch, _ = next(self._pieces(prepared))
        return tuple(self._trace(batch)[1] for _ in range(draws))

    def _paths_given(self, batch: SwarmBatch, values: tuple[Values, ...]) -> torch.Tensor:
        """Draw a path of each window with each of given parameters."""
        guide = self.guide
        if isinstance(guide, PathGuide):
            if not priors_of(self.model):
                return self._draw(batch, len(values))
            if guide.has_edges:
                return torch.stack([guide.path(guide.with_edges(batch), v)[0] for v in values])
            return guide.paths(batch, values)
        paths = []
        for value in values:
            held = pyro.poutine.condition(guide, data=dict(value))
            paths.append(pyro.poutine.trace(held).get_trace(batch).nodes["states"]["value"])
        return torch.stack(paths)

    @owning
    @torch.no_grad()
    def edge_probabilities(self, prepared: Prepared) -> torch.Tensor:
        """Return the probability of each type of each pair, given all frames.

        Types that are fixed over a window are told by windows one after the other, of the length
        that the fit had.

        Returns
        -------
        ``(trial, time, individual, individual, type)``; NaN where the two are not there.

        Raises
        ------
        InputError
            If the model's edges are not inferred.
        """
        edges, guide = self.model.edges, self.guide
        if not isinstance(edges, InferredEdges) or not isinstance(guide, PathGuide):
            raise InputError(
                "edges: their probabilities are those of inferred edges and a PathGuide; fit with "
                'edges="relational" or "dynamic-relational".'
            )
        found = []
        pieces = self._windows(prepared) if edges.is_static else self._pieces(prepared)
        for batch, kept in pieces:
            law = guide.edges_guide.posterior(batch)
            known = law.mean.masked_fill(~law.pairs.unsqueeze(-1), torch.nan)
            known = known.expand(-1, batch.num_times, -1, -1, -1)
            there = (batch.present.unsqueeze(-1) & batch.present.unsqueeze(-2))[..., None]
            found.append(torch.where(there, known, torch.nan)[:, kept])
        return torch.cat(found, 1)

    def _windows(self, prepared: Prepared) -> Iterator[tuple[SwarmBatch, slice]]:
        """Yield windows of the fit's length over whole trials, and which frames to keep."""
        num_trials, num_times = prepared.mask.shape[:2]
        trials, length = torch.arange(num_trials), min(self.window, num_times)
        for first in range(0, num_times, length):
            # The last window ends with the trial, and so begins within the one before.
            start = min(first, num_times - length)
            yield (
                frames_of(prepared, trials, torch.full_like(trials, start), length),
                slice(first - start, length),
            )

    def _pieces(self, prepared: Prepared) -> Iterator[tuple[SwarmBatch, slice]]:
        """Yield overlapping windows over whole trials, and which of their frames to keep."""
        trials = torch.arange(len(prepared.mask))
        num_times = prepared.mask.shape[1]
        count = max(1, math.ceil((num_times - 2 * MARGIN) / PIECE))
        for index in range(count):
            first = 0 if index == 0 else MARGIN + index * PIECE
            last = num_times if index == count - 1 else MARGIN + (index + 1) * PIECE
            start, stop = max(0, first - MARGIN), min(num_times, last + MARGIN)
            batch = frames_of(prepared, trials, torch.full_like(trials, start), stop - start)
            yield batch, slice(first - start, last - start)

    @owning
    def one_step(self, prepared: Prepared, *, sample: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Filter up to each frame and take one step; see :meth:`Predictor.one_step`."""
        num_trials, num_times, individuals = prepared.mask.shape
        trials = torch.arange(num_trials).repeat_interleave(num_times)
        rows = torch.arange(num_times).repeat(num_trials)
        width = self.model.edges.hidden if isinstance(self.model.edges, InferredEdges) else 1
        size = max(1, CHUNK // (self.window * individuals * max(individuals, 16) * width))
        states, edges = [], []
        for index in torch.split(torch.arange(len(rows)), size):
            start = self.begin(prepared, trials[index], rows[index], int(sample))
            path = self.run(start, 1, sample=sample)
            lead = (0,) if sample else ()
            states.append(path.states[(*lead, slice(None), 0)])
            edges.append(path.edge_probability[(*lead, slice(None), 0)])
        shape = (num_trials, num_times)
        joined = [torch.unflatten(torch.cat(part), 0, shape) for part in (states, edges)]
        return joined[0], joined[1]

    @owning
    @torch.no_grad()
    def begin(
        self,
        prepared: Prepared,
        trials: torch.Tensor,
        rows: torch.Tensor,
        draws: int,
        *,
        carry: bool = False,
    ) -> InitialCondition:
        """Filter the histories that end at given frames; see :meth:`Predictor.begin`."""
        guide = self.guide
        if isinstance(guide, LinearizedGuide) and guide.can_filter(prepared.mask.shape[-1]):
            return self._begin_filtered(guide, prepared, trials, rows, draws, carry)
        batch = self._histories(prepared, trials, rows, carry)
        if isinstance(self.model.edges, InferredEdges):
            return self._begin_with_edges(batch, draws)
        present = batch.present[:, -1]
        graph = dense(batch.adjacency, batch.observations.dtype)[:, -1]
        shape = (draws,) * bool(draws)
        values: tuple[Values, ...] | None = None
        if self.model.emission.is_exact:
            last = batch.observations[:, -1]
            states, values = last.expand(*shape, *last.shape), self._draw_parameters(draws)
        else:
            states, values = self._last_states(batch, draws)
        return self._beginning(states, present, graph, values)

    def _begin_filtered(
        self,
        guide: LinearizedGuide,
        prepared: Prepared,
        trials: torch.Tensor,
        rows: torch.Tensor,
        draws: int,
        carry: bool,
    ) -> InitialCondition:
        """Filter each stretch of a trial once, for all frames in it that are gone on from.

        Each of these has at least :attr:`window` frames of history. Individuals take part in the
        filter from when they are seen until they have been out of sight for so long.
        """
        starts, windows, frames, length = _stretches(trials, rows, self.window)
        batch = frames_of(prepared, *starts, length)
        counted = batch.mask.long().cumsum(1)
        before = torch.nn.functional.pad(counted, (0, 0, self.window, 0))[:, :length]
        batch = replace(batch, present=counted > before)
        named = bool(priors_of(self.model)) and draws > 0
        values: tuple[Values, ...] | None = None
        with pyro.validation_enabled(False):
            if named:
                values = tuple(guide.parameters_guide() for _ in range(draws))
            if draws:
                drawn = values or (self._middle(),) * draws
                states = guide.filtered_states(batch, drawn, windows, frames)
            else:
                states = guide.filtered_mean(batch, self._middle(), windows, frames)
        reach = torch.arange(MAX_CARRY + 1 if carry else 1)
        recent = rows.unsqueeze(-1) - reach
        shown = prepared.mask[trials.unsqueeze(-1), recent.clamp(min=0)]
        present = (shown & (recent >= 0).unsqueeze(-1)).any(1)
        graph = prepared.adjacency[trials, rows].to(states.dtype)
        return self._beginning(states, present, graph, values)

    def _begin_with_edges(self, batch: SwarmBatch, draws: int) -> InitialCondition:
        """Infer edges from histories, and where the swarms are given these."""
        guide = self.guide
        if not isinstance(guide, PathGuide):
            raise InputError("guide: one of inferred edges must be a PathGuide.")
        origins, shape = len(batch), (draws,) * bool(draws)
        values = self._draw_parameters(draws)
        with pyro.validation_enabled(False):
            many, known = guide.edges_guide.draws(batch, draws)
            if self.model.emission.is_exact:
                states = many.observations[:, -1]
            elif not draws:
                states = guide.last_state(many, self._middle(), 0)
            elif values is None:
                states = guide.last_state(many, self._middle(), 1)[0]
            else:
                each = [torch.arange(d * origins, (d + 1) * origins) for d in range(draws)]
                pairs = zip(each, values, strict=True)
                states = torch.cat([guide.last_states(many.select(i), (v,))[0] for i, v in pairs])
        states = states.reshape(*shape, origins, *states.shape[1:])
        graph = dense(many.adjacency)[:, -1].reshape(*states.shape[:-1], states.shape[-2])
        start = self._beginning(states, batch.present[:, -1], graph, values)
        return replace(start, edges=known)

    def _beginning(
        self,
        states: torch.Tensor,
        present: torch.Tensor,
        graph: torch.Tensor,
        values: tuple[Values, ...] | None = None,
    ) -> InitialCondition:
        """Put a beginning together; the graph is made anew where the rule is known."""
        present = present.expand(states.shape[:-1])
        graph = self._graph({}, states, present, graph.expand(*present.shape, present.shape[-1]))
        own = self.scaler.inverse_tensor(states.to(torch.float64))
        own = own.masked_fill(~present.unsqueeze(-1), torch.nan)
        return InitialCondition(states, graph, present, own, values)

    @owning
    def begin_at(self, states: torch.Tensor, adjacency: torch.Tensor) -> InitialCondition:
        """Return a beginning at given states, all present."""
        scaled = self.scaler.transform_tensor(states).to(torch.float32)
        present = torch.ones(states.shape[:-1], dtype=torch.bool)
        return InitialCondition(scaled, adjacency.to(torch.float32), present, states)

    def _histories(
        self, prepared: Prepared, trials: torch.Tensor, rows: torch.Tensor, carry: bool
    ) -> SwarmBatch:
        """Return windows that end at given frames.

        With ``carry``, who was seen at most :data:`MAX_CARRY` frames before the end is there.
        """
        exact = self.model.emission.is_exact and not isinstance(self.model.edges, InferredEdges)
        length = 1 if exact else self.window
        batch = frames_of(prepared, trials, rows - (length - 1), length)
        reach = MAX_CARRY + 1 if carry else 1
        recent = batch.mask[:, -reach:].any(1, keepdim=True)
        come = batch.mask.long().cumsum(1) > 0
        return replace(batch, present=come & recent)

    def _draw(self, batch: SwarmBatch, draws: int) -> torch.Tensor:
        """Draw paths ``(draw, batch, time, individual, state)``."""
        with torch.no_grad(), pyro.validation_enabled(False):
            if isinstance(self.guide, PathGuide) and not priors_of(self.model):
                many = batch.select(torch.arange(len(batch)).repeat(draws))
                path, _ = self.guide.path(self.guide.with_edges(many), {})
                return torch.unflatten(path, 0, (draws, len(batch)))
            return torch.stack([self._trace(batch)[0] for _ in range(draws)])

    def _trace(self, batch: SwarmBatch) -> tuple[torch.Tensor, Values]:
        """Draw one path of each window, and the parameters it goes with."""
        nodes = pyro.poutine.trace(self.guide).get_trace(batch).nodes
        return nodes["states"]["value"], {n: nodes[n]["value"] for n in priors_of(self.model)}

    def _last_states(
        self, batch: SwarmBatch, draws: int
    ) -> tuple[torch.Tensor, tuple[Values, ...] | None]:
        """Draw the state of the last frame, with the parameters it goes with; or its mean."""
        named = bool(priors_of(self.model))
        with pyro.validation_enabled(False):
            if not isinstance(self.guide, PathGuide):
                traces = [self._trace(batch) for _ in range(draws or MEAN_DRAWS)]
                states = torch.stack([path[:, -1] for path, _ in traces])
                if not draws:
                    return states.mean(0), None
                return states, tuple(values for _, values in traces) if named else None
            if not (draws and named):
                return self.guide.last_state(batch, self._middle(), draws), None
            parameters = tuple(self.guide.parameters_guide() for _ in range(draws))
            return self.guide.last_states(batch, parameters), parameters

    def _draw_parameters(self, draws: int) -> tuple[Values, ...] | None:
        """Draw the parameters alone, where states are known."""
        names = priors_of(self.model)
        if not names or not draws:
            return None
        if isinstance(self.guide, PathGuide):
            return tuple(self.guide.parameters_guide() for _ in range(draws))
        raise InputError("guide: one of exactly observed states must be a PathGuide.")

    def _middle(self) -> Values:
        """Return the parameters in the middle of their posterior."""
        return self.guide.parameters_guide.median() if isinstance(self.guide, PathGuide) else {}

    @owning
    @torch.no_grad()
    def run(self, beginning: InitialCondition, steps: int, *, sample: bool) -> Trajectory:
        """Let the transition run; see :meth:`Predictor.run`.

        Later graphs are those of the model's own edges, or made by the rule from the states.
        """
        if isinstance(self.model.edges, InferredEdges):
            return self._run_with_edges(beginning, steps, sample)
        gone = ~beginning.present.unsqueeze(-1)
        states = beginning.states.masked_fill(gone, 0.0)
        graph = beginning.adjacency.to(states.dtype)
        advance = self._with_parameters(beginning, partial(self._advance, sample=sample))
        connect = self._connect(beginning)
        frames, graphs = [], []
        for _ in range(steps):
            states = advance(states, graph, beginning.present).masked_fill(gone, 0.0)
            graph = connect(states, beginning.present, graph)
            frames.append(states.masked_fill(gone, torch.nan))
            graphs.append(graph)
        adjacency = torch.stack(graphs, dim=-3)
        return Trajectory(torch.stack(frames, dim=-3), adjacency, adjacency.bool())

    def _run_with_edges(self, beginning: InitialCondition, steps: int, sample: bool) -> Trajectory:
        """Run on edges whose types are inferred, and change as the swarm goes on."""
        if beginning.parameters is None:
            return self._walk(beginning, self._middle(), steps, sample)
        parts = [
            self._walk(_one_draw(beginning, draw), values, steps, sample)
            for draw, values in enumerate(beginning.parameters)
        ]
        names = ("states", "edge_probability", "adjacency", "edge_types")
        return Trajectory(*(torch.stack([getattr(part, n) for part in parts]) for n in names))

    def _walk(
        self, start: InitialCondition, values: Values, steps: int, sample: bool
    ) -> Trajectory:
        """Run on inferred edges with given parameters."""
        edges = self.model.edges
        assert isinstance(edges, InferredEdges)
        gone = ~start.present.unsqueeze(-1)
        states = start.states.masked_fill(gone, 0.0)
        inputs = StepInputs(None, None, start.present)
        frames, probabilities, types = [], [], []
        with self.model.fixed(values), pyro.validation_enabled(False):
            walk = edges.walk(start.edges, sample=sample)
            if start.edges is None:
                walk.advance(states, start.present)
            for _ in range(steps):
                types.append(walk.types)
                following = self.model.transition(states, walk.here(inputs))
                moved = following.sample() if sample else following.mean
                states = moved.masked_fill(gone, 0.0)
                walk.advance(states, start.present)
                frames.append(states.masked_fill(gone, torch.nan))
                probabilities.append(edges.interacting(walk.types))
        probability = torch.stack(probabilities, dim=-3)
        return Trajectory(
            torch.stack(frames, dim=-3), probability, probability > 0.5, torch.stack(types, dim=-4)
        )

    @owning
    @torch.no_grad()
    def kernels(self, beginning: InitialCondition, steps: int) -> PredictiveMixture:
        """Draw futures, and return what each expects; see :meth:`Predictor.kernels`."""
        path = self.run(beginning, steps, sample=True)
        before = torch.cat([beginning.states.unsqueeze(-3), path.states[..., :-1, :, :]], dim=-3)
        first = beginning.adjacency.to(path.edge_probability.dtype).unsqueeze(-3)
        graph = torch.cat([first, path.edge_probability[..., :-1, :, :]], dim=-3)
        present = beginning.present.unsqueeze(-2).expand(before.shape[:-1])
        gone = ~present.unsqueeze(-1)
        tensors = [before.masked_fill(gone, 0.0), graph, present]
        if path.edge_types is not None:
            tensors.append(path.edge_types)
        if beginning.parameters is None:
            found = in_pieces(partial(self._foresee, self._middle()), tensors)
        else:
            found = OverDraws(self._foresee, beginning.parameters)(*tensors)
        location, variance, degrees = found
        return PredictiveMixture(
            location.masked_fill(gone, torch.nan), variance, float(degrees.min())
        )

    def _with_parameters(
        self, beginning: InitialCondition, function: Callable[..., Any]
    ) -> Callable[..., Any]:
        """Return a function of tensors alone: the parameters are those that a beginning has."""
        if beginning.parameters is None:
            return partial(function, self._middle())
        return OverDraws(function, beginning.parameters)

    def _advance(
        self,
        values: Values,
        states: torch.Tensor,
        graph: torch.Tensor,
        present: torch.Tensor,
        *,
        sample: bool,
    ) -> torch.Tensor:
        """Return the next states, drawn or expected, with given parameters."""
        with self.model.fixed(values), pyro.validation_enabled(False):
            following = self.model.step(states, StepInputs(graph, None, present))
            moved: torch.Tensor = following.sample() if sample else following.mean
        return moved

    def _foresee(
        self,
        values: Values,
        states: torch.Tensor,
        graph: torch.Tensor,
        present: torch.Tensor,
        types: torch.Tensor | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return mean and variance of the position seen after a step, and degrees of freedom."""
        space = states.shape[-1] // 2
        with self.model.fixed(values), pyro.validation_enabled(False):
            following = self.model.step(states, StepInputs(graph, None, present, types))
            location, variance = following.mean[..., :space], following.variance[..., :space]
            if not self.model.emission.is_exact:
                variance = variance + self.model.emission(following.mean).variance[..., :space]
        inner = getattr(following, "velocity", following)
        inner = getattr(inner, "base_dist", inner)
        degrees = getattr(inner, "degrees", getattr(inner, "df", None))
        if degrees is None:
            degrees = states.new_tensor(math.inf)
        return location, variance.expand(location.shape), degrees.min().reshape(1)

    def _connect(self, beginning: InitialCondition) -> Callable[..., torch.Tensor]:
        """Return a function that makes the graph of states, see :meth:`_graph`."""
        if any(name.startswith("edges.") for name in priors_of(self.model)):
            return self._with_parameters(beginning, self._graph)
        # All draws are one batch, whatever the rule is made of.
        return partial(self._graph, {})

    def _graph(
        self, values: Values, states: torch.Tensor, present: torch.Tensor, graph: torch.Tensor
    ) -> torch.Tensor:
        """Return the graph of states; the one before where no rule is known."""
        if not isinstance(self.model.edges, ObservedEdges):
            with self.model.fixed(values), pyro.validation_enabled(False):
                own = self.model.edges(states, StepInputs(graph, None, present))
            if isinstance(own, torch.Tensor):
                return own.to(states.dtype)
        if self.rule is None:
            return graph
        positions, velocities = self.scaler.inverse_tensor(states).chunk(2, dim=-1)
        seen = positions.masked_fill(~present.unsqueeze(-1), torch.nan)
        return self.rule(seen, velocities).to(states.dtype)


def _one_draw(beginning: InitialCondition, draw: int) -> InitialCondition:
    """Return the part of a beginning that belongs to one draw."""
    return InitialCondition(
        beginning.states[draw],
        beginning.adjacency[draw],
        beginning.present[draw],
        beginning.unscaled[draw],
        edges=None if beginning.edges is None else beginning.edges[draw],
    )


def _stretches(
    trials: torch.Tensor, rows: torch.Tensor, window: int
) -> tuple[tuple[torch.Tensor, torch.Tensor], torch.Tensor, torch.Tensor, int]:
    """Return windows that hold some frames with at least ``window`` frames up to each.

    Returns
    -------
    Trial and first row of each window; window and frame of each given row; the windows' length.
    """
    order = sorted(range(len(rows)), key=lambda i: (int(trials[i]), int(rows[i])))
    groups: list[list[int]] = []
    for index in order:
        same = groups and trials[groups[-1][0]] == trials[index]
        if same and rows[index] - rows[groups[-1][0]] < window:
            groups[-1].append(index)
        else:
            groups.append([index])
    longest = max(int(rows[group[-1]] - rows[group[0]]) for group in groups)
    length = window + longest
    last = torch.stack([rows[group[-1]] for group in groups])
    starts = last - (length - 1)
    windows = torch.empty_like(rows)
    for number, group in enumerate(groups):
        windows[group] = number
    which = torch.stack([trials[group[0]] for group in groups])
    return (which, starts), windows, rows - starts[windows], length
