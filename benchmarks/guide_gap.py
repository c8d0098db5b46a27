"""How far the ELBO of a fitted guide stays below the exact evidence of a linear-Gaussian swarm.

The swarms interact: each individual is drawn to the mean of those whom it sees, on a graph that
changes from frame to frame; a fifth of the sightings are missing.

*full state*
    ``LinearTransition``: position and velocity all have noise, both are observed.
*positions only*
    The same, of which positions alone are observed.
*kinematic*
    Noise enters through the velocity alone, positions follow from it, and they alone are observed.

The exact evidence is that of a Kalman filter of the whole swarm's joint state. Printed is by how
much it exceeds the ELBO, in nats per observed coordinate, with standard error over draws: before
training and after it. The model is held fixed. ``SmoothingGuide`` is the mean-field one; its gap
cannot vanish.

    python benchmarks/guide_gap.py --steps 80
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pyro.distributions as dist
import torch
from torch import Tensor

from swarmssm.graphs import neighbor_mean
from swarmssm.inference.bounds import Bound
from swarmssm.inference.filtering.evidence import collapsed_evidence
from swarmssm.inference.guides import MarkovGuide, SmoothingGuide, SwarmGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    Emission,
    InitialStates,
    KinematicTransition,
    LinearTransition,
    PositionEmission,
    StateEmission,
    StateSpaceModel,
    StepInputs,
    SwarmBatch,
)

WINDOWS, TIMES, INDIVIDUALS = 4, 30, 6
SEEN, LINKED = 0.8, 0.5
#: Draws for a mean ELBO.
DRAWS = 20
LEARNING_RATE = 0.005


class Drawn(KinematicTransition):
    """Bodies on springs, drawn to the mean of those whom they see and turning with them."""

    def velocity(
        self, positions: Tensor, velocities: Tensor, inputs: StepInputs
    ) -> dist.TorchDistribution:
        """Return the distribution of the next velocities."""
        assert inputs.adjacency is not None
        states = torch.cat([positions, velocities], -1)
        mean, sees = neighbor_mean(states, inputs.adjacency)
        pull_p, pull_v = torch.where(sees, mean - states, 0.0).chunk(2, -1)
        change = pull_p + pull_v - positions - 0.3 * velocities
        noise = torch.full_like(velocities, 0.15 * math.sqrt(self.dt))
        return dist.Normal(velocities + self.dt * change, noise).to_event(1)


def start() -> InitialStates:
    """Return where a swarm begins."""
    return InitialStates(torch.zeros(4), torch.tensor([1.0, 1.0, 0.5, 0.5]))


def linear(emission: Emission, coupling: float) -> StateSpaceModel:
    """Return a swarm whose whole state has noise, pulled to neighbours by ``coupling``."""
    matrix = torch.eye(4) - torch.diag(torch.tensor([0.0, 0.0, 0.1, 0.1]))
    matrix[0, 2] = matrix[1, 3] = 0.2
    matrix[2, 0] = matrix[3, 1] = -0.1
    pull = coupling * torch.diag(torch.tensor([0.1, 0.1, 1.0, 1.0]))
    pull[2, 0] = pull[3, 1] = 0.5 * coupling
    root = torch.diag(torch.tensor([0.03, 0.03, 0.1, 0.1]))
    root[2, 0] = root[3, 1] = 0.05
    return StateSpaceModel(start(), LinearTransition(4, matrix, root, coupling=pull), emission)


def kinematic() -> StateSpaceModel:
    """Return a swarm in which velocities alone have noise."""
    return StateSpaceModel(start(), Drawn(2, 0.1), PositionEmission(2, 0.03))


CASES: dict[str, Callable[[], StateSpaceModel]] = {
    "full state, pull 0.2": lambda: linear(StateEmission(2, 0.1, 0.2), 0.2),
    "full state, pull 0.4": lambda: linear(StateEmission(2, 0.1, 0.2), 0.4),
    "positions only, pull 0.2": lambda: linear(PositionEmission(2, 0.1), 0.2),
    "kinematic": kinematic,
}
GUIDES: dict[str, tuple[type[SwarmGuide], dict[str, Any]]] = {
    "smoothing (mean field)": (SmoothingGuide, {}),
    "markov, passes=1": (MarkovGuide, {"passes": 1}),
    "markov": (MarkovGuide, {}),
}


def draw(model: StateSpaceModel, seed: int) -> SwarmBatch:
    """Draw windows from a model."""
    torch.manual_seed(seed)
    shape = (WINDOWS, TIMES, INDIVIDUALS)
    linked = (torch.rand(*shape, INDIVIDUALS) < LINKED) & ~torch.eye(INDIVIDUALS, dtype=torch.bool)
    adjacency = linked.to(torch.get_default_dtype())
    whole = torch.ones(shape, dtype=torch.bool)
    width = 2 if model.observes == "positions" else 4
    batch = SwarmBatch.of(torch.zeros(*shape, width), whole, adjacency)
    assert not model.emission.is_exact
    with torch.no_grad():
        observations = model.emission(model.chain(batch, {}).sample()).sample()
    mask = torch.rand(shape) < SEEN
    mask[:, 0] = mask[:, -1] = True
    return replace(batch, observations=observations * mask.unsqueeze(-1), mask=mask)


def gap(bound: Bound, batch: SwarmBatch, evidence: float, coordinates: int) -> tuple[float, float]:
    """Return the mean gap per coordinate and its standard error."""
    with torch.no_grad():
        losses = torch.stack([bound(batch) for _ in range(DRAWS)])
    gaps = (evidence + losses) / coordinates
    return float(gaps.mean()), float(gaps.std() / math.sqrt(DRAWS))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=80)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.set_default_dtype(torch.float64)
    print(f"{WINDOWS} windows x {TIMES} frames x {INDIVIDUALS} individuals, {options.steps} steps")
    print()
    print("| swarm | exact, nats per coordinate | guide | gap untrained | gap trained | s |")
    print("|---|---|---|---|---|---|")
    for name, make in CASES.items():
        model = make()
        batch = draw(model, options.seed)
        coordinates = int(batch.mask.sum()) * batch.observations.shape[-1]
        evidence = float(collapsed_evidence(model, batch, layout="joint").sum())
        for label, (kind, arguments) in GUIDES.items():
            began = time.perf_counter()
            torch.manual_seed(options.seed)
            with quiet_pyro():
                guide = kind.for_model(model, **arguments)
                bound = Bound(model, guide)
                before = gap(bound, batch, evidence, coordinates)
                optimizer = torch.optim.Adam(guide.parameters(), lr=LEARNING_RATE)
                decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, options.steps)
                for _ in range(options.steps):
                    optimizer.zero_grad()
                    (bound(batch) / coordinates).backward()
                    optimizer.step()
                    decay.step()
                after = gap(bound, batch, evidence, coordinates)
            print(
                f"| {name} | {evidence / coordinates:.4f} | {label} "
                f"| {before[0]:.4f} ± {before[1]:.4f} | {after[0]:.4f} ± {after[1]:.4f} "
                f"| {time.perf_counter() - began:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
