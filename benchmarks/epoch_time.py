"""How long an epoch of the thesis's network takes: scored in one call, or one graph at a time.

Both sides train the same network from the same weights on the same recording, with the same
optimiser and number of threads:

*batched*
    ``swarmssm.inference.fit`` with one batch of the whole recording: Pyro's ``Trace_ELBO`` scores
    all steps in one call.
*loop*
    The epoch as section 3.7 of the thesis has it: each graph passes through the network by itself,
    the losses of all graphs are averaged, and one backward pass and one step of Adam follow. It is
    written in plain torch and without Pyro, normalises a graph once and not in each of its four
    convolutions, and takes sums where it can, so that it is not made slow.

Before anything is timed, both must give the same loss and gradient with the same noise. Epochs are
then taken in turn, A B A B, so that a busy machine slows both; the first of each is left out.

    python benchmarks/epoch_time.py --individuals 10 --steps 1000 --rounds 9 --threads 1
"""

import argparse
import copy
import math
import os
import platform
import statistics
import time
from datetime import UTC, datetime
from pathlib import Path

import pyro
import torch
from pyro.infer import Trace_ELBO
from torch.nn.functional import binary_cross_entropy_with_logits

import swarmssm
from swarmssm.graphs import normalized_adjacency
from swarmssm.inference import FitSettings, GraphEncoderGuide, fit
from swarmssm.inference.data import preparation_for, prepare
from swarmssm.inference.run_folder import build_modules
from swarmssm.inference.training import quiet_pyro
from swarmssm.models import GraphVAE, SwarmBatch
from swarmssm.simulate import simulate_boids

#: Relative difference allowed between the two losses, and between the two gradients (norm of the
#: difference over the norm): float32 keeps seven digits, and some ten thousand terms are added in
#: another order.
TOLERANCE = 1e-4
HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)


def loop_loss(
    model: GraphVAE, guide: GraphEncoderGuide, batch: SwarmBatch, noise: torch.Tensor | None = None
) -> torch.Tensor:
    """Return the negative ELBO per observed coordinate, one graph after the other.

    Parameters
    ----------
    model, guide
        The network.
    batch
        One window in which all individuals are always seen.
    noise
        ``(time - 1, individual, latent)``; drawn if absent.
    """
    observations, adjacency = batch.observations[0], batch.adjacency[0]
    individuals = observations.shape[1]
    apart = 1.0 - torch.eye(individuals)
    losses = []
    for t in range(len(observations) - 1):
        graph, normalized = adjacency[t], normalized_adjacency(adjacency[t])
        hidden = guide.gated(observations[t], graph)
        hidden = guide.second(hidden, normalized).tanh()
        hidden = guide.third(hidden, normalized).tanh()
        mean = guide.mean(hidden, normalized)
        log_variance = guide.log_variance(hidden, normalized).clamp(-20.0, 10.0)
        drawn = torch.randn_like(mean) if noise is None else noise[t]
        latent = mean + (0.5 * log_variance).exp() * drawn
        # log q(z) - log p(z): the constants cancel, and the first square is that of the noise.
        divergence = 0.5 * (latent.square() - drawn.square() - log_variance).sum()
        off = (observations[t + 1] - model.decoder(latent)) / model.log_scale.exp()
        states = 0.5 * off.square().sum() + individuals * model.log_scale.sum()
        edges = binary_cross_entropy_with_logits(
            latent @ latent.T, adjacency[t + 1], weight=apart, reduction="sum"
        )
        losses.append(divergence + states + edges)
    features = observations.shape[-1]
    each = torch.stack(losses).mean() / (individuals * features)
    return each + HALF_LOG_TWO_PI


def compare(batch: SwarmBatch, settings: FitSettings) -> tuple[float, float]:
    """Return the relative differences of loss and gradient under the same noise."""
    torch.manual_seed(settings.seed)
    model, guide = build_modules(settings, batch.observations.shape[-1])
    twins = copy.deepcopy(model), copy.deepcopy(guide)
    _, steps, individuals, features = batch.observations[:, 1:].shape
    torch.manual_seed(1)
    with quiet_pyro():
        batched = Trace_ELBO()(model, guide)(batch) / (steps * individuals * features)
    batched.backward()
    torch.manual_seed(1)
    noise = torch.randn(1, steps, individuals, model.latent_dim)[0]
    looped = loop_loss(*twins, batch, noise)
    looped.backward()
    gradients = [
        torch.cat([p.grad.flatten() for part in pair for p in part.parameters()])
        for pair in ((model, guide), twins)
    ]
    difference = (gradients[0] - gradients[1]).norm() / gradients[1].norm()
    losses = batched.item(), looped.item()
    return abs(losses[0] - losses[1]) / abs(losses[1]), float(difference)


