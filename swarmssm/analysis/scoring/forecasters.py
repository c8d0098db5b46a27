"""One face for all that are compared: the fitted model, the baselines, the true rule."""

import contextlib
import json
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch

from swarmssm import simulate
from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.analysis.scoring.baseline_errors import baseline_covariances
from swarmssm.analysis.scoring.subject import Subject
from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import GraphRule
from swarmssm.inference.prediction import seeded
from swarmssm.metrics.masked import known
from swarmssm.simulate import Law
from swarmssm.tracks import Array

__all__ = ["BaselineForecaster", "Forecaster", "LawForecaster", "ModelForecaster", "law_forecaster"]

Rows = npt.NDArray[np.int64]
#: Numbers of the largest tensor of one batch of forecasts.
CHUNK = 20_000_000


class Forecaster(Protocol):
    """States are in the tracks' own units; an individual absent at the start stays NaN."""

    name: str
    title: str

    def one_step(self) -> tuple[Array, Array | None]:
        """Predict each frame of the subject from those before it.

        Returns
        -------
        States ``(trial, time, individual, state)`` and edge scores ``(trial, time, individual,
        neighbor)`` from 0 to 1, or ``None`` if it says nothing of edges.
        """

    def forecasts(self, trials: Rows, rows: Rows, steps: int) -> Array | None:
        """Return expected futures ``(origin, step, individual, state)`` of the given frames.

        ``None`` if it cannot go on from all of them.
        """

    def free_runs(
        self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int
    ) -> Array | None:
        """Return futures as they may come, ``(draw, origin, step, individual, state)``."""

    def positions(
        self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int
    ) -> Array | None:
        """Return positions as they may be seen, tracking noise included, in the same order."""

    def spread(self, states: Array, steps: int) -> Array | None:
        """Return the covariances ``(step, space, space)`` of normals about what it expects.

        Of a forecaster without noise of its own, from its errors on ``(trial, time, individual,
        state)``; ``None`` from one that draws.
        """


