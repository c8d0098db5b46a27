"""How near a graph network that is not told the forces comes to the noise floor, and how fast.

Simulated boids whose states are known exactly (``boids.npz``: 20 trials of 1000 frames, 10
individuals, soft walls, speeds clamped), so that the law of motion is scored directly, as the
model ``graph-ssm`` with ``observed="states"`` does. It is told the radius of the graph, and that
the arena is square, but not around what; not where walls are, that there are limits of speed, or
what the forces look like. The first 14 trials are trained on, the next 3 choose the epoch, and the
last 3 are tested.

One step
    (4.2) on states scaled to [0, 1] per feature on the training trials, at all frames from the
    fiftieth on.
k steps
    Mean squared error of the scaled states at step k of the mean path, from starts every 25 frames.
Free run
    200 steps of the mean path from every 25th frame; AMD (4.4) and AVD (4.5), and the mean absolute
    error of either over time. From five starts in each trial, as rivals were measured, the error of
    AMD of the true step itself is between .083 and .104, depending on which five.

Beside it stand the true step without noise, which is the floor, and constant velocity.

    python benchmarks/graph_transition.py
    python benchmarks/graph_transition.py --fraction 0.1
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from swarmssm.graphs import radius_graph
from swarmssm.inference import fit
from swarmssm.metrics import amd, avd, mse
from swarmssm.models import StepInputs
from swarmssm.tracks import make_tracks

DATA = Path(__file__).resolve().parents[2] / "shared/data/boids_benchmark/boids.npz"
RADIUS, DT = 2.5, 0.1
TRAIN, TEST = slice(0, 14), slice(17, 20)
#: Frames seen before the first forecast.
HISTORY = 49
HORIZONS = (1, 5, 10, 20, 50)
FREE_STEPS = 200

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
        starts = np.arange(HISTORY, num_frames - 1 - max(HORIZONS), 25)
        states = truth[:, starts]
        for k in range(1, max(HORIZONS) + 1):
            states = step(states)
            if k in HORIZONS:
                error = self.scaled(states) - self.scaled(truth[:, starts + k])
                row[f"{k} steps"] = float((error**2).mean())
        starts = np.arange(HISTORY, num_frames - FREE_STEPS, 25)
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
    parser.add_argument("--epochs", type=int, help="default: 48, up to 240 with fewer data")
    parser.add_argument("--lr", type=float, default=0.02)
    parser.add_argument("--batch", type=int, default=32, help="windows")
    parser.add_argument("--window", type=int, default=10, help="frames")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    if options.epochs is None:
        options.epochs = round(48 * min(5.0, 1.0 / options.fraction))
    torch.set_num_threads(options.threads)
    states = np.load(options.data)["X"]
    kept = states[:, : round(options.fraction * states.shape[1])].astype(float)
    tracks = make_tracks(kept[..., :2], fps=1 / DT, velocity=kept[..., 2:])
    cpu, wall = time.process_time(), time.perf_counter()
    run = fit(
        "graph-ssm",
        tracks,
        guide="parameters",
        model_options={
            "width": options.width,
            "rounds": options.rounds,
            "symmetries": options.symmetries,
            "noise": "constant",
            "tails": "gaussian",
            "observed": "states",
            "weight_prior": None,
        },
        graph=f"radius:{RADIUS}",
        split_by="trial",
        window=options.window,
        batch_windows=options.batch,
        epochs=options.epochs,
        lr=options.lr,
        seed=options.seed,
    )
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    model = run.model

    def learned(states: torch.Tensor) -> torch.Tensor:
        mean: torch.Tensor = model.step(states, StepInputs(graph_of(states))).mean
        return mean

    score = Score(states)
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
