"""The models of this package as methods of a benchmark: how each is fitted to a task."""

import json
import time
from dataclasses import dataclass, field
from typing import Any

from swarmssm.analysis.benchmark.task import Task
from swarmssm.inference import Fit, Progress, fit

__all__ = ["OWN", "OwnMethod"]

#: Passes over the data from which the time that one takes is told.
PILOT = 3


@dataclass(frozen=True)
class OwnMethod:
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
    told
        Whether the model contains the true forms of simulated boids.
    """

    name: str
    title: str
    model: str
    exact: dict[str, Any] = field(default_factory=dict)
    noisy: dict[str, Any] = field(default_factory=dict)
    exact_settings: dict[str, Any] = field(default_factory=dict)
    noisy_settings: dict[str, Any] = field(default_factory=dict)
    told: bool = False

    def is_told(self, task: Task) -> bool:
        """Return whether the model holds the very forms that the tracks were made by."""
        law = json.loads(task.tracks.attrs.get("simulation", "{}")).get("law")
        return self.told and law == "boids"

    def fit(self, task: Task, seconds: float | None, seed: int) -> Fit:
        """Fit within a budget of processor seconds."""
        began = time.process_time()
        options = self.exact if task.exact else self.noisy
        settings = {
            **(self.exact_settings if task.exact else self.noisy_settings),
            "graph": task.graph,
            "split_by": "trial" if _whole_trials(task) else "time",
            "model_options": options,
            "seed": seed,
        }
        if "epochs" in settings and seconds is not None:
            pilot = _Timer()
            fit(self.model, tracks=task.tracks, callbacks=[pilot], **settings | {"epochs": PILOT})
            left = seconds - (time.process_time() - began)
            settings["epochs"] = max(PILOT, min(settings["epochs"], int(left / pilot.seconds)))
        return fit(self.model, tracks=task.tracks, **settings)


class _Timer:
    """Measures the processor time of a pass over the data."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def __call__(self, progress: Progress) -> None:
        self.times.append(time.process_time())

    @property
    def seconds(self) -> float:
        """Mean over all but the first."""
        return max(1e-6, (self.times[-1] - self.times[0]) / (len(self.times) - 1))


def _whole_trials(task: Task) -> bool:
    """Return whether the split is by trial."""
    trained = {segment.trial for segment in task.split.train}
    return not any(segment.trial in trained for segment in task.split.test)


#: Walls that are inferred from where animals happened to be push them out of the rest of the tank.
ANIMALS = {"relaxation": True, "limits": False, "walls": False, "noise": "additive"}
OWN: dict[str, OwnMethod] = {
    one.name: one
    for one in (
        OwnMethod(
            "graph-vae",
            "graph VAE of the thesis",
            "graph-vae",
            exact_settings={"epochs": 300},
            noisy_settings={"epochs": 300},
        ),
        OwnMethod(
            "boids",
            "boids, gains inferred",
            "boids",
            exact={"observed": "states"},
            noisy=ANIMALS,
            exact_settings={"epochs": 150, "lr": 0.02},
            told=True,
        ),
        OwnMethod(
            "linear",
            "linear forces, solved exactly",
            "linear",
            exact={"observed": "states"},
            exact_settings={"epochs": 100, "lr": 0.02},
        ),
        OwnMethod(
            "kernel",
            "kernels of distance, inferred",
            "kernel",
            exact={"observed": "states", "noise": "multiplicative", "repulsion": True},
            noisy={"angular": 2, **ANIMALS},
            exact_settings={"epochs": 100, "lr": 0.02},
        ),
        OwnMethod(
            "graph-ssm",
            "graph state-space model",
            "graph-ssm",
            exact={
                "observed": "states",
                "symmetries": "square",
                "noise": "constant",
                "tails": "gaussian",
                "weight_prior": None,
            },
            exact_settings={"window": 10, "batch_windows": 32, "lr": 0.02, "epochs": 80},
            # Where the test part lies elsewhere in the tank, places say nothing.
            noisy={"positions": False},
            noisy_settings={"epochs": 300},
        ),
    )
}
