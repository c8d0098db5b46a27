"""Is a planted leader found, and nobody where there is none? Many simulated swarms.

    python benchmarks/planted_leader.py [--swarms 100] [--kinds leader,equals,two,loner]
        [--processes 1] [--rate 0.05] [--out planted_leader.jsonl]

Each swarm is six boids in three trials of 50 frames (0.1 s apart) between soft walls, of which
positions are seen with noise of 0.03. In a swarm of the kind `leader` one individual, another in
each swarm, counts three times for all others and heeds nobody; of `equals` all count 1; of `two`
two count three times; of `loner` one neither moves the others nor is moved by them. All are fitted
alike: a kernel transition with a weight of influence and one of responsiveness for each
individual, LogNormal(0, 0.5), by Laplace's method. A row of results is written as each swarm is
finished; started again with the same `--out`, those that are there are not done again.
"""

import argparse
import json
import math
import multiprocessing
import time
from pathlib import Path

import numpy as np
import pyro.distributions as dist
import torch
import xarray as xr
from flocks import DT, SPEED, TRUTH, prior, windows

from swarmssm.models import InitialStates, LatentEdges, PositionEmission, StateSpaceModel
from swarmssm.models.transitions import KernelTransition, PowerBasis
from swarmssm.simulate import simulate_boids
from swarmssm.simulate.attention import planted_attention

NUMBER, TRIALS, FRAMES = 6, 3, 50
HALF_WIDTH, STRENGTH, UNLIKE = 1.5, 3.0, 0.5
#: Frames whose likelihood hangs on the prior of first states.
GIVEN = 5
SAMPLES = 20_000
#: Where the maximum is sought from, to save time: the boids law with the gains of `flocks.py`, the
#: kernels of which, by powers 1 and -1, are 0.6 r - 5 * 0.15 / r and 0.8.
START = {
    "transition.attraction": torch.tensor([0.6, -0.75], dtype=torch.float64),
    "transition.alignment": torch.tensor([0.6, 0.1], dtype=torch.float64),
}
WEIGHTS = ("transition.influence", "transition.responsiveness")
HEADS = ("each: right / wrong", "rest: right / wrong", "loner: right / wrong")
KINDS = ("leader", "equals", "two", "loner")


def attention(kind: str, seed: int) -> np.ndarray:
    """Return who heeds whom; the special one is `seed % NUMBER`."""
    place = seed % NUMBER
    if kind == "leader":
        return planted_attention(NUMBER, leader=place, strength=STRENGTH)
    if kind == "loner":
        return planted_attention(NUMBER, isolated=place)
    weights = planted_attention(NUMBER)
    if kind == "two":
        weights[:, [place, (place + 1) % NUMBER]] = STRENGTH
    return weights


