"""Gains of simulated boids from exactly known states, with and without the limits of speed.

The training trials of ``boids_benchmark/boids.npz`` (14 trials x 1000 frames x 10 individuals), in
which a quarter of all velocities lie at a limit of speed. The transition is scored directly; the
posterior is the most probable value with the curvature there (flat priors on the logarithms).

    python benchmarks/boids_recovery.py ../shared/data/boids_benchmark/boids.npz
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np
import pyro
import pyro.distributions as dist
import torch
from torch import Tensor

from swarmssm.models import StepInputs
from swarmssm.models.parameters import fixed
from swarmssm.models.transitions import BoidsTransition

NAMES = ("cohesion_gain", "separation_gain", "alignment_gain", "wall_gain", "process_noise")
TRUTH = (0.5, 0.3, 0.2, 1.0, 0.02)


class Data:
    """The training trials."""

    def __init__(self, path: Path, trials: int, frames: int) -> None:
        with np.load(path) as file:
            chosen = file["train"][:trials]
            states = torch.from_numpy(file["X"][chosen, :frames].astype(np.float64))
            graph = torch.from_numpy(file["A"][chosen, : frames - 1].astype(np.float64))
        self.before, self.after = states[:, :-1], states[:, 1:]
        self.inputs = StepInputs(graph)
        speed = torch.linalg.vector_norm(self.after[..., 2:], dim=-1)
        self.limits = (float(speed.min()), float(speed.max()))
        self.at_limit = tuple(
            float(((speed / limit - 1.0).abs() < 1e-6).double().mean()) for limit in self.limits
        )


def law_of_motion(limits: dict[str, float]) -> BoidsTransition:
    """Return the law with five unknowns."""
    prior = dist.LogNormal(0.0, 1.0)
    return BoidsTransition(
        2, 0.1, half_width=4.0, noise="multiplicative", **dict.fromkeys(NAMES, prior), **limits
    )


def log_likelihood(logs: Tensor, data: Data, law: BoidsTransition) -> Tensor:
    """Return the log-density of all steps at the logarithms of the unknowns."""
    with fixed(law, dict(zip(NAMES, logs.exp(), strict=True))):
        return law(data.before, data.inputs).log_prob(data.after).sum()


def fit(data: Data, limits: dict[str, float]) -> tuple[Tensor, Tensor]:
    """Return the most probable values, and standard deviations from the curvature."""
    law = law_of_motion(limits)
    logs = torch.tensor([0.3, 0.3, 0.3, 0.3, 0.05]).log().requires_grad_(True)
    count = data.before[..., 0].numel()
    optimizer = torch.optim.LBFGS(
        [logs],
        max_iter=100,
        tolerance_grad=1e-9,
        tolerance_change=1e-14,
        line_search_fn="strong_wolfe",
    )

    def closure() -> float:
        optimizer.zero_grad()
        loss = -log_likelihood(logs, data, law) / count
        loss.backward()
        return loss.item()

    optimizer.step(closure)
    best = logs.detach()
    curvature = torch.autograd.functional.hessian(lambda at: -log_likelihood(at, data, law), best)
    return best.exp(), best.exp() * curvature.inverse().diagonal().sqrt()


def main() -> None:
    """Fit twice, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", type=Path)
    parser.add_argument("--trials", type=int, default=14)
    parser.add_argument("--frames", type=int, default=1000)
    options = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    pyro.enable_validation(False)
    data = Data(options.path, options.trials, options.frames)
    low, high = data.limits
    print(
        f"{math.prod(data.before.shape[:3])} steps; speeds from {low:.6f}, where "
        f"{data.at_limit[0]:.1%} are, to {high:.6f}, where {data.at_limit[1]:.1%} are"
    )
    print("                   truth   with limits (sd off)      limits ignored (sd off)")
    began = time.perf_counter()
    aware = fit(data, {"min_speed": low, "max_speed": high})
    aware_seconds = time.perf_counter() - began
    began = time.perf_counter()
    naive = fit(data, {})
    naive_seconds = time.perf_counter() - began
    for row, (name, truth) in enumerate(zip(NAMES, TRUTH, strict=True)):
        cells = [
            f"{value[row]:8.5f} +- {sd[row]:.5f} ({(value[row] - truth) / sd[row]:+6.1f})"
            for value, sd in (aware, naive)
        ]
        print(f"{name:16s} {truth:7.3f}  {cells[0]}  {cells[1]}")
    print(f"{'seconds':16s} {'':7s}  {aware_seconds:8.0f} {'':18s} {naive_seconds:8.0f}")


if __name__ == "__main__":
    main()
