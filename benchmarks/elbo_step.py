"""How long a step of stochastic variational inference of the graph model takes, four ways.

The model is ``GraphTransition`` under positions seen with noise, the guide ``SmoothingGuide``. A
step is the negative ELBO, its gradient, and one step of Adam:

*library*
    The path of states is one sample site, and all steps are scored in one call.
*per step*
    The same parts, put together as Pyro's tutorials write a state-space model: in model and guide
    a ``pyro.sample`` for each frame, inside ``pyro.markov``, and in the model a call of the
    transition for each, on a matrix of pairs, which for one frame is faster than a list of edges.
    Model and guide are Pyro modules as the library's are, and Pyro checks as little: arguments of
    distributions are not validated, and weights of ordinary networks are no statements. What the
    guide knows of a whole window (its network, its smoother) it computes at once here too.
*by hand*
    The same networks in plain torch: the guide's own draw, densities as formulas, no Pyro.
*compiled*
    The library after ``torch.compile`` of the network, where a C++ compiler is found.

Before anything is timed, the ELBOs of the first three must agree for the same draws. Steps are then
taken in turn, A B C A B C, so that a busy machine slows all of them; ratios are those of medians.
On one thread processor time is taken, which other work disturbs less than the clock on the wall.

    python benchmarks/elbo_step.py --batch 4 16 --rounds 9
    python benchmarks/elbo_step.py --scaling --batch 4 --rounds 5
"""

import argparse
import math
import os
import platform
import shutil
import statistics
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyro
import pyro.distributions as dist
import torch
from pyro import poutine
from pyro.distributions import constraints
from pyro.infer import Trace_ELBO
from pyro.nn import PyroParam
from torch import Tensor

import swarmssm
from swarmssm.graphs import EdgeList, GraphRule
from swarmssm.inference.guides import SmoothingGuide
from swarmssm.inference.guides.following import ModelInformedGuide
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import InitialStates, PositionEmission, Scales, StateSpaceModel, SwarmBatch
from swarmssm.models.transitions import GraphTransition

NOISE, STEP, SPEED, SPACE = 0.03, 0.1, 1.0, 2
#: Difference allowed between ELBOs in float64, as a share of the guide's own log-density: sixteen
#: digits are kept, and some ten thousand terms are added in another order.
TOLERANCE = 1e-10
HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)


def windows(batch: int, steps: int, individuals: int, radius: float, is_list: bool) -> SwarmBatch:
    """Return windows of wandering individuals, seen with noise."""
    generator = torch.Generator().manual_seed(0)
    heading = 2.0 * math.pi * torch.rand(batch, 1, individuals, generator=generator)
    turns = 0.2 * torch.randn(batch, steps, individuals, generator=generator)
    heading = heading + turns.cumsum(1)
    moved = STEP * SPEED * torch.stack([heading.cos(), heading.sin()], -1)
    start = 3.0 * torch.rand(batch, 1, individuals, SPACE, generator=generator)
    true = start + moved.cumsum(1)
    # A group stays together.
    true = true - true.mean(2, keepdim=True)
    seen = true + NOISE * torch.randn(true.shape, generator=generator)
    graph = GraphRule("radius", radius=radius)(seen).float()
    mask = torch.ones(seen.shape[:-1], dtype=torch.bool)
    return SwarmBatch.of(seen, mask, EdgeList.from_dense(graph) if is_list else graph)


