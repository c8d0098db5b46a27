"""Whether posterior predictive checks say what they should: of right models, and of a wrong one.

    python benchmarks/predictive_checks.py known [--datasets 200] [--steps 60]
        [--statistics a,b] [--out known.jsonl]
    python benchmarks/predictive_checks.py refit [--datasets 20] [--out refit.jsonl]
    python benchmarks/predictive_checks.py wrong [--draws 300]

`known`: flocks of 8 boids, 80 frames, seen with noise, are simulated from a model and checked
against that model itself at its true parameters, 99 replicates each. p-values are then uniform, if
recording and replicates are exchangeable; each data set starts from its own filtered state. With
`--steps 20` three runs follow each other, where uniformity is nearly, not exactly, true. `refit`:
the same with the parameters drawn from their priors and fitted to the first 70 % of 200 frames;
checked on the rest. `wrong`: a Vicsek swarm fitted by boids. A line is written as each data set
is finished; started again with the same `--out` it goes on. Prints the tables for RESULTS.md.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import xarray as xr
from scipy import stats

from swarmssm import inference, simulate
from swarmssm.analysis.diagnostics.checks import check
from swarmssm.analysis.diagnostics.checks.p_values import judge
from swarmssm.analysis.diagnostics.sbc.simulated import (
    FixedModel,
    SimulatedData,
    standard_scales,
)
from swarmssm.inference import Fit
from swarmssm.inference.data import preparation_for
from swarmssm.inference.run_folder import Builders, build_modules
from swarmssm.inference.settings import settings_from
from swarmssm.tracks.splits import split

INDIVIDUALS = 8
LAW = {"walls": False, "limits": False, "relaxation": True, "noise": "additive"}
START = {"initial.mean": [0.0, 0.0, 1.0, 0.0], "initial.scale": [1.2, 1.2, 0.3, 0.3]}
TRUTH = {
    "preferred_speed": 1.0,
    "cohesion_gain": 0.6,
    "separation_gain": 0.15,
    "alignment_gain": 0.8,
    "relaxation_gain": 0.5,
    "process_noise": 0.15,
    "emission.noise": 0.03,
}
PRIORS = {
    "transition.cohesion_gain": "LogNormal(-0.511, 0.5)",
    "transition.separation_gain": "LogNormal(-1.897, 0.5)",
    "transition.alignment_gain": "LogNormal(-0.223, 0.5)",
    "transition.relaxation_gain": "LogNormal(-0.693, 0.5)",
    "transition.process_noise": "LogNormal(-1.897, 0.3)",
    "emission.noise": "LogNormal(-3.507, 0.3)",
}


def known_fit(model: FixedModel, tracks: xr.Dataset) -> Fit:
    """Return a fit without anything fitted: the model as it is."""
    settings, own, guide = build_modules(
        settings_from({"model": "boids", "guide": "linearized"}),
        model.scales,
        Builders(model=model),
    )
    preparation, _ = preparation_for(
        tracks, scaler="none", graph="complete", velocity="auto", observes=own.observes
    )
    whole = split(tracks, "time", (1.0, 0.0, 0.0), 0)
    return Fit(own.eval(), guide.eval(), settings, model.scales, preparation, whole, pd.DataFrame())


def uniform_p_values(checked: xr.Dataset, seed: int) -> dict[str, float]:
    """Return p-values with ties broken, and the grid they lie on filled, at random.

    A p-value of D draws is a multiple of 1 / (D + 1), of a number of twice that.
    """
    rng = np.random.default_rng(seed)
    found = {}
    for name in checked["statistic"].to_numpy():
        if name == "bounds":
            continue
        own, drawn = checked[f"{name}_observed"], checked[f"{name}_replicated"]
        kind = own.attrs["kind"]
        values = [own.to_numpy(), drawn.to_numpy()]
        grid = 1.0 / (checked.sizes["draw"] + 1)
        size = 1e-9 * np.nanmax(np.abs(values[1]))
        values = [v + size * rng.uniform(size=v.shape) for v in values]
        grid *= 2.0 if kind == "number" else 1.0
        p_value = judge(kind, *values).p_value
        found[str(name)] = float(p_value - grid * rng.uniform())
    return found


def one_known(seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Simulate and check one data set at the true parameters."""
    model = FixedModel(
        "boids",
        standard_scales(INDIVIDUALS),
        {**LAW, "edges": "radius:2.0", "priors": {**START, **TRUTH}},
    )
    tracks, _, _ = SimulatedData(model, 80, INDIVIDUALS, 1).draw(seed)
    checked = check(
        known_fit(model, tracks),
        tracks,
        draws=options.draws,
        statistics=options.statistics,
        steps=options.steps,
        seed=seed + 1,
    ).data
    return line(seed, checked)


