"""How a model of this package is fitted to a task of a benchmark."""

import json
import time
from dataclasses import dataclass, field
from typing import Any

from swarmssm.benchmark.task import Task
from swarmssm.inference import Fit, TrainingProgress, fit

__all__ = ["ModelMethod", "by_trial"]

#: Passes over the data from which the time of one is measured.
PILOT = 3


@dataclass(frozen=True)
class ModelMethod:
    """A model with the settings it is compared with.

    Attributes
    ----------
    name, title
        For the command line and for tables.
    model
        Registered name.
    exact, noisy
        Model options for states that are known exactly, and for tracked positions.
    exact_settings, noisy_settings
        Of the fit, see :class:`swarmssm.inference.settings.FitSettings`. The
        ``epochs`` among them are cut down to what the budget allows.
    knows_boids
        Whether the model contains the true forms of simulated boids.
    """

    name: str
    title: str
    model: str
    exact: dict[str, Any] = field(default_factory=dict)
    noisy: dict[str, Any] = field(default_factory=dict)
    exact_settings: dict[str, Any] = field(default_factory=dict)
    noisy_settings: dict[str, Any] = field(default_factory=dict)
    knows_boids: bool = False

    def knows_true_form(self, task: Task) -> bool:
        """Return whether the model holds the very forms that the tracks were made by."""
        law = json.loads(task.tracks.attrs.get("simulation", "{}")).get("dynamics")
        return self.knows_boids and law == "boids"

    def fit(self, task: Task, seconds: float | None, seed: int) -> Fit:
        """Fit within a budget of processor seconds."""
        began = time.process_time()
        options = self.exact if task.exact else self.noisy
        settings = {
            **(self.exact_settings if task.exact else self.noisy_settings),
            "graph": task.graph,
            "split_by": "trial" if by_trial(task) else "time",
            "model_options": options,
            "seed": seed,
        }
        if "epochs" in settings and seconds is not None:
            pilot = _Timer()
            fit(self.model, task.tracks, callbacks=[pilot], **settings | {"epochs": PILOT})
            left = seconds - (time.process_time() - began)
            settings["epochs"] = max(PILOT, min(settings["epochs"], int(left / pilot.seconds)))
        return fit(self.model, task.tracks, **settings)


class _Timer:
    """Measures the processor time of a pass over the data."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def __call__(self, progress: TrainingProgress) -> None:
        self.times.append(time.process_time())

    @property
    def seconds(self) -> float:
        """Mean over all but the first."""
        return max(1e-6, (self.times[-1] - self.times[0]) / (len(self.times) - 1))


def by_trial(task: Task) -> bool:
    """Return whether the split is by trial."""
    trained = {segment.trial for segment in task.split.train}
    return not any(segment.trial in trained for segment in task.split.test)