def simulate(kind: str, seed: int) -> xr.Dataset:
    """Simulate a swarm: boids with the gains of `flocks.py`, all in sight of all."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    position = rng.uniform(-1.2, 1.2, (TRIALS, NUMBER, 2))
    heading = rng.uniform(0.0, 2.0 * np.pi, (TRIALS, 1)) + rng.uniform(-0.8, 0.8, (TRIALS, NUMBER))
    own = {k.split(".")[1]: v for k, v in TRUTH.items() if k.startswith("transition.")}
    return simulate_boids(
        NUMBER,
        FRAMES,
        TRIALS,
        dt=DT,
        graph="complete",
        preferred_speed=SPEED,
        wall_gain=1.0,
        half_width=HALF_WIDTH,
        min_speed=0.0,
        max_speed=math.inf,
        noise="additive",
        observation_noise=TRUTH["emission.noise"],
        attention=attention(kind, seed),
        seed=1000 * KINDS.index(kind) + seed,
        initial_position=position,
        initial_velocity=np.stack([np.cos(heading), np.sin(heading)], -1),
        **own,
    )


def weighted_model() -> StateSpaceModel:
    """Return kernels in the powers 1 and -1 of distance, and weights of individuals.

    With all in sight of all, the number of neighbours is the same everywhere, and the sum over
    them of the boids law is a mean.
    """
    whole = {"dtype": torch.float64}
    kernel = dist.Normal(torch.zeros(2, **whole), 2.0).to_event(1)
    weights = dist.LogNormal(torch.zeros(NUMBER, **whole), UNLIKE).to_event(1)
    transition = KernelTransition(
        2,
        DT,
        basis=PowerBasis((1.0, -1.0)),
        attraction=kernel,
        alignment=kernel,
        influence=weights,
        responsiveness=weights,
        process_noise=prior("transition.process_noise"),
        relaxation_gain=prior("transition.relaxation_gain"),
        preferred_speed=SPEED,
        wall_gain=dist.LogNormal(torch.zeros((), **whole), 0.5),
        half_width=HALF_WIDTH,
    )
    return StateSpaceModel(
        InitialStates(torch.zeros(4, **whole), torch.tensor([2.0, 2.0, 1.0, 1.0], **whole)),
        transition,
        PositionEmission(2, prior("emission.noise")),
        LatentEdges("complete"),
    ).double()


def one(job: tuple[str, int]) -> dict[str, object]:
    """Fit one swarm."""
    from swarmssm.inference.laplace_method import laplace

    torch.set_num_threads(1)
    kind, seed = job
    tracks = simulate(kind, seed)
    began = time.process_time()
    model = weighted_model()
    found = laplace(model, windows(tracks), given=GIVEN, start=START)
    seconds = time.process_time() - began
    # The weights are positive, and so their logarithms are what is normal.
    place, rows = 0, []
    for name, value in found.values.items():
        if name in WEIGHTS:
            rows.extend(range(place, place + NUMBER))
        place += value.numel()
    covariance = (found.scale_tril @ found.scale_tril.T)[rows][:, rows]
    return {
        "kind": kind,
        "seed": seed,
        "seconds": seconds,
        "place": seed % NUMBER,
        "mean": found.loc[rows].tolist(),
        "covariance": covariance.tolist(),
        "rounds": found.rounds,
    }


def decide(row: dict[str, object], rate: float) -> dict[str, object]:
    """Return what is declared of a swarm: the leader by either rule, and loners."""
    from swarmssm.analysis.interpretation.influence.leaders import find_isolated, find_leader
    from swarmssm.analysis.interpretation.influence.weights import label_weights

    rng = np.random.default_rng(row["seed"])
    drawn = np.exp(rng.multivariate_normal(row["mean"], row["covariance"], SAMPLES))
    names = [str(place) for place in range(NUMBER)]
    dataset = label_weights(drawn[:, :NUMBER], drawn[:, NUMBER:], names)
    found = {rule: find_leader(dataset, rate, against=rule) for rule in ("each", "rest")}
    isolated = find_isolated(dataset, rate)
    return {
        "each": found["each"].attrs["leader"],
        "rest": found["rest"].attrs["leader"],
        "isolated": isolated.attrs["isolated"],
        "named": str(row["place"]),
    }


def table(rows: list[dict[str, object]], rate: float) -> None:
    """Print how often a leader was declared, and rightly."""
    print(f"\nrate of false alarms asked for: {rate:g}")
    heads = ("swarms", "number", *HEADS, "s")
    print(f"| {' | '.join(heads)} |")
    print("|---" * len(heads) + "|")
    for kind in KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        if not mine:
            continue
        decided = [decide(row, rate) for row in mine]
        cells = []
        for rule in ("each", "rest"):
            right = sum(kind == "leader" and d[rule] == d["named"] for d in decided)
            declared = sum(d[rule] != "" for d in decided)
            cells.append(f"{right} / {declared - right}")
        right = sum(kind == "loner" and d["isolated"] == d["named"] for d in decided)
        declared = sum(d["isolated"] != "" for d in decided)
        cells.append(f"{right} / {declared - right}")
        seconds = np.mean([row["seconds"] for row in mine])
        print(f"| {kind} | {len(mine)} | {' | '.join(cells)} | {seconds:.0f} |")


def main() -> None:
    """Run the swarms that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--swarms", type=int, default=100, help="of each kind")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--rate", type=float, default=0.05)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("planted_leader.jsonl"))
    options = parser.parse_args()
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    rows = [json.loads(line) for line in lines]
    done = {(row["kind"], row["seed"]) for row in rows}
    jobs = [
        (kind, seed)
        for seed in range(options.swarms)
        for kind in options.kinds.split(",")
        if (kind, seed) not in done
    ]
    context = multiprocessing.get_context("spawn")
    began = time.perf_counter()
    with context.Pool(options.processes) as pool, options.out.open("a") as file:
        for row in pool.imap_unordered(one, jobs):
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(f"{len(rows)}: {row['kind']} {row['seed']}, {row['seconds']:.0f} s", flush=True)
    print(f"{time.perf_counter() - began:.0f} s in all")
    table(rows, options.rate)


if __name__ == "__main__":
    main()