def one_refit(seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Draw parameters, simulate, fit to the first part and check on the rest."""
    model = FixedModel(
        "boids",
        standard_scales(INDIVIDUALS),
        {**LAW, "edges": "radius:2.0", "priors": {**START, "preferred_speed": 1.0}},
        PRIORS,
        0.3,
    )
    tracks, _, _ = SimulatedData(model, 200, INDIVIDUALS, 1).draw(seed)
    fitted = inference.fit(model, tracks, guide="linearized", seed=seed, fractions=(0.7, 0.0, 0.3))
    checked = check(fitted, tracks, draws=options.draws, part="test", seed=seed + 1).data
    return line(seed, checked)


def line(seed: int, checked: xr.Dataset) -> dict[str, Any]:
    """Return what is kept of a check."""
    return {
        "seed": seed,
        "p": uniform_p_values(checked, seed),
        "mismatch": int((checked["verdict"] == "mismatch").sum()),
        "diverged": int(checked["diverged"].sum()),
        "runs": checked.attrs["runs"],
    }


def many(options: argparse.Namespace) -> None:
    """Check the data sets that are missing, and print the table."""
    done = []
    if options.out.exists():
        done = [json.loads(text) for text in options.out.read_text().splitlines()]
    of = {"known": one_known, "refit": one_refit}[options.what]
    for seed in range(len(done), options.datasets):
        start = time.process_time()
        found = {**of(seed, options), "seconds": 0.0}
        found["seconds"] = time.process_time() - start
        done.append(found)
        with options.out.open("a") as file:
            file.write(json.dumps(found) + "\n")
        print(f"{len(done)} of {options.datasets}", flush=True)
    p_values = pd.DataFrame([found["p"] for found in done])
    print(f"\n{len(done)} data sets, {done[0]['runs']} runs each\n")
    print("| statistic | KS p | p < 0.05 | p < 0.01 |")
    print("|---|---|---|---|")
    tests = {name: stats.kstest(p_values[name].dropna(), "uniform").pvalue for name in p_values}
    for name, ks in tests.items():
        low, lower = ((p_values[name] < level).mean() for level in (0.05, 0.01))
        print(f"| {name} | {ks:.3f} | {low:.3f} | {lower:.3f} |")
    alarms = np.mean([found["mismatch"] > 0 for found in done])
    seconds = np.mean([found["seconds"] for found in done])
    print(f"\nleast KS p {min(tests.values()):.4f}; any mismatch in {alarms:.1%} of checks")
    print(f"diverged {sum(found['diverged'] for found in done)}; {seconds:.1f} CPU s each")


def wrong(options: argparse.Namespace) -> None:
    """Check boids that were fitted to a Vicsek swarm."""
    tracks = simulate.simulate_vicsek(
        individuals=15, steps=300, dt=1.0, speed=0.03, radius=1.0, box=None, process_noise=0.6,
        observation_noise=0.002, seed=3, burn_in=20,
    )  # fmt: skip
    tracks = tracks.drop_vars(["velocity", "adjacency"], errors="ignore")
    fitted = inference.fit("boids", tracks, guide="linearized", seed=0)
    result = check(fitted, tracks, draws=options.draws, part="test", seed=1)
    checked = result.data
    print("| statistic | p | corrected | verdict |")
    print("|---|---|---|---|")
    for name in checked["statistic"].to_numpy():
        one = checked.sel(statistic=name)
        cells = (f"{float(one[key]):.4f}" for key in ("p_value", "p_adjusted"))
        print(f"| {name} | {' | '.join(cells)} | {one['verdict'].item()} |")
    print(f"\n{int((checked['p_value'] < 0.01).sum())} statistics with p < 0.01")
    print(result.verdict())


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["known", "refit", "wrong"])
    parser.add_argument("--datasets", type=int)
    parser.add_argument("--draws", type=int)
    parser.add_argument("--steps", type=int, help="of a run; absent, the whole trial")
    parser.add_argument("--statistics", type=lambda text: text.split(","), help="of known alone")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.what == "wrong":
        options.draws = options.draws or 300
        wrong(options)
        return
    options.draws = options.draws or 99
    options.datasets = options.datasets or {"known": 200, "refit": 20}[options.what]
    options.out = options.out or Path(f"{options.what}.jsonl")
    many(options)


if __name__ == "__main__":
    main()
