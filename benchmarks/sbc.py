"""Simulation-based calibration of `boids` with the linearized guide.

    python benchmarks/sbc.py [--datasets 200] [--law smooth|full] [--start moving|scattered]
        [--frames 60] [--trials 1] [--path-draws 0] [--processes 2] [--out sbc.jsonl]

Flocks of 8 boids that see each other within 2, tracking noise of about 0.03, positions only. Truths
are drawn from the priors, first states included: gains are LogNormal about 0.6, 0.15, 0.8 and 0.5,
0.5 wide, noises 0.3. `smooth`: speed regulation; `full`: what `swarmssm fit --model boids` takes,
soft walls and hard limits of speed, all unknown. `moving`: a group that goes one way at about unit
speed; `scattered`: velocities about zero, in all directions, so that some stand still. A line
is written as each data set is finished; started again with the same `--out` it goes on. Prints the
table for RESULTS.md.
"""

import argparse
from pathlib import Path

import numpy as np

from swarmssm.analysis.diagnostics.sbc.study import sbc
from swarmssm.jobs import Progress

PRIORS = {
    "transition.cohesion_gain": "LogNormal(-0.511, 0.5)",
    "transition.separation_gain": "LogNormal(-1.897, 0.5)",
    "transition.alignment_gain": "LogNormal(-0.223, 0.5)",
    "emission.noise": "LogNormal(-3.507, 0.3)",
}
SMOOTH = {
    "transition.relaxation_gain": "LogNormal(-0.693, 0.5)",
    "transition.process_noise": "LogNormal(-1.897, 0.3)",
}
#: First states: a group on its way, or one in which everybody goes another way.
STARTS = {
    "moving": {"initial.mean": [0.0, 0.0, 1.0, 0.0], "initial.scale": [1.2, 1.2, 0.3, 0.3]},
    "scattered": {"initial.scale": [1.0, 1.0, 0.7, 0.7]},
}


def say(counted: Progress) -> None:
    """Print how far it has come."""
    print(f"{counted.done} of {counted.total}, {counted.failed} failed", flush=True)


def main() -> None:
    """Run the data sets that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--datasets", type=int, default=200)
    parser.add_argument("--law", choices=["smooth", "full"], default="smooth")
    parser.add_argument("--start", choices=list(STARTS), default="moving")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--trials", type=int, default=1)
    parser.add_argument("--path-draws", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("sbc.jsonl"))
    parser.add_argument("--dataset", type=Path, help="NetCDF file of the result")
    options = parser.parse_args()
    smooth = {
        "walls": False,
        "limits": False,
        "relaxation": True,
        "noise": "additive",
        "priors": {**STARTS[options.start], "preferred_speed": 1.0},
    }
    own = smooth if options.law == "smooth" else {"priors": STARTS[options.start]}
    calibration = sbc(
        "boids",
        "linearized",
        datasets=options.datasets,
        frames=options.frames,
        trials=options.trials,
        path_draws=options.path_draws,
        spread=0.3,
        seed=options.seed,
        processes=options.processes,
        out=options.out,
        resume=True,
        progress=say,
        model_options={**own, "edges": "radius:2.0"},
        priors={**PRIORS, **(SMOOTH if options.law == "smooth" else {})},
    )
    print(f"\n{calibration.verdict()}\n")
    found = calibration.data
    print("| | in the band | p | 50 % | 80 % | 90 % | 95 % | mean z | sd / truth |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in found["parameter"].values:
        one = found.sel(parameter=name)
        cells = ["yes" if one["passes"] else "no", f"{float(one['p_value']):.3f}"]
        cells += [f"{value:.2f}" for value in one["coverage"].values]
        cells.append(f"{float(((one['mean'] - one['truth']) / one['sd']).mean()):+.2f}")
        cells.append(f"{np.median(one['sd'] / np.abs(one['truth'])):.3f}")
        print(f"| {name} | {' | '.join(cells)} |")
    failures = found.attrs["failures"] or "none failed"
    print(f"\n{float(found['seconds'].mean()):.1f} s a fit; {failures}")
    if options.dataset:
        found.to_netcdf(options.dataset, engine="h5netcdf")


if __name__ == "__main__":
    main()
