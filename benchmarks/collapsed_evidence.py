"""How long the collapsed evidence with its gradient takes: 8 flocks x 200 frames x 10, float64.

    python benchmarks/collapsed_evidence.py [--rounds 9] [--threads 2] [--jax-environment FOLDER]

Rounds are interleaved, so that a busy machine slows all alike:

*extended*
    ``collapsed_evidence(method="extended")``, the extended Kalman filter.
*iterated*
    ``collapsed_evidence(method="iterated", points=...)``, at the smoothed path: what an optimiser
    or NUTS evaluates. Moving the points is timed beside it: done a few times in a fit.
*jax*
    The same extended Kalman filter in jax: ``lax.scan``, ``jacfwd``, ``vmap``, under ``jit``, in a
    virtual environment of its own (made, unless a folder with one is given).

Before anything is timed, the extended filter and jax must give the same value and gradient.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

import numpy as np
import torch
from flocks import TRUTH, flock_model, simulate, windows

from swarmssm.inference.filtering import collapsed_evidence, linearization_points


def environment(folder: Path) -> Path:
    """Return the Python of a virtual environment with jax, which is made if it is not there."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
        subprocess.run([str(python), "-m", "pip", "install", "-q", "jax[cpu]"], check=True)
    return python


class Jax:
    """The rival, waiting in a process of its own."""

    def __init__(self, python: Path, data: Path, threads: int) -> None:
        flags = f"--xla_cpu_multi_thread_eigen={'true' if threads > 1 else 'false'}"
        if threads == 1:
            flags += " intra_op_parallelism_threads=1"
        self.process = subprocess.Popen(
            [str(python), str(Path(__file__).with_name("jax_filter.py")), str(data)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"XLA_FLAGS": flags},
        )
        self.version = self.process.stdout.readline().split()[1]

    def __call__(self) -> dict[str, object]:
        """Evaluate once."""
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())


def main() -> None:
    """Time all in turn, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--jax-environment", type=Path, default=None)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)

    batch = windows(simulate(TRUTH, 0, 8, 200))
    model = flock_model()
    values = {
        name: torch.tensor(value, dtype=torch.float64, requires_grad=True)
        for name, value in TRUTH.items()
    }
    points = linearization_points(model, batch, values)

    def evaluate(**how: object) -> tuple[float, list[float]]:
        total = collapsed_evidence(model, batch, values, **how).sum()
        gradient = torch.autograd.grad(total, list(values.values()))
        return total.item(), [float(part) for part in gradient]

    def move() -> None:
        linearization_points(model, batch, values, start=points)

    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "flocks.npz"
        np.savez(
            data,
            positions=batch.observations.numpy(),
            parameters=np.array(list(TRUTH.values())),
            initial_mean=model.initial.mean.numpy(),
            initial_scale=model.initial.scale.numpy(),
        )
        python = environment(options.jax_environment or Path(folder) / "environment")
        rival = Jax(python, data, options.threads)
        theirs, (value, gradient) = rival(), evaluate(method="extended")
        np.testing.assert_allclose(value, theirs["value"], rtol=1e-8)
        np.testing.assert_allclose(gradient, theirs["gradient"], rtol=1e-5)
        ours = {
            "extended": lambda: evaluate(method="extended"),
            "iterated": lambda: evaluate(method="iterated", points=points),
            "moving points": move,
        }
        seconds: dict[str, list[float]] = {name: [] for name in [*ours, "jax"]}
        for _ in range(options.rounds):
            for name, run in ours.items():
                began = time.perf_counter()
                run()
                seconds[name].append(time.perf_counter() - began)
            seconds["jax"].append(rival()["seconds"])
        rival.process.stdin.close()
        rival.process.wait()

    load = ", ".join(f"{part:.1f}" for part in os.getloadavg())
    print(f"{platform.processor() or platform.machine()}, {options.threads} threads, load {load}")
    print(f"python {sys.version.split()[0]}, torch {torch.__version__}, jax {rival.version}")
    reference = statistics.median(seconds["jax"])
    print(f"{'':14s} median s  fastest s  of jax (median)  of jax (fastest)")
    for name, row in seconds.items():
        middle, least = statistics.median(row), min(row)
        print(
            f"{name:14s} {middle:8.3f}  {least:9.3f}  {middle / reference:15.2f}"
            f"  {least / min(seconds['jax']):16.2f}"
        )


if __name__ == "__main__":
    main()
