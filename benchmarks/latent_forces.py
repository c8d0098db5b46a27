"""How much of the true forces the latents of a model hold that was never told of them.

Simulated boids at the defaults of `swarmssm simulate boids`, positions with tracking noise 0.03: 14
flocks of 1000 frames to train on, 3 to test on, 10 individuals each. Probes of the latents
(`latent_force_alignment`) are fitted and tested on different test flocks. Beside them stands what
the smoother with all true parameters says of the forces, the raw observations, and each model
before training.

    python benchmarks/latent_forces.py
    python benchmarks/latent_forces.py --models graph-ssm --guide smoothing --epochs 30
"""

import argparse
import math
import time
from pathlib import Path
from typing import Any

import pyro.distributions as dist
import torch
import xarray as xr

from swarmssm.analysis.interpretation.latents.alignment import latent_force_alignment, sentence
from swarmssm.inference import Fit, fit
from swarmssm.models import InitialStates, LatentEdges, PositionEmission, StateSpaceModel
from swarmssm.models.transitions import BoidsTransition
from swarmssm.simulate import simulate_boids

TERMS = ("cohesion", "separation", "alignment")
NOISE = 0.03
#: The simulator's own numbers.
TRUTH = {
    "cohesion_gain": 0.5,
    "separation_gain": 0.3,
    "alignment_gain": 0.2,
    "process_noise": 0.02,
    "noise": "multiplicative",
    "wall_gain": 1.0,
    "half_width": 4.0,
    "center": 0.0,
    "min_speed": 0.6,
    "max_speed": 1.2,
}


def true_law(scales: Any) -> Any:
    """Return the boids model of the simulation, its tracking noise known to a ten-thousandth."""
    return StateSpaceModel(
        InitialStates.for_scales(scales),
        BoidsTransition(scales.space, scales.dt, **TRUTH),
        PositionEmission(scales.space, dist.LogNormal(math.log(NOISE), 1e-4)),
        LatentEdges("radius:2.5"),
    )


def observed(tracks: xr.Dataset) -> xr.Dataset:
    """Return what an observer has: positions alone."""
    return tracks[["position"]].assign_attrs(tracks.attrs)


def table(name: str, found: xr.Dataset, against: dict[str, float]) -> None:
    """Print a row for each source: R^2 and its share of the smoother's."""
    print(f"\n{name}: {found.attrs['samples']} samples, p at least {found.attrs['least_p']:.3f}")
    print(f"{'':>34}" + "".join(f"{term:>26}" for term in TERMS))

    def row(label: str, r2: xr.DataArray, p: xr.DataArray | None = None) -> None:
        cells = []
        for term in TERMS:
            value = float(r2.sel(term=term))
            chance = "" if p is None else f" p={float(p.sel(term=term)):.3f}"
            cells.append(f"{value:.3f} ({value / against[term]:.2f} x){chance}")
        print(f"{label:>34}" + "".join(f"{cell:>26}" for cell in cells))

    for source in found["source"].values:
        for probe in found["probe"].values:
            part = found.sel(source=source, probe=probe)
            size = int(part["source_size"])
            row(f"{source} [{size}], {probe}", part["source_vector_r2"], part["source_p"])
            before = part["untrained_r2"]
            if before.sizes["initialization"] and before.notnull().any():
                row("... untrained", before.mean("initialization"))
    for count in found["components"].values:
        part = found.sel(components=count)["component_r2"]
        row(f"{count} components", part.sel(training="trained"))
        if found.attrs["initializations"]:
            row("... untrained", part.sel(training="untrained"))
    for count in found["frames"].values:
        part = found.sel(frames=count)["frame_r2"]
        row(f"learned from {count} frames", part.sel(training="trained"))
        if found.attrs["initializations"]:
            row("... untrained", part.sel(training="untrained"))
    for group in found["group"].values:
        purity = found["purity"].sel(group=group).to_series()
        told = ", ".join(f"{axis} {value:.2f}" for axis, value in purity.items())
        print(f"{'purity of rotated ' + group:>34}  {told}")
    print(sentence(found), flush=True)


def main() -> None:
    """Simulate, fit, probe and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", default="graph-ssm,graph-vae")
    parser.add_argument("--guide", default="markov", help="of graph-ssm")
    parser.add_argument("--epochs", type=int, default=20, help="of graph-ssm")
    parser.add_argument("--vae-epochs", type=int, default=60, help="of graph-vae")
    parser.add_argument("--flocks", type=int, default=14)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shifts", type=int, default=199)
    parser.add_argument("--samples", type=int, default=20_000, help="at most, of each probe")
    parser.add_argument(
        "--out", type=Path, help="folder for results and fits; what is there is not fitted anew"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    tracks = simulate_boids(
        trials=options.flocks + 3,
        steps=options.frames,
        observation_noise=NOISE,
        seed=options.seed,
    )
    training = observed(tracks.isel(trial=slice(0, options.flocks)))
    test = tracks.isel(trial=slice(options.flocks, None))
    common: dict[str, Any] = {"graph": "radius:2.5", "seed": options.seed, "fractions": (1, 0, 0)}

    truth = fit(true_law, training.isel(time=slice(0, 50)), guide="linearized", steps=1, **common)
    yardstick = report(truth, test, "boids with the true parameters", options, None)
    best = yardstick.sel(source="forces", probe="linear")["source_vector_r2"]
    against = {term: float(best.sel(term=term)) for term in TERMS}
    for name in options.models.split(","):
        folder = None if options.out is None else options.out / name
        if folder is not None and folder.exists():
            run, spent = Fit.load(folder), "fitted before"
        else:
            started = time.process_time()
            run = trained(name, training, options, common)
            spent = f"{time.process_time() - started:.0f} CPU-seconds to fit"
            if folder is not None:
                run.save(folder)
        print(f"\n{name} with guide {run.settings.guide}: {spent}", flush=True)
        report(run, test, name, options, against)


def trained(
    name: str, training: xr.Dataset, options: argparse.Namespace, common: dict[str, Any]
) -> Fit:
    """Fit one of the models, told nothing but positions and the radius of the graph."""
    if name != "graph-ssm":
        return fit(name, training, epochs=options.vae_epochs, **common)
    told = {"noise": "constant", "tails": "gaussian", "symmetries": "square"}
    return fit(
        name, training, guide=options.guide, model_options=told, epochs=options.epochs, **common
    )


def report(
    run: Fit, test: xr.Dataset, name: str, options: argparse.Namespace, against: Any
) -> xr.Dataset:
    """Probe a fit, print the table, and keep both if asked to."""
    tracks = test.drop_vars("adjacency")
    # Nobody doubts that true parameters tell the forces, nor is there anything to train.
    known = {"shifts": 19, "untrained_seeds": 0} if against is None else {"shifts": options.shifts}
    found = latent_force_alignment(run, tracks, limit=options.samples, **known)
    if against is None:
        best = found.sel(source="forces", probe="linear")["source_vector_r2"]
        against = {term: float(best.sel(term=term)) for term in TERMS}
    table(name, found, against)
    if options.out is not None:
        found.to_netcdf(options.out / f"{name.replace(' ', '-')}.nc")
    return found


if __name__ == "__main__":
    main()
