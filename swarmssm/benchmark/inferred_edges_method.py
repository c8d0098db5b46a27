"""A model of this package that is given no graph, and infers who acts on whom."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from swarmssm.benchmark.model_method import ModelMethod, by_trial
from swarmssm.benchmark.task import Task
from swarmssm.inference import Fit, fit, fixed_transition

__all__ = ["InferredEdgesMethod"]

#: Share of the time in which transitions are fitted on graphs that may do for the time being.
SHARE = 0.35
#: Processor seconds where no budget is given.
USUAL = 300.0
PILOT_STEPS = 12
FEWEST, MOST = 3, 1000


@dataclass(frozen=True)
class InferredEdgesMethod(ModelMethod):
    """Edges inferred under a transition that is fixed.

    Transitions are fitted on some graphs by distance first. The one with the best evidence lower
    bound in the validation part is fixed (``fixed_transition``), and edges that may
    change in each frame are learned under it. The graph of the task is not looked at.

    Attributes
    ----------
    spacings
        Radii that are tried, in typical distances between nearest neighbours.
    neighbors
        Numbers of nearest neighbours that are tried.
    edge_settings
        Of the fit of the edges.
    """

    spacings: tuple[float, ...] = (2.0, 3.0, 4.5)
    neighbors: tuple[int, ...] = (3, 5)
    edge_settings: dict[str, Any] = field(default_factory=dict)

    def fit(self, task: Task, seconds: float | None, seed: int) -> Fit:
        """Fit within a budget of processor seconds."""
        began, budget = time.process_time(), USUAL if seconds is None else seconds
        settings = {
            **(self.exact_settings if task.exact else self.noisy_settings),
            "split_by": "trial" if by_trial(task) else "time",
            "model_options": self.exact if task.exact else self.noisy,
            "seed": seed,
        }

        def learn(**more: Any) -> Fit:
            return fit(self.model, task.tracks, **settings | more)

        first = learn(graph=f"k-nearest:{self.neighbors[0]}", steps=FEWEST)
        rules = [f"radius:{length * first.scales.spacing:.3g}" for length in self.spacings]
        rules += [f"k-nearest:{number}" for number in self.neighbors]
        rules = rules if first.scales.spacing else rules[len(self.spacings) :]
        steps = _affordable(SHARE * budget / len(rules), lambda n: learn(graph=rules[-1], steps=n))
        transitions = [learn(graph=rule, steps=steps) for rule in rules]
        best = min(transitions, key=lambda one: float(one.history["validation_loss"].min()))
        edges = {
            "edges": "dynamic-relational",
            "priors": fixed_transition(best),
            **self.edge_settings,
        }
        pilot = _cost(lambda n: learn(**edges, steps=n))
        left = budget - (time.process_time() - began)
        return learn(**edges, steps=_steps(left, *pilot))


def _cost(learn: Callable[[int], Fit]) -> tuple[float, float]:
    """Return the processor time of a fit without steps, and what each step adds."""
    times = []
    for steps in (FEWEST, FEWEST + PILOT_STEPS):
        began = time.process_time()
        learn(steps)
        times.append(time.process_time() - began)
    each = max(1e-4, (times[1] - times[0]) / PILOT_STEPS)
    return max(0.0, times[0] - FEWEST * each), each


def _affordable(seconds: float, learn: Callable[[int], Fit]) -> int:
    """Return how many steps fit into a time."""
    return _steps(seconds, *_cost(learn))


def _steps(seconds: float, fixed: float, each: float) -> int:
    return int(min(MOST, max(FEWEST, (seconds - fixed) / each)))
