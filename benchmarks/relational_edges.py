"""Does relational inference find the true edges? Springs, springs that switch, charges, and boids.

    OMP_NUM_THREADS=1 python benchmarks/relational_edges.py springs [--methods nri]
        [--seconds 900] [--trials 5000] [--seed 0] [--out edges.jsonl]

The first argument is one of

springs, charged
    Five particles, 49 frames 0.1 s apart, edges that last; tested on 1000 fresh simulations.
switching
    Springs that are drawn anew after every 12 frames.
boids
    Ten boids between soft walls: 14 trials of 1000 frames, tested on three. Edges are those of the
    radius graph, which is not told.

Each method learns for `--seconds` of processor time. Printed, and added to `--out`, are the share
of ordered pairs (and frames) whose type was found, the best over all ways to name the types; the
area under the ROC of the probability of an edge; the same of minus the distance alone; and of the
probabilities dealt anew to the pairs within each trial, the mean and range of 20 such deals.
"""

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sklearn.metrics import roc_auc_score

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.dnri import DynamicRelationalInference
from swarmssm.baselines.nri import NeuralRelationalInference, RecurrentRelationalInference
from swarmssm.simulate import simulate_boids, simulate_charged, simulate_springs
from swarmssm.tracks import states_of

METHODS = {
    method.name: method
    for method in (
        NeuralRelationalInference,
        RecurrentRelationalInference,
        DynamicRelationalInference,
    )
}
TESTED, HELD, DEALS = 1000, 200, 20
#: Frames in a trial that validates, to judge forecasts of 20 steps after a whole window.
LONGER = 70
PERIOD = 12
SYSTEMS = ("springs", "charged", "switching", "boids")


def recordings(system: str, trials: int, seed: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return states and true types ``(trial, time, individual, neighbor)`` of each part."""
    if system == "boids":
        parts = {"train": (14, 1000), "validation": (3, 1000), "test": (3, 1000)}
    else:
        parts = {"train": (trials, 49), "validation": (HELD, LONGER), "test": (TESTED, 49)}
    found = {}
    for count, (part, (number, frames)) in enumerate(parts.items()):
        drawn: dict[str, Any] = {"trials": number, "seed": 1000 * seed + count}
        if system == "boids":
            tracks = simulate_boids(10, frames, **drawn)
            kinds = tracks["adjacency"]
        else:
            simulate = simulate_charged if system == "charged" else simulate_springs
            period = PERIOD if system == "switching" else None
            tracks = simulate(5, frames, switch_every=period, **drawn)
            kinds = tracks["edge_type"]
        found[part] = states_of(tracks), kinds.to_numpy()
    return found


def pairs_alone(values: np.ndarray) -> np.ndarray:
    """Return ``(trial, time, pair, ...)`` of ``(trial, time, individual, neighbor, ...)``."""
    row, column = np.nonzero(~np.eye(values.shape[2], dtype=bool))
    return values[:, :, row, column]


def accuracy(truth: np.ndarray, kinds: np.ndarray, num_types: int) -> float:
    """Return the share of the right ones, under the best names for the types."""
    names = itertools.permutations(range(num_types))
    return max(float((np.array(name)[kinds] == truth).mean()) for name in names)


def rows(system: str, probabilities: np.ndarray, states: np.ndarray, kinds: np.ndarray) -> dict:
    """Return all scores of probabilities ``(trial, time or 1, individual, neighbor, type)``."""
    truth = pairs_alone(kinds)
    found = pairs_alone(np.broadcast_to(probabilities, (*kinds.shape, probabilities.shape[-1])))
    score = 1.0 - found[..., 0]
    half = states.shape[-1] // 2
    place = states[..., :half]
    apart = pairs_alone(np.linalg.norm(place[:, :, :, None] - place[:, :, None], axis=-1))
    if system in ("springs", "charged"):
        apart = np.broadcast_to(apart.mean(1, keepdims=True), apart.shape)
    random = np.random.default_rng(0)
    dealt = []
    for _ in range(DEALS):
        order = np.argsort(random.random((len(truth), 1, truth.shape[2])), axis=-1)
        dealt.append(roc_auc_score(truth.ravel(), np.take_along_axis(score, order, -1).ravel()))
    auc = roc_auc_score(truth.ravel(), score.ravel())
    return {
        "accuracy": accuracy(truth, found.argmax(-1), found.shape[-1]),
        "AUC": auc if system != "charged" else max(auc, 1.0 - auc),
        "AUC of distance": roc_auc_score(truth.ravel(), -apart.ravel()),
        "AUC dealt anew": float(np.mean(dealt)),
        "its range": [float(min(dealt)), float(max(dealt))],
        "share of edges": float(truth.mean()),
        "claimed": float((found.argmax(-1) > 0).mean()),
    }


def main() -> None:
    """Learn, score and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("system", choices=SYSTEMS)
    parser.add_argument("--methods", default="nri")
    parser.add_argument("--seconds", type=float, default=900.0)
    parser.add_argument("--trials", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    parts = recordings(chosen.system, chosen.trials, chosen.seed)
    fps = 10.0
    for name in chosen.methods.split(","):
        method = METHODS[name]()
        began = time.process_time()
        training = Training(parts["validation"][0], None, chosen.seconds, chosen.seed)
        method.learn(parts["train"][0], fps, training)
        learned = time.process_time() - began
        states, kinds = parts["test"]
        scores = rows(chosen.system, method.edge_probabilities(states, fps), states, kinds)
        row = {
            "system": chosen.system,
            "method": name,
            "trials": len(parts["train"][0]),
            "seconds": round(learned),
            "parameters": method.num_parameters,
            **scores,
        }
        cells = " | ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values())
        print("| " + " | ".join(row) + " |", f"| {cells} |", sep="\n", flush=True)
        if chosen.out is not None:
            with chosen.out.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