class Loop:
    """The loop's own training, one epoch at a time."""

    def __init__(self, batch: SwarmBatch, settings: FitSettings) -> None:
        torch.manual_seed(settings.seed)
        self.batch, self.settings = batch, settings
        self.network = build_modules(settings, batch.observations.shape[-1])
        self.parameters = [p for part in self.network for p in part.parameters()]
        self.optimizer = torch.optim.Adam(self.parameters, lr=settings.lr)

    def epoch(self) -> float:
        """Take one epoch; return its seconds."""
        began = time.perf_counter()
        self.optimizer.zero_grad(set_to_none=True)
        loss_of(self.network, self.batch).backward()
        torch.nn.utils.clip_grad_norm_(self.parameters, self.settings.clip)
        self.optimizer.step()
        return time.perf_counter() - began


def loss_of(network: tuple[GraphVAE, GraphEncoderGuide], batch: SwarmBatch) -> torch.Tensor:
    """Return the loss of the loop as it is timed: it draws its own noise."""
    return loop_loss(*network, batch)


class Turns:
    """Takes an epoch of the loop after each epoch of the fit, and times both."""

    def __init__(self, loop: Loop) -> None:
        self.loop, self.batched, self.looped = loop, [], []
        self.resumed: float | None = None

    def __call__(self, progress: object) -> None:
        """Note the time since the last call; what came before the first was also preparation."""
        if self.resumed is not None:
            self.batched.append(time.perf_counter() - self.resumed)
            self.looped.append(self.loop.epoch())
        else:
            self.loop.epoch()
        self.resumed = time.perf_counter()


def machine() -> str:
    """Return cores and processor."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        model = names[0] if names else model
    return f"{os.cpu_count()} cores, {model}"


def main() -> None:
    """Check that both sides compute the same, time them in turn, print a section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--individuals", type=int, default=10)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    tracks = simulate_boids(individuals=options.individuals, steps=options.steps + 1, seed=0)
    # The last row of the history is written in an epoch of its own, which is not timed.
    epochs = options.rounds + 2
    settings = FitSettings(
        window=None,
        batch_windows=None,
        epochs=epochs,
        validate_every=epochs,
        fractions=(1.0, 0.0, 0.0),
    )
    preparation, training = preparation_for(
        tracks, scaler=settings.scaler, graph=settings.graph, velocity=settings.velocity
    )
    batch = prepare(training, preparation).batch()
    if not batch.mask.all():
        raise SystemExit("the loop takes it that everybody is always seen")
    loss_off, gradient_off = compare(batch, settings)
    if not max(loss_off, gradient_off) < TOLERANCE:
        raise SystemExit(f"the sides differ: loss {loss_off:.1e}, gradient {gradient_off:.1e}")
    turns = Turns(Loop(batch, settings))
    fit(tracks=tracks, callbacks=[turns], **settings.model_dump())
    batched, looped = turns.batched[: options.rounds], turns.looped[: options.rounds]
    ratios = [b / a for a, b in zip(batched, looped, strict=True)]
    versions = (
        f"swarmssm {swarmssm.__version__}, torch {torch.__version__}, pyro {pyro.__version__}, "
        f"Python {platform.python_version()}"
    )
    print(f"{datetime.now(UTC):%Y-%m-%d}; {machine()}; {versions}")
    print(f"{options.individuals} individuals, {options.steps} steps, {options.rounds} rounds")
    print(f"relative difference of loss {loss_off:.1e}, of gradient {gradient_off:.1e}")
    print()
    print("| threads | batched, ms | loop, ms | ratio, median | ratio, least to most |")
    print("|---|---|---|---|---|")
    print(
        f"| {options.threads} | {1e3 * statistics.median(batched):.1f} "
        f"| {1e3 * statistics.median(looped):.0f} | {statistics.median(ratios):.0f} "
        f"| {min(ratios):.0f} to {max(ratios):.0f} |"
    )


if __name__ == "__main__":
    main()