class ModelForecaster:
    """The fitted model: at its posterior mean, or drawn."""

    def __init__(self, subject: Subject, edges: str) -> None:
        self.name = self.title = subject.fit.settings.model
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
        edges = predictive["edge_probability"].to_numpy()
        return diverged(states, seen), edges

    def forecasts(self, trials: Rows, rows: Rows, steps: int) -> Array:
        """Run the rule at its means, one future an origin."""
        return self._run(trials, rows, steps, draws=0)

    def free_runs(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array:
        """Run the rule with everything drawn."""
        with seeded(seed):
            return self._run(trials, rows, steps, draws=draws)

    def kernels(
        self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int
    ) -> tuple[Array, Array, float] | None:
        """Return where sampled futures expect the next sighting, and how surely.

        In the tracks' own units, see :class:`swarmssm.inference.prediction.PredictiveMixture`.
        """
        at = torch.from_numpy(trials), torch.from_numpy(rows)
        with seeded(seed):
            beginning = self.predictor.begin(self.subject.inputs, *at, draws)
            found = self.predictor.kernels(beginning, steps)
        if found is None:
            return None
        space = self.subject.num_space
        scaler = self.subject.fit.preparation.scaler
        offset, scale = np.array(scaler.offset[:space]), np.array(scaler.scale[:space])
        location = found.location.numpy().astype(np.float64) * scale + offset
        variance = found.variance.numpy().astype(np.float64) * scale**2
        there = np.broadcast_to(beginning.present.numpy()[..., None, :], location.shape[:-1])
        return diverged(location, there), variance, found.degrees

    def positions(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array:
        """Run the rule; it is fitted to the tracks as they are, their noise included."""
        return self.free_runs(trials, rows, steps, draws, seed)[..., : self.subject.num_space]

    def spread(self, states: Array, steps: int) -> None:
        """Return nothing: it draws."""

    def _run(self, trials: Rows, rows: Rows, steps: int, *, draws: int) -> Array:
        """Run from frames of the subject, a bounded number at once."""
        inputs = self.subject.inputs
        size = max(1, CHUNK // (max(draws, 1) * steps * inputs.mask.shape[-1] ** 2))
        pieces = []
        for first in range(0, len(rows), size):
            chosen = slice(first, first + size)
            beginning = self.predictor.begin(
                inputs, torch.from_numpy(trials[chosen]), torch.from_numpy(rows[chosen]), draws
            )
            path = self.predictor.run(beginning, steps, sample=bool(draws))
            scaler = self.subject.fit.preparation.scaler
            states = scaler.inverse(path.states.numpy().astype(np.float64))
            there = np.broadcast_to(beginning.present.numpy()[..., None, :], states.shape[:-1])
            pieces.append(diverged(states, there))
        return np.concatenate(pieces, axis=-4)


class BaselineForecaster:
    """A baseline; its futures are the expected ones, also where others draw theirs."""

    def __init__(self, subject: Subject, baseline: Baseline) -> None:
        self.name, self.title = baseline.name, baseline.title
        self.subject, self.baseline = subject, baseline
        known = subject.inputs.known.numpy()[..., None]
        self.known = np.where(known, subject.inputs.states, np.nan)

    def one_step(self) -> tuple[Array, Array | None]:
        """Predict each frame; the graph is the one before, or that of the predicted states."""
        states = self.baseline.one_step(self.known, self.subject.fps)
        if self.name == "stay-put":
            return states, np.where(
                _both_known(self.known), _delayed(self.subject.inputs.adjacency.numpy()), np.nan
            )
        return states, rule_graph(self.subject.fit.preparation.rule, states)

    def forecasts(self, trials: Rows, rows: Rows, steps: int) -> Array:
        """Go on from the given frames."""
        back = np.arange(1 - self.baseline.order, 1)
        first = rows[:, None] + back
        history = self.known[trials[:, None], np.maximum(first, 0)]
        history[first < 0] = np.nan
        return self.baseline.predict(history, steps, self.subject.fps)

    def free_runs(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array:
        """Go on without noise: one draw."""
        return self.forecasts(trials, rows, steps)[None]

    def positions(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> None:
        """Return nothing: a baseline has no noise of its own."""

    def spread(self, states: Array, steps: int) -> Array:
        """Measure its errors."""
        return baseline_covariances(self.baseline, states, steps, self.subject.fps)


class LawForecaster:
    """The law that simulated the tracks: nobody can do better than its noise allows.

    It goes on only from frames in which everybody's state is known, since anybody may be seen.
    """

    name, title = "noise-floor", "true rule (noise floor)"

    def __init__(self, subject: Subject, law: Law) -> None:
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
        if _differences(self.subject):
            # What will be seen is a difference of seen positions; the last of them is known.
            velocity = (following - inputs.states[..., : following.shape[-1]]) * self.subject.fps
        else:
            velocity = tracks["next_velocity"].transpose(*order).to_numpy()
        states = np.concatenate([following, velocity], axis=-1)
        predicted = np.full_like(states, np.nan)
        predicted[:, 1:] = np.where(inputs.known.numpy()[..., None], states, np.nan)[:, :-1]
        return predicted, rule_graph(self.subject.fit.preparation.rule, predicted)

    def forecasts(self, trials: Rows, rows: Rows, steps: int) -> Array | None:
        """Run the law without noise."""
        return self._run(trials, rows, steps, None)

    def free_runs(
        self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int
    ) -> Array | None:
        """Run the law with fresh noise."""
        generator = torch.Generator().manual_seed(seed)
        flat = self._run(np.tile(trials, draws), np.tile(rows, draws), steps, generator)
        return None if flat is None else flat.reshape(draws, len(rows), *flat.shape[1:])

    def positions(
        self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int
    ) -> Array | None:
        """Run the law with fresh noise, and add that of tracking."""
        runs = self.free_runs(trials, rows, steps, draws, seed)
        if runs is None:
            return None
        parameters = json.loads(self.subject.tracks.attrs["simulation"])
        noise = float(parameters.get("observation_noise", 0.0))
        drawn = np.random.default_rng(seed).normal(size=(*runs.shape[:-1], self.subject.num_space))
        positions: Array = runs[..., : self.subject.num_space] + noise * drawn
        return positions

    def spread(self, states: Array, steps: int) -> None:
        """Return nothing: it draws."""

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


def law_forecaster(subject: Subject) -> tuple[LawForecaster | None, str]:
    """Return the true rule of simulated tracks, or the reason why there is none."""
    if not {"next_position", "next_velocity"} <= set(subject.tracks.data_vars):
        return None, "The tracks do not carry the true next state: the noise floor is unknown."
    if subject.fit.settings.velocity == "kalman":
        return None, "The velocities are smoothed: their noise floor is unknown."
    with contextlib.suppress(InputError):
        return LawForecaster(subject, simulate.law_of(subject.tracks)), ""
    return None, "The law of the tracks cannot be read: the noise floor is unknown."


def _differences(subject: Subject) -> bool:
    """Return whether the velocities are differences of the seen positions."""
    return subject.fit.settings.velocity == "difference" or "velocity" not in subject.tracks


def rule_graph(rule: GraphRule | None, states: Array) -> Array | None:
    """Return the graph that a rule makes of predicted states: 0, 1, and NaN where unknown."""
    if rule is None:
        return None
    position, velocity = np.split(states, 2, axis=-1)
    with contextlib.suppress(InputError, WorkError):
        graph: Any = rule(torch.from_numpy(position), torch.from_numpy(velocity))
        there = known(states)
        pairs = there[..., :, None] & there[..., None, :]
        return np.where(pairs, graph.numpy().astype(np.float64), np.nan)
    return None


def diverged(states: Array, present: npt.NDArray[np.bool_]) -> Array:
    """Return states with infinity where a forecast of somebody present broke down.

    Left as NaN it would not count, and who breaks down would be scored on the rest.
    """
    broken = present[..., None] & np.isnan(states)
    return np.where(broken, np.inf, states)


def _delayed(graph: npt.NDArray[np.bool_]) -> Array:
    """Shift graphs to the frame after, the first frame NaN."""
    out = np.full(graph.shape, np.nan)
    out[:, 1:] = graph[:, :-1]
    return out


def _both_known(states: Array) -> npt.NDArray[np.bool_]:
    """Return the pairs that were known in the frame before."""
    there = known(states)
    before = np.zeros_like(there)
    before[:, 1:] = there[:, :-1]
    pairs: npt.NDArray[np.bool_] = before[..., :, None] & before[..., None, :]
    return pairs
