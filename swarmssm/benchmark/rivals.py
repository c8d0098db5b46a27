"""Baselines as forecasters of a task."""

from typing import Any

import numpy as np
import numpy.typing as npt

from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.analysis.scoring.baseline_errors import baseline_covariances
from swarmssm.benchmark.task import HISTORY, Task
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["RivalForecaster"]

Rows = npt.NDArray[np.int64]
#: Numbers in the histories of one batch of forecasts.
CHUNK = 10_000_000


class RivalForecaster:
    """A fitted baseline, see :class:`swarmssm.analysis.scoring.forecasters.Forecaster`.

    Its density of a position to come is a normal about what it expects, with the covariance of its
    own errors at that horizon in the validation part; its free runs draw an error like its
    one-step errors at each step.
    """

    def __init__(self, task: Task, baseline: Baseline) -> None:
        self.name, self.title = baseline.name, baseline.title
        self.task, self.baseline = task, baseline

    def one_step(self) -> tuple[Array, Array | None]:
        """Predict each frame of the context."""
        return self.baseline.one_step(self.task.states, self.task.fps), None

    def forecasts(self, trials: Rows, rows: Rows, steps: int) -> Array:
        """Return expected futures."""
        return self._run(trials, rows, steps, None)

    def free_runs(self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int) -> Array:
        """Return futures as they may come."""
        generator = np.random.default_rng(seed)
        return np.stack([self._run(trials, rows, steps, generator) for _ in range(draws)])

    def positions(
        self, trials: Rows, rows: Rows, steps: int, draws: int, seed: int
    ) -> Array | None:
        """Return nothing: see :meth:`spread`."""
        return None

    def spread(self, states: Array, steps: int) -> Array | None:
        """Measure its errors."""
        return baseline_covariances(self.baseline, states, steps, self.task.fps)

    def _run(self, trials: Rows, rows: Rows, steps: int, generator: Any) -> Array:
        """Go on from histories, a bounded number at once."""
        order = max(self.baseline.order, 1)
        back = np.arange(1 - min(order, HISTORY + 1), 1)
        first = rows[:, None] + back
        size = max(1, CHUNK // (len(back) * int(np.prod(self.task.states.shape[2:]))))
        pieces = []
        for begin in range(0, len(rows), size):
            chosen = slice(begin, begin + size)
            history = self.task.states[trials[chosen, None], np.maximum(first[chosen], 0)]
            history[first[chosen] < 0] = np.nan
            path = self.baseline.predict(history, steps, self.task.fps, generator)
            started = known(history[:, -1])[:, None, :, None]
            # Who was known and is lost has broken down; as NaN it would not count.
            pieces.append(np.where(started & np.isnan(path), np.inf, path))
        return np.concatenate(pieces)
