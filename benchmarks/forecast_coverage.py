"""Whether forecast intervals hold what they promise, on data that the model itself has made.

    python benchmarks/forecast_coverage.py [--datasets 40] [--frames 150] [--origins 15]
        [--draws 100] [--out forecast_coverage.jsonl]

Flocks of 8 boids that see each other within 2 are drawn from the `boids` model: parameters from
their priors, first states, paths and sightings (tracking noise about 0.03) by them. The first 60 %
of the frames are fitted with the linearized guide, the rest are forecast, twice: by the fit, and by
a model that is told the true parameters (priors a ten-thousandth wide about them). Beside coverage
of the 50, 80 and 90 % intervals stands its standard error over data sets. A line is written as
each data set is finished; started again with the same `--out` it goes on.
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import torch

from swarmssm import inference
from swarmssm.analysis.diagnostics.sbc.simulated import (
    FixedModel,
    SimulatedData,
    standard_scales,
)
from swarmssm.analysis.scoring import score
from swarmssm.errors import WorkError

INDIVIDUALS = 8
HORIZONS = (1, 2, 5, 10, 20)
LEVELS = (0.5, 0.8, 0.9)
PRIORS = {
    "transition.cohesion_gain": "LogNormal(-0.511, 0.5)",
    "transition.separation_gain": "LogNormal(-1.897, 0.5)",
    "transition.alignment_gain": "LogNormal(-0.223, 0.5)",
    "transition.relaxation_gain": "LogNormal(-0.693, 0.5)",
    "transition.process_noise": "LogNormal(-1.897, 0.3)",
    "emission.noise": "LogNormal(-3.507, 0.3)",
}
OPTIONS = {
    "walls": False,
    "limits": False,
    "relaxation": True,
    "noise": "additive",
    "edges": "radius:2.0",
    "priors": {
        "initial.mean": [0.0, 0.0, 1.0, 0.0],
        "initial.scale": [1.2, 1.2, 0.3, 0.3],
        "preferred_speed": 1.0,
    },
}
NAMES = ("fitted", "true parameters")


def model(priors: dict[str, str]) -> FixedModel:
    """Return the model with given priors."""
    return FixedModel("boids", standard_scales(INDIVIDUALS), OPTIONS, priors, None)


def one(number: int, options: argparse.Namespace) -> dict[str, object]:
    """Draw a data set, fit it, and return the coverage of its forecasts."""
    data = SimulatedData(model(PRIORS), options.frames, INDIVIDUALS, 1, "complete")
    try:
        tracks, truth, _ = data.draw(number)
    except WorkError as error:
        return {"number": number, "failed": str(error)}
    told = {name: f"LogNormal({math.log(float(v)):.8f}, 0.0001)" for name, v in truth.items()}
    began = time.process_time()
    fits = {
        name: inference.fit(
            model(priors),
            tracks,
            guide="linearized",
            fractions=(0.6, 0.0, 0.4),
            window=None,
            seed=number,
        )
        for name, priors in zip(NAMES, (PRIORS, told), strict=True)
    }
    fitted = time.process_time() - began
    found = score(
        fits, tracks, horizons=HORIZONS, origins=options.origins, draws=options.draws, seed=number
    )
    row = {
        name: found["coverage"].sel(model=name).mean("origin").to_numpy().tolist() for name in NAMES
    }
    crps = {
        str(name): found["crps"].sel(model=name).mean("origin").to_numpy().tolist()
        for name in found["model"].values
    }
    seconds = time.process_time() - began
    return {"number": number, "coverage": row, "crps": crps, "fit_s": fitted, "s": seconds}


def table(rows: list[dict[str, dict[str, list[list[float]]]]]) -> None:
    """Print coverage and its standard error over data sets, and skill."""
    print(f"\n{len(rows)} data sets")
    for name in NAMES:
        values = np.array([row["coverage"][name] for row in rows])
        mean, error = values.mean(0), values.std(0, ddof=1) / math.sqrt(len(rows))
        for place, level in enumerate(LEVELS):
            cells = [
                f"{100 * mean[k, place]:5.1f} +- {100 * error[k, place]:3.1f}"
                for k in range(len(HORIZONS))
            ]
            print(f"{name:16s} {level:.0%}: " + "  ".join(cells))
    for name in rows[0]["crps"]:
        mean = np.array([row["crps"][name] for row in rows]).mean(0)
        print(f"CRPS {name:18s}", "  ".join(f"{value:.4f}" for value in mean))


def main() -> None:
    """Run the data sets that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--datasets", type=int, default=40)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--origins", type=int, default=15)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("forecast_coverage.jsonl"))
    options = parser.parse_args()
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    rows = [json.loads(line) for line in lines]
    done = {row["number"] for row in rows}
    with options.out.open("a") as file:
        for number in range(options.datasets):
            if number in done:
                continue
            row = one(number, options)
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(f"{number + 1} of {options.datasets}: {row.get('s', 0.0):.0f} s", flush=True)
    failed = [row for row in rows if "failed" in row]
    table([row for row in rows if "failed" not in row])
    print(f"{len(failed)} flew apart")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