def scales_for(batch: SwarmBatch) -> Scales:
    """Return the typical sizes of the windows, which are known beforehand."""
    rows = batch.observations.reshape(-1, SPACE)
    return Scales(
        space=SPACE,
        individuals=batch.num_individuals,
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


class Posterior:
    """The guide's own factors, taken from what it is made of."""

    def __init__(self, guide: ModelInformedGuide, batch: SwarmBatch) -> None:
        known = guide.setting(batch, {})
        parts = known.sightings, known.law, known.start, batch.present
        mean = guide.chain.mean(*parts)
        spread = guide.chain.spread(*parts)
        stretch, total = known.correction, known.reference + mean
        self.first = dist.Normal(total[:, 0], spread.first[:, 0] * stretch[:, 0].exp())
        scale = spread.free * stretch[:, 1:, :, SPACE:].exp()
        self.later = dist.Normal(total[:, 1:, :, SPACE:], scale)


class PerStepModel(StateSpaceModel):
    """The same model with a sample site for each frame."""

    #: Whether a list of edges stays one. At one time there are few pairs: a matrix is faster.
    keeps_list = False

    def forward(self, batch: SwarmBatch) -> Tensor:
        """Score states and observations frame by frame."""
        inputs = batch.steps()
        inputs = inputs if self.keeps_list else inputs.dense()
        with pyro.plate("windows", len(batch), dim=-1):
            first = self.initial().expand([len(batch), batch.num_individuals]).to_event(1)
            state = pyro.sample("state_0", first)
            for t in pyro.markov(range(batch.num_times)):
                if t > 0:
                    position, velocity = state[..., :SPACE], state[..., SPACE:]
                    law = self.transition.velocity(position, velocity, inputs.at(t - 1))
                    velocity = pyro.sample(f"velocity_{t}", law.to_event(1))
                    state = torch.cat([position + STEP * velocity, velocity], -1)
                emitted = self.emission(state).mask(batch.mask[:, t]).to_event(1)
                pyro.sample(f"observation_{t}", emitted, obs=batch.observations[:, t])
        return state


class PerStepGuide(SmoothingGuide):
    """The same guide with a sample site for each frame."""

    def forward(self, batch: SwarmBatch) -> None:
        """Draw states frame by frame."""
        posterior = Posterior(self, batch)
        later = posterior.later
        with pyro.plate("windows", len(batch), dim=-1):
            pyro.sample("state_0", posterior.first.to_event(2))
            for t in pyro.markov(range(1, batch.num_times)):
                step = dist.Normal(later.loc[:, t - 1], later.scale[:, t - 1])
                pyro.sample(f"velocity_{t}", step.to_event(2))


class Library:
    """Model and guide as the library has them, with weights that are not all zero."""

    def __init__(
        self, scales: Scales, options: argparse.Namespace, *, per_step: bool = False
    ) -> None:
        torch.manual_seed(0)
        noise = PyroParam(torch.tensor(NOISE), constraint=constraints.positive)
        kind, guide = (
            (PerStepModel, PerStepGuide) if per_step else (StateSpaceModel, SmoothingGuide)
        )
        self.model = kind(
            InitialStates.for_scales(scales),
            GraphTransition(scales, width=options.width),
            PositionEmission(SPACE, noise),
        )
        self.guide = guide(self.model, hidden=options.hidden)
        with torch.no_grad():
            for parameter in [*self.model.parameters(), *self.guide.parameters()]:
                if parameter.dim() > 1 and not parameter.any():
                    parameter.normal_(0.0, 0.01)

    def loss(self) -> Callable[[SwarmBatch], Tensor]:
        """Return the negative ELBO as a module."""
        module: Callable[[SwarmBatch], Tensor] = Trace_ELBO()(self.model, self.guide)
        return module


class ByHand:
    """The ELBO as plain torch formulas."""

    def __init__(self, library: Library) -> None:
        self.library = library

    def __call__(self, batch: SwarmBatch) -> Tensor:
        """Return the negative ELBO."""
        states, log_q = self.library.guide.path(batch, {})
        return -(self.density(batch, states) - log_q).sum()

    def density(self, batch: SwarmBatch, states: Tensor) -> Tensor:
        """Return the model's log-density of states and observations, ``(batch,)``."""
        model = self.library.model
        initial = model.initial
        scale = initial.scale
        off = (states[:, 0] - initial.mean) / scale
        total = -(0.5 * off.square() + scale.log() + HALF_LOG_TWO_PI).sum((-1, -2))
        before = states[:, :-1]
        law = model.transition.velocity(
            before[..., :SPACE], before[..., SPACE:], batch.steps()
        ).base_dist
        scale = law.scale
        off = (states[:, 1:, :, SPACE:] - law.loc) / scale
        total = total - (0.5 * off.square() + scale.log() + HALF_LOG_TWO_PI).sum((-1, -2, -3))
        noise = model.emission.noise
        off = (batch.observations - states[..., :SPACE]) / noise
        return total - (0.5 * off.square() + noise.log() + HALF_LOG_TWO_PI).sum((-1, -2, -3))


def check(batch: SwarmBatch, options: argparse.Namespace) -> None:
    """Stop if the three do not agree for the same draws, in float64."""
    torch.set_default_dtype(torch.float64)
    try:
        graph = batch.adjacency
        if isinstance(graph, Tensor):
            graph = graph.double()
        batch = SwarmBatch.of(batch.observations.double(), batch.mask, graph)
        scales = scales_for(batch)
        compare(Library(scales, options), Library(scales, options, per_step=True), batch)
    finally:
        torch.set_default_dtype(torch.float32)


@torch.no_grad()
def compare(library: Library, each: Library, batch: SwarmBatch) -> None:
    """Stop if the three do not agree."""
    torch.manual_seed(1)
    drawn = poutine.trace(library.guide).get_trace(batch)
    scored = poutine.trace(poutine.replay(library.model, trace=drawn)).get_trace(batch)
    log_q = drawn.log_prob_sum()
    own = scored.log_prob_sum() - log_q
    states = drawn.nodes["states"]["value"]
    values = {"state_0": states[:, 0]}
    values |= {f"velocity_{t}": states[:, t, :, SPACE:] for t in range(1, batch.num_times)}
    sums = [
        poutine.trace(poutine.condition(side, data=values)).get_trace(batch).log_prob_sum()
        for side in (each.model, each.guide)
    ]
    torch.manual_seed(1)
    by_hand = -ByHand(library)(batch)
    for name, value in (("per step", sums[0] - sums[1]), ("by hand", by_hand)):
        off = float((value - own).abs() / log_q.abs())
        if not off < TOLERANCE:
            raise SystemExit(f"library {own}, {name} {value}: they differ by {off:.1e}")


class Contestant:
    """One way to take steps, with weights and an optimiser of its own."""

    def __init__(self, loss: Callable[[SwarmBatch], Tensor], library: Library) -> None:
        self.loss, self.seconds = loss, list[float]()
        self.parameters = [*library.model.parameters(), *library.guide.parameters()]
        self.optimizer = torch.optim.Adam(self.parameters, lr=1e-3, fused=True)

    def step(self, batch: SwarmBatch, clock: Callable[[], float]) -> None:
        """Take a step and note its time."""
        began = clock()
        self.optimizer.zero_grad()
        self.loss(batch).backward()
        self.optimizer.step()
        self.seconds.append(clock() - began)

    def median(self) -> float:
        """Return the median time of a step; the first two are left out."""
        return statistics.median(self.seconds[2:])


def contestants(
    scales: Scales, batch: SwarmBatch, options: argparse.Namespace, names: list[str]
) -> dict[str, Contestant]:
    """Return the ways to take steps, all with equal weights."""
    if len(names) > 1:
        check(batch, options)
    made = {}
    for name in names:
        own = Library(scales, options, per_step=name == "per step")
        if name in ("library", "per step"):
            loss = own.loss()
        elif name == "by hand":
            loss = ByHand(own)
        else:
            compile_parts(own)
            loss = own.loss()
        made[name] = Contestant(loss, own)
    return made


def compile_parts(library: Library) -> None:
    """Compile the network of the model."""
    library.model.transition.network.compile()


def has_compiler() -> bool:
    """Return whether there is a C++ compiler for ``torch.compile``."""
    return any(shutil.which(name) for name in (os.environ.get("CXX", ""), "g++", "clang++") if name)


def race(batch: SwarmBatch, options: argparse.Namespace, names: list[str]) -> dict[str, float]:
    """Return the median seconds of a step of each, taken in turn."""
    clock = time.process_time if options.threads == 1 else time.perf_counter
    entered = contestants(scales_for(batch), batch, options, names)
    for _ in range(options.rounds + 2):
        for contestant in entered.values():
            contestant.step(batch, clock)
    return {name: contestant.median() for name, contestant in entered.items()}


def machine() -> str:
    """Return cores and processor."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{os.cpu_count()} cores, {names[0] if names else platform.machine()}"


def main() -> None:
    """Check that all compute the same, time them in turn, print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--individuals", type=int, default=10)
    parser.add_argument("--batch", type=int, nargs="+", default=[4, 16])
    parser.add_argument("--radius", type=float, default=1.0)
    parser.add_argument("--width", type=int, default=64, help="of the transition's network")
    parser.add_argument("--hidden", type=int, default=32, help="width of the guide's network")
    parser.add_argument("--list", action="store_true", help="the graph as a list of edges")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--scaling", action="store_true", help="time over the number of steps")
    parser.add_argument("--no-compile", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    versions = (
        f"swarmssm {swarmssm.__version__}, torch {torch.__version__}, pyro {pyro.__version__}"
    )
    print(f"{datetime.now(UTC):%Y-%m-%d}; {machine()}; {versions}")
    print(
        f"{options.individuals} individuals, radius {options.radius}, "
        f"{'list of edges' if options.list else 'matrix'}, widths {options.width} and "
        f"{options.hidden}; {options.rounds} rounds, {options.threads} threads, "
        f"{'processor' if options.threads == 1 else 'wall'} time"
    )
    print()
    if options.scaling:
        show_scaling(options)
        return
    names = ["library", "per step", "by hand"]
    names += ["compiled"] if has_compiler() and not options.no_compile else []
    print("| batch | " + " | ".join(f"{name}, ms" for name in names) + " | per step / library |")
    print("|---" * (len(names) + 2) + "|")
    for size in options.batch:
        batch = windows(size, options.steps, options.individuals, options.radius, options.list)
        seconds = race(batch, options, names)
        row = " | ".join(f"{1e3 * seconds[name]:.1f}" for name in names)
        ratio = seconds["per step"] / seconds["library"]
        print(f"| {size} | {row} | {ratio:.1f} |", flush=True)
        own = seconds["library"] / seconds["by hand"]
        print(f"library / by hand: {own:.2f}")
        if "compiled" in seconds:
            print(f"compiled / by hand: {seconds['compiled'] / seconds['by hand']:.2f}")


def show_scaling(options: argparse.Namespace) -> None:
    """Print the time of a step for windows of many lengths, and the fitted exponent."""
    lengths = [50, 100, 200, 400, 800, 1600]
    print("| steps | " + " | ".join(f"batch {size}, ms" for size in options.batch) + " |")
    print("|---" * (len(options.batch) + 1) + "|")
    table: dict[int, list[float]] = {size: [] for size in options.batch}
    for steps in lengths:
        for size in options.batch:
            batch = windows(size, steps, options.individuals, options.radius, options.list)
            table[size].append(race(batch, options, ["library"])["library"])
        row = " | ".join(f"{1e3 * table[size][-1]:.1f}" for size in options.batch)
        print(f"| {steps} | {row} |", flush=True)
    for size in options.batch:
        exponent = np.polyfit(np.log(lengths), np.log(table[size]), 1)[0]
        print(f"\nbatch {size}: fitted exponent of the time in the number of steps {exponent:.2f}")


if __name__ == "__main__":
    with quiet_pyro():
        main()
