"""Forces and kernels of simulated boids, from noisy positions alone, beside the true smoother.

    python benchmarks/kernel_recovery.py [--frames 300] [--kernel-frames 150]
        [--draws 10] [--folder kernel_recovery]

20 flocks of 10 boids (the defaults of `swarmssm simulate boids`, tracking noise 0.03), 1000 frames
each: 14 to train on, 3 to test on. Fitted are `boids` and `kernel` (with a repulsion), on the first
frames of each training flock. Reported are R^2 of the posterior-mean forces against the true
ones on the test flocks, beside those of the smoother that knows the true parameters, and how far
the kernels are from the truth where pairs are. Fits that are in the folder are not done again.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
import xarray as xr

from swarmssm import inference
from swarmssm.analysis.posterior.accelerations import acceleration_model, posterior_paths
from swarmssm.inference import Fit
from swarmssm.simulate import simulate_boids

TERMS = ("cohesion", "separation", "alignment")
TRUTH = {
    "cohesion_gain": 0.5,
    "separation_gain": 0.3,
    "alignment_gain": 0.2,
    "wall_gain": 1.0,
    "half_width": [4.0, 4.0],
    "center": [0.0, 0.0],
    "min_speed": 0.6,
    "max_speed": 1.2,
    # Known as well; a fit wants something to infer.
    "process_noise": "LogNormal(-3.912023, 0.0001)",
    "noise": 0.03,
}


def fitted(name: str, model: str, training: xr.Dataset, folder: Path, **options: object) -> Fit:
    """Fit, or take what is there."""
    place = folder / name
    if place.exists():
        return Fit.load(place)
    began = time.process_time()
    fit = inference.fit(
        model,
        training,
        guide="linearized",
        fractions=(1.0, 0.0, 0.0),
        model_options=options,
        out=place,
    )
    print(f"{name}: {time.process_time() - began:.0f} s of processor time, ", end="")
    print(f"{len(fit.history)} evaluations", flush=True)
    return fit


def force_scores(fit: Fit, tracks: xr.Dataset, draws: int) -> dict[str, float]:
    """Return R^2 of the posterior-mean force of each term."""
    paths = posterior_paths(fit, tracks, draws)
    motion = acceleration_model(fit)
    mean = torch.zeros(())
    for states, values in zip(paths.states, paths.parameters, strict=True):
        mean = mean + motion.forces(states, paths.adjacency, paths.present, values) / draws
    truth = tracks["force"].transpose("trial", "time", "term", "individual", "space")
    scores = {}
    for term in TERMS:
        true = truth.sel(term=term).to_numpy()
        found = mean[:, :, motion.terms.index(term)].numpy()
        scores[term] = 1.0 - np.sum((found - true) ** 2) / np.sum((true - true.mean()) ** 2)
    return scores


def distances(tracks: xr.Dataset) -> np.ndarray:
    """Return all true distances between individuals who see each other."""
    dims = ("trial", "time", "individual", "space")
    position = torch.from_numpy(tracks["true_position"].transpose(*dims).to_numpy().copy())
    sees = tracks["adjacency"].transpose("trial", "time", "individual", "neighbor").to_numpy() != 0
    return np.asarray(torch.cdist(position, position).numpy()[sees])


def kernel_scores(fit: Fit, tracks: xr.Dataset, draws: int) -> None:
    """Print the relative L2 error of each kernel by the density of pairs, and of its band."""
    apart = distances(tracks)
    edges = np.linspace(0.0, apart.max(), 101)
    density, _ = np.histogram(apart, edges)
    grid = torch.from_numpy(0.5 * (edges[1:] + edges[:-1]))
    drawn = fit.parameters(draws)
    found: dict[str, list[np.ndarray]] = {}
    for draw in range(draws):
        values = {
            str(name): torch.as_tensor(drawn[name].to_numpy()[draw]) for name in drawn.data_vars
        }
        with fit.with_parameters(values), torch.no_grad():
            for name, curve in fit.model.transition.kernels(grid.float()).items():
                found.setdefault(name, []).append(curve.numpy())
    truth = {
        "attraction": TRUTH["cohesion_gain"] * grid.numpy(),
        "repulsion": -TRUTH["separation_gain"] / grid.numpy(),
        "alignment": np.full(len(grid), TRUTH["alignment_gain"]),
    }
    for name, curves in found.items():
        low, high = np.quantile(curves, [0.05, 0.95], axis=0)
        true = truth[name]
        error = np.average((np.mean(curves, 0) - true) ** 2, weights=density)
        relative = np.sqrt(error / np.average(true**2, weights=density))
        inside = np.average((low <= true) & (true <= high), weights=density)
        plain = np.mean(((low <= true) & (true <= high))[density > 0])
        print(f"  {name}: relative L2 {relative:.3f}, 90 % band holds {inside:.2f} of the truth by")
        print(f"    density of pairs, {plain:.2f} by distance")


def main() -> None:
    """Fit what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=300, help="of each training flock")
    parser.add_argument("--kernel-frames", type=int, default=150, help="the same, for kernel")
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("kernel_recovery"))
    options = parser.parse_args()
    options.folder.mkdir(exist_ok=True)
    tracks = simulate_boids(10, 1000, 20, observation_noise=0.03, seed=options.seed)
    training = tracks.isel(trial=slice(0, 14))
    numbers = {"boids": options.frames, "kernel": options.kernel_frames}
    parts = {name: training.isel(time=slice(0, number)) for name, number in numbers.items()}
    names = {name: f"{name}{number}" for name, number in numbers.items()}
    test = tracks.isel(trial=slice(17, 20))
    fits = {
        "boids": fitted(names["boids"], "boids", parts["boids"], options.folder),
        "kernel": fitted(
            names["kernel"],
            "kernel",
            parts["kernel"],
            options.folder,
            repulsion=True,
            noise="multiplicative",
        ),
    }
    known = fitted("known", "boids", training.isel(time=slice(0, 20)), options.folder, priors=TRUTH)
    print("\nR^2 of forces on the test flocks")
    best = force_scores(known, test, options.draws)
    print("  true smoother:", {k: f"{v:.4f}" for k, v in best.items()})
    for name, fit in fits.items():
        scores = force_scores(fit, test, options.draws)
        share = {k: f"{v:.4f} ({v / best[k]:.3f} of it)" for k, v in scores.items()}
        print(f"  {name}:", share, flush=True)
    for name, fit in fits.items():
        print(f"\nkernels of {name}")
        kernel_scores(fit, test, 200)


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
