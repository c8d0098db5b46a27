"""Coverage of 90 % intervals: many simulated data sets, the truth drawn from the prior.

    python benchmarks/calibration.py [--datasets 100] [--truth prior|fixed]
        [--method iterated|extended] [--given 15] [--processes 2] [--out calibration.jsonl]

Each data set is 3 flocks of 10 boids x 150 frames with tracking noise. A row of results is written
as each is finished; started again with the same `--out`, those that are there are not done again.
Beside the posterior stand the regression on finite differences, and that on the exact states: what
finite data leave open even where nothing is hidden. With `--given 0` all frames are scored, those
too whose likelihood hangs on the prior of first states, which no simulated flock follows.
"""

import argparse
import json
import multiprocessing
import time
from pathlib import Path

import numpy as np
import torch
from flocks import (
    GAINS,
    TRUTH,
    draw_truth,
    exact_states,
    finite_differences,
    flock_model,
    simulate,
    windows,
)

FLOCKS, FRAMES = 3, 150
Z90 = 1.6448536269514722


def one(job: tuple[int, str, str, int]) -> dict[str, object]:
    """Fit one data set."""
    from swarmssm.inference.laplace_method import laplace

    torch.set_num_threads(1)
    seed, kind, method, given = job
    truth = TRUTH if kind == "fixed" else draw_truth(seed)
    tracks = simulate(truth, seed, FLOCKS, FRAMES)
    began = time.process_time()
    found = laplace(flock_model(), windows(tracks), method=method, given=given)
    seconds = time.process_time() - began
    deviation = found.scale_tril.square().sum(-1).sqrt()
    scores = {
        name: float((found.loc[index] - np.log(truth[name])) / deviation[index])
        for index, name in enumerate(found.names)
    }
    others = {}
    for label, fit in (("differences", finite_differences), ("exact", exact_states)):
        gains, errors, _ = fit(tracks)
        others[label] = {
            name: float((gain - truth[name]) / error)
            for name, gain, error in zip(GAINS, gains, errors, strict=True)
        }
    return {
        "seed": seed,
        "seconds": seconds,
        "truth": truth,
        "values": {name: float(value) for name, value in found.values.items()},
        "scores": scores,
        **others,
    }


def table(rows: list[dict[str, dict[str, float]]]) -> None:
    """Print coverage and mean score of each parameter."""
    number = len(rows)
    print(f"\n{number} data sets; coverage of 90 % intervals, and mean of (estimate - truth) / sd")
    print(f"standard error of a coverage: {np.sqrt(0.09 / number):.3f}")
    print(f"{'':28s} posterior        exact states     finite differences")
    for name in TRUTH:
        columns = []
        for label in ("scores", "exact", "differences"):
            if name not in rows[0][label]:
                columns.append("   -            ")
                continue
            z = np.array([row[label][name] for row in rows])
            columns.append(f"{np.mean(np.abs(z) < Z90):.2f}  ({np.mean(z):+7.2f}) ")
        print(f"{name:28s} {' '.join(columns)}")


def main() -> None:
    """Run the data sets that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--datasets", type=int, default=100)
    parser.add_argument("--truth", choices=["prior", "fixed"], default="prior")
    parser.add_argument("--method", choices=["iterated", "extended"], default="iterated")
    parser.add_argument("--given", type=int, default=15, help="frames that are not scored")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("calibration.jsonl"))
    options = parser.parse_args()
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    rows = [json.loads(line) for line in lines]
    done = {row["seed"] for row in rows}
    jobs = [
        (seed, options.truth, options.method, options.given)
        for seed in range(options.datasets)
        if seed not in done
    ]
    context = multiprocessing.get_context("spawn")
    began = time.perf_counter()
    with context.Pool(options.processes) as pool, options.out.open("a") as file:
        for row in pool.imap_unordered(one, jobs):
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(f"{len(rows)} of {options.datasets}, {row['seconds']:.0f} s", flush=True)
    print(f"{time.perf_counter() - began:.0f} s in all")
    table(rows)


if __name__ == "__main__":
    main()
