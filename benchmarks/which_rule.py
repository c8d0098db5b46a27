"""Which rule each species follows: kernels, boids, a free network and constant velocity compared.

    python benchmarks/which_rule.py SHARED_DATA [--sets guppies zebrafish guppy-pair sheep]
        [--folder which_rule] [--steps 300] [--origins 40]

For each recording `kernel`, `boids` and `graph-ssm` are fitted to the first 70 % of the frames (of
the drives, for sheep), and score the last 15 %: log score and CRPS of positions, beside constant
velocity and staying put, from the same frames. Fits that are in the folder are not done again. Also
written are `SET.nc` for `swarmssm analyze FOLDER/SET-kernel FOLDER/SET.nc`.
"""

import argparse
import time
from pathlib import Path

import torch
import xarray as xr

from swarmssm import inference, io
from swarmssm.analysis.scoring import score, score_table, verdict
from swarmssm.datasets import load_dataset
from swarmssm.inference import Fit

HORIZONS = (1, 2, 5, 10, 20)
FORCES = {"relaxation": True, "limits": False, "noise": "additive"}
MODELS: dict[str, dict[str, object]] = {
    "kernel": {"model_options": {"angular": 2, **FORCES}},
    "boids": {"model_options": dict(FORCES)},
    "graph-ssm": {},
}
SETS = ("guppies", "zebrafish", "guppy-pair", "sheep")


def fitted(place: Path, model: str, tracks: xr.Dataset, steps: int) -> Fit:
    """Fit, or take what is there."""
    if place.exists():
        return Fit.load(place)
    began = time.process_time()
    options = dict(MODELS[model])
    if model == "graph-ssm":
        options["steps"] = steps
    fit = inference.fit(model, tracks, graph="complete", out=place, **options)
    print(f"{place.name}: {time.process_time() - began:.0f} s of processor time", flush=True)
    return fit


def main() -> None:
    """Fit what is missing, and print a table for each recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--sets", nargs="+", default=[*SETS])
    parser.add_argument("--folder", type=Path, default=Path("which_rule"))
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--origins", type=int, default=40)
    options = parser.parse_args()
    options.folder.mkdir(exist_ok=True)
    for name in options.sets:
        tracks = load_dataset(name, options.data)
        file = options.folder / f"{name}.nc"
        if not file.exists():
            io.write(tracks, file)
        tracks = io.read(file)
        fits = {
            model: fitted(options.folder / f"{name}-{model}", model, tracks, options.steps)
            for model in MODELS
        }
        found = score(fits, tracks, horizons=HORIZONS, origins=options.origins)
        for variable, words in (
            ("log_score", "log score, nats per coordinate"),
            ("crps", "CRPS"),
        ):
            print(f"\n{name}: {words}, after steps {found['horizon'].values.tolist()}")
            for model, row in score_table(found, variable).to_pandas().iterrows():
                print(f"  {model:18s}", " ".join(f"{value:8.2f}" for value in row))
        print(verdict(found))


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
