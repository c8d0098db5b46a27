"""One protocol for all that are scored: fitted models, baselines, the true dynamics."""

import contextlib
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch

from swarmssm import simulate
from swarmssm.analysis.posterior.subject import ScoredTracks, Subject
from swarmssm.analysis.scoring.baseline import Baseline, histories
from swarmssm.analysis.scoring.densities import (
    Density,
    DrawnDensity,
    NormalDensity,
    drawn_from_mixture,
)
from swarmssm.analysis.scoring.references import StayPut
from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import GraphRule
from swarmssm.inference.prediction import seeded
from swarmssm.metrics.masked import known
from swarmssm.simulate import Dynamics
from swarmssm.tracks import Array

__all__ = [
    "BaselineForecaster",
    "FitForecaster",
    "Forecaster",
    "LawForecaster",
    "baseline_forecaster",
    "diverged",
    "law_forecaster",
]

Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
#: Numbers of the largest tensor of one batch of a model's forecasts, and of a baseline's histories.
CHUNK = 20_000_000
HISTORIES = 10_000_000


class Forecaster(Protocol):
    """What forecasts scored tracks.

    States are in the tracks' own units; an individual absent at the start stays NaN, one whose
    forecast diverged is infinite. What cannot go on from all of the given frames returns ``None``.

    Attributes
    ----------
    name, title
        For tables.
    """

    name: str
    title: str

    def one_step(self) -> tuple[Array, Array | None]:
        """Predict each frame from those before it.

        Returns
        -------
        States ``(trial, time, individual, state)`` and edge scores ``(trial, time, individual,
        neighbor)`` from 0 to 1, or ``None`` if it says nothing of edges.
        """

    def expected(self, trials: Rows, rows: Rows, steps: int) -> Array | None:
        """Return expected futures ``(origin, step, individual, state)`` of the given frames."""

    def simulate(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array | None:
        """Return drawn futures, ``(draw, origin, step, individual, state)``.

        Of a forecaster without noise of its own, its expected future as the only draw.
        """

    def density(
        self, trials: Rows, rows: Rows, steps: Sequence[int], draws: int, seed: int, batch: int = 0
    ) -> Density | None:
        """Return densities of positions, tracking noise included, some steps ahead.

        ``batch`` is the number of the batch of origins, which draw noise of their own.
        """


class FitForecaster:
    """A fitted model: at its posterior mean, or drawn."""

    def __init__(self, subject: Subject, edges: str = "decoder", name: str | None = None) -> None:
        self.name = self.title = name or subject.fit.settings.model
        self.subject, self.predictor = subject, subject.fit.predictor(edges)

    def one_step(self) -> tuple[Array, Array | None]:
        """Predict at the posterior mean."""
        predictive = self.subject.fit.predictive(self.subject.tracks)
        order = ("trial", "time", "individual", "space")
        states = np.concatenate(
            [predictive[name].transpose(*order).to_numpy() for name in ("position", "velocity")],
            axis=-1,
        )
        seen = np.zeros(states.shape[:-1], dtype=bool)
        seen[:, 1:] = self.subject.inputs.mask.numpy()[:, :-1]
        return diverged(states, seen), predictive["edge_probability"].to_numpy()

    def expected(self, trials: Rows, rows: Rows, steps: int) -> Array:
        """Follow the transition's means, one future an origin."""
        return self._run(trials, rows, steps, draws=0)

    def simulate(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array:
        """Draw parameters, states and steps."""
        with seeded(seed):
            return self._run(trials, rows, steps, draws=draws)

    def density(
        self, trials: Rows, rows: Rows, steps: Sequence[int], draws: int, seed: int, batch: int = 0
    ) -> DrawnDensity:
        """Return the mixture of what drawn futures expect of each next observation.

        Of a model that does not provide it, the drawn positions themselves: it is fitted to the
        tracks as they are, their noise included.
        """
        chosen, longest = np.asarray(steps) - 1, max(steps)
        mixture = self._mixture(trials, rows, longest, draws, seed)
        if mixture is None:
            runs = self.simulate(trials, rows, longest, draws, seed)
            return DrawnDensity(runs[:, :, chosen, :, : self.subject.num_space])
        observed = drawn_from_mixture(*mixture, np.random.default_rng((seed, batch)))
        location, variance, degrees = mixture
        return DrawnDensity(
            observed[:, :, chosen], (location[:, :, chosen], variance[:, :, chosen], degrees)
        )

    def _mixture(
        self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int
    ) -> tuple[Array, Array, float] | None:
        """Return location, variance and degrees of freedom in the tracks' own units.

        See :class:`swarmssm.inference.prediction.PredictiveMixture`.
        """
        at = torch.from_numpy(trials), torch.from_numpy(rows)
        with seeded(seed):
            start = self.predictor.begin(self.subject.inputs, *at, draws)
            found = self.predictor.kernels(start, steps)
        if found is None:
            return None
        space = self.subject.num_space
        scaler = self.subject.fit.preparation.scaler
        offset, scale = np.array(scaler.offset[:space]), np.array(scaler.scale[:space])
        location = found.location.numpy().astype(np.float64) * scale + offset
        variance = found.variance.numpy().astype(np.float64) * scale**2
        present = np.broadcast_to(start.present.numpy()[..., None, :], location.shape[:-1])
        return diverged(location, present), variance, found.degrees

    def _run(self, trials: Rows, rows: Rows, steps: int, *, draws: int) -> Array:
        """Run from frames of the subject, a bounded number at once."""
        inputs = self.subject.inputs
        size = max(1, CHUNK // (max(draws, 1) * steps * inputs.mask.shape[-1] ** 2))
        pieces = []
        for first in range(0, len(rows), size):
            chosen = slice(first, first + size)
            start = self.predictor.begin(
                inputs, torch.from_numpy(trials[chosen]), torch.from_numpy(rows[chosen]), draws
            )
            path = self.predictor.run(start, steps, sample=bool(draws))
            scaler = self.subject.fit.preparation.scaler
            states = scaler.inverse(path.states.numpy().astype(np.float64))
            present = np.broadcast_to(start.present.numpy()[..., None, :], states.shape[:-1])
            pieces.append(diverged(states, present))
        return np.concatenate(pieces, axis=-4)


class BaselineForecaster:
    """A baseline, with errors as large as those it makes.

    Its density is a normal about what it expects, with the covariance of its errors at that step in
    the training part, else in the scored frames. A fitted one draws free runs, with an error like
    its one-step errors at each step.

    Parameters
    ----------
    baseline
        The baseline.
    scored
        What is scored.
    states
        What it may know, ``(trial, time, individual, state)``; absent, the scored states.
    rule, adjacency
        Graph rule, and true graphs, from which the next graph is predicted; absent, none is.
    """

    def __init__(
        self,
        baseline: Baseline,
        scored: ScoredTracks,
        states: Array | None = None,
        *,
        rule: GraphRule | None = None,
        adjacency: Mask | None = None,
    ) -> None:
        self.name, self.title = baseline.name, baseline.title
        self.baseline, self.scored = baseline, scored
        self.states = scored.states if states is None else states
        self.rule, self.adjacency = rule, adjacency
        self._spread = np.empty((0, 0, 0))

    def one_step(self) -> tuple[Array, Array | None]:
        """Predict each frame; the graph is the one before, or that of the predicted states."""
        states = self.baseline.one_step(self.states, self.scored.fps)
        if isinstance(self.baseline, StayPut) and self.adjacency is not None:
            before = np.full(self.adjacency.shape, np.nan)
            before[:, 1:] = np.where(_pairs(self.states), self.adjacency, np.nan)[:, :-1]
            return states, before
        return states, rule_graph(self.rule, states)

    def expected(self, trials: Rows, rows: Rows, steps: int) -> Array:
        """Go on from the given frames."""
        return self._run(trials, rows, steps, None)

    def simulate(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array:
        """Draw an error at each step; of a baseline that was not fitted, expect."""
        if self.baseline.residual_covariance is None:
            return self.expected(trials, rows, steps)[None]
        generator = np.random.default_rng(seed)
        return np.stack([self._run(trials, rows, steps, generator) for _ in range(draws)])

    def density(
        self, trials: Rows, rows: Rows, steps: Sequence[int], draws: int, seed: int, batch: int = 0
    ) -> NormalDensity:
        """Return normals about what is expected."""
        chosen, longest = np.asarray(steps) - 1, max(steps)
        if len(self._spread) != longest:
            training = self.scored.training
            source = self.scored.states if training is None else training
            self._spread = self.baseline.error_covariances(source, longest, self.scored.fps)
        mean = self.expected(trials, rows, longest)[:, chosen, :, : self.scored.num_space]
        return NormalDensity(mean, self._spread[chosen, None])

    def _run(
        self, trials: Rows, rows: Rows, steps: int, generator: np.random.Generator | None
    ) -> Array:
        """Go on from histories, a bounded number at once."""
        order = max(self.baseline.order, 1)
        size = max(1, HISTORIES // (order * int(np.prod(self.states.shape[2:]))))
        pieces = []
        for first in range(0, len(rows), size):
            chosen = slice(first, first + size)
            history = histories(self.states, trials[chosen], rows[chosen], order)
            path = self.baseline.predict(history, steps, self.scored.fps, generator)
            pieces.append(diverged(path, known(history[:, -1])[:, None]))
        return np.concatenate(pieces)


class LawForecaster:
    """The dynamics that simulated the tracks: no model does better than their noise allows.

    They go on only from frames in which everybody's state is known, since anybody may be seen.
    """

    name, title = "noise-floor", "true rule (noise floor)"

    def __init__(self, subject: Subject, law: Dynamics) -> None:
        self.subject, self.law = subject, law
        tracks, inputs = subject.tracks, subject.inputs
        order = ("trial", "time", "individual", "space")
        self.position, self.velocity = np.split(inputs.states, 2, axis=-1)
        if "true_position" in tracks:
            self.position = tracks["true_position"].transpose(*order).to_numpy()
            self.velocity = tracks["true_velocity"].transpose(*order).to_numpy()
        # Nobody's step is known while one whom others may see is not.
        self.whole = np.logical_and.reduce(
            known(self.position) & known(self.velocity) & inputs.known.numpy(), axis=-1
        )

    def one_step(self) -> tuple[Array, Array | None]:
        """Return the noise-free next state, and the graph that the rule makes of it."""
        tracks, inputs = self.subject.tracks, self.subject.inputs
        order = ("trial", "time", "individual", "space")
        following = tracks["next_position"].transpose(*order).to_numpy()
        if self.subject.fit.settings.velocity == "difference" or "velocity" not in tracks:
            # What will be observed is a difference of observed positions; the last is known.
            velocity = (following - inputs.states[..., : following.shape[-1]]) * self.subject.fps
        else:
            velocity = tracks["next_velocity"].transpose(*order).to_numpy()
        states = np.concatenate([following, velocity], axis=-1)
        predicted = np.full_like(states, np.nan)
        predicted[:, 1:] = np.where(inputs.known.numpy()[..., None], states, np.nan)[:, :-1]
        return predicted, rule_graph(self.subject.fit.preparation.rule, predicted)

    def expected(self, trials: Rows, rows: Rows, steps: int) -> Array | None:
        """Run the law without noise."""
        return self._run(trials, rows, steps, None)

    def simulate(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array | None:
        """Run the law with fresh noise."""
        generator = torch.Generator().manual_seed(seed)
        flat = self._run(np.tile(trials, draws), np.tile(rows, draws), steps, generator)
        return None if flat is None else flat.reshape(draws, len(rows), *flat.shape[1:])

    def density(
        self, trials: Rows, rows: Rows, steps: Sequence[int], draws: int, seed: int, batch: int = 0
    ) -> DrawnDensity | None:
        """Run the law with fresh noise, and add that of tracking."""
        runs = self.simulate(trials, rows, max(steps), draws, seed)
        if runs is None:
            return None
        runs = runs[..., : self.subject.num_space]
        parameters = json.loads(self.subject.tracks.attrs["simulation"])
        noise = float(parameters.get("observation_noise", 0.0))
        drawn: Array = runs + noise * np.random.default_rng(seed).normal(size=runs.shape)
        return DrawnDensity(drawn[:, :, np.asarray(steps) - 1])

    def _run(
        self, trials: Rows, rows: Rows, steps: int, generator: torch.Generator | None
    ) -> Array | None:
        """Go on from true states."""
        if not self.whole[trials, rows].all():
            return None
        positions = torch.from_numpy(self.position[trials, rows])
        velocities = torch.from_numpy(self.velocity[trials, rows])
        path = []
        for _ in range(steps):
            force, _ = self.law.forces(positions, velocities)
            positions, velocities = self.law.move(positions, velocities, force, generator)
            path.append(torch.cat([positions, velocities], dim=-1))
        return torch.stack(path, dim=1).numpy()


def baseline_forecaster(
    baseline: Baseline, subject: Subject, training: Array | None
) -> BaselineForecaster:
    """Return a baseline that knows what a fit knows, and predicts graphs by the fit's rule.

    Its errors are measured on states of the training part, if these are given.
    """
    inputs = subject.inputs
    return BaselineForecaster(
        baseline,
        replace(subject, training=training),
        np.where(inputs.known.numpy()[..., None], inputs.states, np.nan),
        rule=subject.fit.preparation.rule,
        adjacency=inputs.adjacency.numpy(),
    )


def law_forecaster(subject: Subject) -> tuple[LawForecaster | None, str]:
    """Return the dynamics of simulated tracks, or the reason why there are none."""
    if not {"next_position", "next_velocity"} <= set(subject.tracks.data_vars):
        return None, "The tracks do not carry the true next state: the noise floor is unknown."
    if subject.fit.settings.velocity == "kalman":
        return None, "The velocities are smoothed: their noise floor is unknown."
    with contextlib.suppress(InputError):
        return LawForecaster(subject, simulate.dynamics_of(subject.tracks)), ""
    return None, "The law of the tracks cannot be read: the noise floor is unknown."


def rule_graph(rule: GraphRule | None, states: Array) -> Array | None:
    """Return the graph that a rule makes of predicted states: 0, 1, and NaN where unknown."""
    if rule is None:
        return None
    position, velocity = np.split(states, 2, axis=-1)
    with contextlib.suppress(InputError, WorkError):
        graph: Any = rule(torch.from_numpy(position), torch.from_numpy(velocity))
        return np.where(_pairs(states), graph.numpy().astype(np.float64), np.nan)
    return None


def diverged(states: Array, present: Mask) -> Array:
    """Return states with infinity where a forecast of somebody present is not a number.

    Left as NaN it would not count, and who diverges would be scored on the rest.
    """
    return np.where(present[..., None] & np.isnan(states), np.inf, states)


def _pairs(states: Array) -> Mask:
    """Return the pairs of which both are known."""
    here = known(states)
    pairs: Mask = here[..., :, None] & here[..., None, :]
    return pairs
