"""The simulated boids on which published methods were measured, with the rule behind them."""

import json
from pathlib import Path

import xarray as xr

from swarmssm import io
from swarmssm.graphs import GraphRule
from swarmssm.simulate import Boids, add_truth, simulate_boids

__all__ = ["load_boids", "load_free_boids"]

FOLDER = "boids_benchmark"
INDIVIDUALS, FRAMES, TRIALS = 10, 1000, 20
#: The flock without walls drifts apart from its beginning and freezes into a lattice after this.
FREE_FRAMES = 300


def load_boids(folder: Path) -> xr.Dataset:
    """Return ten boids between soft walls, twenty trials of a thousand frames.

    Those of the folder if they lie there (``boids_benchmark/boids.npz``), and else others that are
    simulated by the same rule.
    """
    path = folder / FOLDER / "boids.npz"
    return _read(path) if path.is_file() else simulate_boids(INDIVIDUALS, FRAMES, TRIALS)


def load_free_boids(folder: Path) -> xr.Dataset:
    """Return ten boids in open space, twenty trials of three hundred frames; as :func:`load_boids`.

    Later the flock is a lattice that drifts, in which there is nothing left to tell models apart.
    """
    path = folder / FOLDER / "boids_free.npz"
    if path.is_file():
        return _read(path).isel(time=slice(FREE_FRAMES))
    return simulate_boids(
        INDIVIDUALS,
        FREE_FRAMES,
        TRIALS,
        radius=3.0,
        cohesion_gain=1.0,
        alignment_gain=0.3,
        wall_gain=0.0,
    )


def _read(path: Path) -> xr.Dataset:
    """Read a file of the benchmark, and attach the rule that its parameters tell of."""
    tracks = io.read(path)
    told = json.loads(tracks.attrs["params"])
    law = Boids(
        form="acceleration",
        dt=told["dt"],
        space=2,
        graph=GraphRule("radius", radius=told["r"]),
        cohesion_gain=told["kc"],
        separation_gain=told["ks"],
        alignment_gain=told["ka"],
        wall_gain=told["kw"] if told["wall"] else 0.0,
        relaxation_gain=0.0,
        exponent=float(told["n"]),
        half_width=told["W"],
        min_speed=told["vmin"],
        max_speed=told["vmax"],
        preferred_speed=1.0,
        noise="multiplicative",
        process_noise=told["sd"],
    )
    return add_truth(tracks, law)
