"""How near a graph network that is not told the forces comes to the noise floor, and how fast.

Simulated boids whose states are known exactly (``boids.npz``: 20 trials of 1000 frames, 10
individuals, soft walls, speeds clamped), so that the law of motion is scored directly, as the
model ``graph-ssm`` with ``observed="states"`` does. It gets the radius of the graph, and is not
told where the walls are, that there are limits of speed, or what the forces look like. The first 14
trials are trained on, the last 3 tested.

One step
    (4.2) on states scaled to [0, 1] per feature on the training trials, at all frames from the
    fiftieth on.
k steps
    Mean squared error of the scaled states at step k of the mean path, from starts every 25 frames.
Free run
    200 steps from 5 starts in each test trial; AMD (4.4) and AVD (4.5), and in brackets the mean
    absolute error over time.

Beside it stand the true step without noise, which is the floor, and constant velocity.

    python benchmarks/graph_transition.py --threads 2
    python benchmarks/graph_transition.py --threads 2 --fraction 0.1
"""

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyro
import torch
from pyro.infer import Trace_ELBO

from swarmssm.graphs import EdgeList, radius_graph
from swarmssm.inference.guides import ParameterGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.metrics import amd, avd, mse
from swarmssm.models import StateSpaceModel, StepInputs, SwarmBatch
from swarmssm.models.ready.graph import graph_ssm
from swarmssm.models.scales import scales_of
from swarmssm.tracks import make_tracks

DATA = Path(__file__).resolve().parents[2] / "shared/data/boids_benchmark/boids.npz"
RADIUS, DT = 2.5, 0.1
TRAIN, TEST = slice(0, 14), slice(17, 20)
#: Frames seen before the first forecast.
HISTORY = 49
HORIZONS = (1, 5, 10, 20, 50)
FREE_STEPS = 200
#: Steps of the optimiser until the learning rate is there.
WARM_UP = 50

Step = Callable[[torch.Tensor], torch.Tensor]


def graph_of(states: torch.Tensor) -> torch.Tensor:
    """Return who is within the radius of whom."""
    near = radius_graph(states[..., :2], RADIUS)
    return near & ~torch.eye(states.shape[-2], dtype=torch.bool)


def complete(states: torch.Tensor, velocities: torch.Tensor) -> torch.Tensor:
    """Return the next states with given velocities."""
    return torch.cat([states[..., :2] + DT * velocities, velocities], dim=-1)


def constant_velocity(states: torch.Tensor) -> torch.Tensor:
    """Return the next states if nothing acts."""
    return complete(states, states[..., 2:])


def true_step(states: torch.Tensor) -> torch.Tensor:
    """Return the next states under the law of the simulation, without its noise."""
    positions, velocities = states[..., :2], states[..., 2:]
    graph = graph_of(states).to(states.dtype)
    apart = positions.unsqueeze(-3) - positions.unsqueeze(-2)
    count = graph.sum(-1, keepdim=True)
    weights = graph / count.clamp(min=1)
    cohesion = (weights.unsqueeze(-1) * apart).sum(-2)
    inverse = graph / apart.square().sum(-1).clamp(min=1e-12)
    separation = -(inverse.unsqueeze(-1) * apart).sum(-2)
    alignment = weights @ velocities - velocities * (count > 0)
    wall = -positions.sign() * (positions.abs() - 4).clamp(min=0)
    force = 0.5 * cohesion + 0.3 * separation + 0.2 * alignment + wall
    moved = velocities + DT * force
    speed = moved.norm(dim=-1, keepdim=True)
    return complete(states, moved / speed * speed.clamp(0.6, 1.2))


def windows(states: np.ndarray, frames: int) -> SwarmBatch:
    """Return windows that share their last frame with the next one's first."""
    count = (states.shape[1] - 1) // (frames - 1)
    index = (frames - 1) * np.arange(count)[:, None] + np.arange(frames)
    cut = torch.from_numpy(states[:, index].reshape(-1, frames, *states.shape[2:]))
    mask = torch.ones(cut.shape[:-1], dtype=torch.bool)
    return SwarmBatch.of(cut, mask, EdgeList.from_dense(graph_of(cut)))


def train(model: StateSpaceModel, data: SwarmBatch, options: argparse.Namespace) -> None:
    """Maximise the ELBO, here the log-density of the states, by Adam."""
    elbo = Trace_ELBO()(model, ParameterGuide.for_model(model))
    parameters = list(elbo.parameters())
    optimizer = torch.optim.Adam(parameters, lr=options.lr, fused=True)
    coordinates = data.observations[:, 1:].numel()
    total = options.epochs * math.ceil(len(data) / options.batch)
    step = 0
    for _ in range(options.epochs):
        for part in torch.split(torch.randperm(len(data)), options.batch):
            rate = min(1.0, (step + 1) / WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / total))
            for group in optimizer.param_groups:
                group["lr"] = options.lr * rate
            optimizer.zero_grad(set_to_none=True)
            loss = elbo(model.augmented(data.select(part))) / coordinates
            loss.backward()
            torch.nn.utils.clip_grad_norm_(parameters, 1.0)
            optimizer.step()
            step += 1


