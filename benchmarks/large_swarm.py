"""Memory and time of one step of inference in swarms of thousands.

A step is the ELBO of ``GraphTransition`` with ``SmoothingGuide``, its gradient, and one step of
Adam, on one window of positions seen with noise; the graph is a list of edges, about
``--neighbors`` each within a radius. Individuals wander at constant density, so that a larger swarm
is the same, only larger.

Each size runs in a process of its own, whose greatest resident memory is what the operating system
says. Sizes are taken in turn, round after round, so that a busy machine slows all; the time of a
size is the median over rounds of each process's median step. On one thread processor time is taken,
which other work disturbs less than the clock on the wall.

    python benchmarks/large_swarm.py --individuals 500 1000 2000 5000 --steps 20 --rounds 3
"""

import argparse
import json
import math
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import torch
from pyro.distributions import constraints
from pyro.infer import Trace_ELBO
from pyro.nn import PyroParam

from swarmssm.graphs import EdgeList, GraphRule, graph_by_rule
from swarmssm.inference.guides import find_guide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import (
    InitialStates,
    PositionEmission,
    Scales,
    StateSpaceModel,
    SwarmBatch,
)
from swarmssm.models.transitions import GraphTransition

NOISE = 0.03
STEP = 0.1
SPEED = 1.0


def wander(individuals: int, frames: int, density: float) -> torch.Tensor:
    """Return noisy positions ``(1, time, individual, 2)`` of a swarm of given density."""
    generator = torch.Generator().manual_seed(0)
    side = math.sqrt(individuals / density)
    start = side * torch.rand(individuals, 2, generator=generator)
    heading = 2.0 * math.pi * torch.rand(individuals, generator=generator)
    turns = 0.2 * torch.randn(frames, individuals, generator=generator)
    heading = heading + turns.cumsum(0)
    moved = STEP * SPEED * torch.stack([heading.cos(), heading.sin()], -1)
    positions = start + moved.cumsum(0)
    noise = NOISE * torch.randn(positions.shape, generator=generator)
    return (positions + noise).unsqueeze(0)


def scales_for(positions: torch.Tensor) -> Scales:
    """Return the typical sizes of the positions, which are known beforehand."""
    rows = positions.reshape(-1, 2)
    return Scales(
        space=2,
        individuals=positions.shape[2],
        dt=STEP,
        centre=tuple(rows.mean(0).tolist()),
        low=tuple(rows.amin(0).tolist()),
        high=tuple(rows.amax(0).tolist()),
        length=float(rows.std()),
        speed=SPEED,
        slow=0.5 * SPEED,
        fast=1.5 * SPEED,
        spacing=0.5,
        step=0.2 * SPEED,
        noise=NOISE,
    )


def measure(individuals: int, frames: int, neighbors: float, repeats: int) -> dict[str, float]:
    """Take steps of inference; return their median seconds, edges, and the greatest memory."""
    # Within a radius of 1 there are pi * density others on average.
    positions = wander(individuals, frames, neighbors / math.pi)
    began = time.perf_counter()
    graph = graph_by_rule(GraphRule("radius", radius=1.0), positions)
    making = time.perf_counter() - began
    batch = SwarmBatch.of(positions, torch.ones(positions.shape[:-1], dtype=torch.bool), graph)
    scales = scales_for(positions)
    torch.manual_seed(0)
    model = StateSpaceModel(
        InitialStates.for_scales(scales),
        GraphTransition(scales),
        PositionEmission(2, PyroParam(torch.tensor(NOISE), constraint=constraints.positive)),
    )
    guide = find_guide("smoothing").for_model(model)
    loss_of = Trace_ELBO()(model, guide)
    clock = time.process_time if torch.get_num_threads() == 1 else time.perf_counter
    seconds = []
    with quiet_pyro():
        loss_of(batch)
        optimizer = torch.optim.Adam(loss_of.parameters(), lr=1e-3)
        for _ in range(repeats + 1):
            began = clock()
            optimizer.zero_grad()
            loss = loss_of(batch)
            loss.backward()
            optimizer.step()
            seconds.append(clock() - began)
    if not math.isfinite(loss.item()):
        raise SystemExit(f"the loss is {loss.item()}")
    edges = graph.num_edges if isinstance(graph, EdgeList) else int(graph.sum())
    return {
        "seconds": statistics.median(seconds[1:]),
        "making": making,
        "degree": edges / (individuals * frames),
        # Linux counts in units of 1024 bytes.
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
        "is_list": isinstance(graph, EdgeList),
    }


def in_own_process(individuals: int, options: argparse.Namespace) -> dict[str, float]:
    """Run :func:`measure` in a new process."""
    command = [sys.executable, __file__, "--individuals", str(individuals), "--measure"]
    for name in ("steps", "neighbors", "repeats", "threads"):
        command += [f"--{name}", str(getattr(options, name))]
    environment = {**os.environ, "OMP_NUM_THREADS": str(options.threads)}
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True, env=environment)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def machine() -> str:
    """Return cores and processor."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{os.cpu_count()} cores, {names[0] if names else platform.machine()}"


def main() -> None:
    """Measure each size in turn, print a table and the fitted exponent."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--individuals", type=int, nargs="+", default=[500, 1000, 2000, 5000])
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--neighbors", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    if options.measure:
        (individuals,) = options.individuals
        found = measure(individuals, options.steps + 1, options.neighbors, options.repeats)
        print(json.dumps(found))
        return
    rounds = [
        {size: in_own_process(size, options) for size in options.individuals}
        for _ in range(options.rounds)
    ]
    print(f"{datetime.now(UTC):%Y-%m-%d}; {machine()}; torch {torch.__version__}")
    print(f"{options.steps} steps, {options.rounds} rounds, {options.threads} threads")
    print()
    print("| individuals | neighbours | step, s | making the graph, s | peak memory, GB |")
    print("|---|---|---|---|---|")
    seconds = []
    for size in options.individuals:
        runs = [found[size] for found in rounds]
        seconds.append(statistics.median(run["seconds"] for run in runs))
        making = statistics.median(run["making"] for run in runs)
        peak = max(run["gigabytes"] for run in runs)
        print(
            f"| {size} | {runs[0]['degree']:.1f} | {seconds[-1]:.2f} | {making:.2f} | {peak:.2f} |"
        )
    if len(seconds) > 1:
        exponent = np.polyfit(np.log(options.individuals), np.log(seconds), 1)[0]
        print(f"\nfitted exponent of the time in the number of individuals: {exponent:.2f}")


if __name__ == "__main__":
    main()
