"""Every set of tracks that can be asked for by its name."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import xarray as xr

from swarmssm.datasets.benchmark_boids import load_boids, load_free_boids
from swarmssm.datasets.recordings import RECORDINGS, load_recording
from swarmssm.datasets.sunbleak import load_sunbleak_groups
from swarmssm.errors import InputError
from swarmssm.simulate import (
    simulate_charged,
    simulate_couzin,
    simulate_springs,
    simulate_vicsek,
)

__all__ = ["DATASETS", "NamedDataset", "load_dataset"]


@dataclass(frozen=True)
class NamedDataset:
    """Tracks that can be asked for by name.

    Attributes
    ----------
    name, title
        For the command line and for tables.
    load
        Called with the folder of recordings, returns tracks.
    recorded
        Whether animals moved so; else a simulated rule did.
    """

    name: str
    title: str
    load: Callable[[Path], xr.Dataset]
    recorded: bool


def _sunbleak(folder: Path) -> xr.Dataset:
    """Return the fish that come with the package."""
    return load_sunbleak_groups()


def _vicsek(folder: Path) -> xr.Dataset:
    """Simulate twenty trials of Vicsek's particles in open space, denser than they can fly off."""
    return simulate_vicsek(20, 300, 20, dt=0.1, speed=0.5, box=None, process_noise=0.4)


def _couzin(folder: Path) -> xr.Dataset:
    """Simulate twenty trials of a group with zones, after it has come together."""
    return simulate_couzin(20, 300, 20, blind_angle=60.0, burn_in=100)


def _springs(folder: Path) -> xr.Dataset:
    """Simulate balls, some of which are joined by springs."""
    return simulate_springs(5, 100, 200)


def _charged(folder: Path) -> xr.Dataset:
    """Simulate charged balls."""
    return simulate_charged(5, 100, 200)


TITLES = {
    "guppies": "8 guppies, 8 s",
    "guppy-pair": "2 guppies, 5 min",
    "zebrafish": "8 zebrafish, 18 s",
    "zebrafish100": "100 juvenile zebrafish, 9 s",
    "sheep": "14 sheep that a dog drives, 20 drives",
    "goats": "16 goats with collars, 1 h",
}
DATASETS: dict[str, NamedDataset] = {
    one.name: one
    for one in (
        NamedDataset("boids", "10 boids between soft walls, 20 x 100 s", load_boids, False),
        NamedDataset("boids-free", "10 boids in open space, 20 x 30 s", load_free_boids, False),
        NamedDataset("vicsek", "20 particles after Vicsek, 20 x 30 s", _vicsek, False),
        NamedDataset("couzin", "20 individuals after Couzin, 20 x 30 s", _couzin, False),
        NamedDataset("springs", "5 balls on springs, 200 x 10 s", _springs, False),
        NamedDataset("charged", "5 charged balls, 200 x 10 s", _charged, False),
        NamedDataset("sunbleak", "8 groups of 10 sunbleak, 5 s", _sunbleak, True),
        *(
            NamedDataset(name, TITLES[name], partial(load_recording, name), True)
            for name in RECORDINGS
        ),
    )
}


def load_dataset(name: str, folder: str | Path = ".") -> xr.Dataset:
    """Return tracks by name.

    Parameters
    ----------
    name
        One of :data:`DATASETS`.
    folder
        Where recordings lie that do not come with the package.

    Raises
    ------
    InputError
        If there is no such name, or the recording is not there.
    """
    if name not in DATASETS:
        raise InputError(f"dataset: {name!r} is unknown; choose one of {', '.join(DATASETS)}.")
    return DATASETS[name].load(Path(folder))