class Score:
    """The table's numbers, from the test trials."""

    def __init__(self, states: np.ndarray) -> None:
        rows = states[TRAIN].reshape(-1, states.shape[-1]).astype(float)
        self.low, self.span = rows.min(0), np.ptp(rows, axis=0)
        self.test = torch.from_numpy(states[TEST])

    def scaled(self, states: torch.Tensor) -> np.ndarray:
        """Return states in [0, 1] on the training trials."""
        return (states.double().numpy() - self.low) / self.span

    @torch.no_grad()
    def row(self, step: Step) -> dict[str, float]:
        """Return all scores of a deterministic step."""
        truth, num_frames = self.test, self.test.shape[1]
        predicted = np.full(truth.shape, np.nan)
        predicted[:, 1:] = self.scaled(step(truth[:, :-1]))
        predicted[:, :HISTORY] = np.nan
        row = {"one step": mse(self.scaled(truth), predicted)}
        starts = np.arange(HISTORY, num_frames - max(HORIZONS), 25)
        states = truth[:, starts]
        for k in range(1, max(HORIZONS) + 1):
            states = step(states)
            if k in HORIZONS:
                error = self.scaled(states) - self.scaled(truth[:, starts + k])
                row[f"{k} steps"] = float((error**2).mean())
        # The free runs are spread over the whole trial.
        starts = np.linspace(HISTORY, num_frames - 1 - FREE_STEPS, 5).astype(int)
        states, run = truth[:, starts], []
        for _ in range(FREE_STEPS):
            states = step(states)
            run.append(states)
        own = torch.stack(run, dim=2).double().numpy()
        index = starts[:, None] + np.arange(1, FREE_STEPS + 1)
        true = truth[:, index].double().numpy()
        for name, measure, features in (("AMD", amd, np.s_[:2]), ("AVD", avd, np.s_[2:])):
            one, other = measure(own[..., features]), measure(true[..., features])
            row[name], row[f"{name} error"] = float(one.mean()), float(abs(one - other).mean())
        return row


def main() -> None:
    """Train, score and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--fraction", type=float, default=1.0, help="of each trial's frames")
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--symmetries", default="square")
    parser.add_argument("--epochs", type=int, help="default: 24, and more with fewer data")
    parser.add_argument("--lr", type=float, default=0.02)
    parser.add_argument("--batch", type=int, default=32, help="windows")
    parser.add_argument("--window", type=int, default=10, help="frames")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    if options.epochs is None:
        options.epochs = round(24 * min(10.0, 1.0 / options.fraction))
    torch.set_num_threads(options.threads)
    states = np.load(options.data)["X"]
    kept = states[TRAIN, : round(options.fraction * states.shape[1])]
    score = Score(states)

    cpu, wall = time.process_time(), time.perf_counter()
    pyro.set_rng_seed(options.seed)
    tracks = make_tracks(
        kept[..., :2].astype(float), fps=1 / DT, velocity=kept[..., 2:].astype(float)
    )
    with quiet_pyro():
        model = graph_ssm(
            scales_of(tracks),
            width=options.width,
            rounds=options.rounds,
            symmetries=options.symmetries,
            observed="states",
        )
        train(model, windows(kept, options.window), options)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall

    def learned(states: torch.Tensor) -> torch.Tensor:
        inputs = StepInputs(EdgeList.from_dense(graph_of(states)))
        mean: torch.Tensor = model.step(states, inputs).mean
        return mean

    rows = {
        "true step": score.row(true_step),
        "graph network": score.row(learned),
        "constant velocity": score.row(constant_velocity),
    }
    floor = rows["true step"]
    print(f"{'':>14}" + "".join(f"{name:>24}" for name in rows))
    for name, base in floor.items():
        cells = (f"{row[name]:.3g} ({row[name] / base:.3f} x)" for row in rows.values())
        print(f"{name:>14}" + "".join(f"{cell:>24}" for cell in cells))
    limits = model.transition.limits
    bounds = " to ".join(f"{float(v.detach()):.3f}" for v in (limits.low, limits.high))
    centre = ", ".join(f"{v:.3f}" for v in model.transition.centre.tolist())
    print(f"learned: speeds {bounds} (true 0.6 to 1.2), centre {centre} (true 0, 0)")
    print(
        f"{sum(p.numel() for p in model.parameters())} parameters, {options.epochs} epochs, "
        f"{wall:.0f} s ({cpu:.0f} CPU-seconds) on {options.threads} threads"
    )


if __name__ == "__main__":
    main()
