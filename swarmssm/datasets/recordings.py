"""Recordings of animals that lie in a folder, each read as its own README says it has to be."""

from pathlib import Path

import numpy as np
import xarray as xr

from swarmssm import io
from swarmssm.errors import InputError
from swarmssm.tracks import make_tracks

__all__ = ["RECORDINGS", "load_recording", "load_sheep"]

#: Name -> file in the folder of recordings.
RECORDINGS = {
    "guppies": "guppies_trex8/guppies_trex8.npz",
    "guppy-pair": "guppy_pair/guppy_pair_trial_b.npz",
    "zebrafish": "zebrafish_idtracker8/zebrafish_idtracker8.npz",
    "zebrafish100": "zebrafish100_idtracker/zebrafish100_idtracker.npz",
    "sheep": "sheep_dog/sheep_dog_events_1-2-3-4-5-6.npz",
    "goats": "goats_gps/goats_gps.npz",
}
NUM_SHEEP = 14


def load_recording(name: str, folder: Path) -> xr.Dataset:
    """Read one of :data:`RECORDINGS`.

    Parameters
    ----------
    name
        Which.
    folder
        Where the recordings lie, each in a folder of its own.

    Raises
    ------
    InputError
        If it is not there, or cannot be read.
    """
    path = folder / RECORDINGS[name]
    if not path.is_file():
        raise InputError(
            f"{path}: the recording {name} is not there. Name the folder that holds "
            f"{Path(RECORDINGS[name]).parent}."
        )
    return load_sheep(path) if name == "sheep" else io.read(path)


def load_sheep(path: Path) -> xr.Dataset:
    """Read the sheep of each drive as a trial, unknown after its end; the dog is left out."""
    with np.load(path) as file:
        xy, segment, fps = file["xy"][:, :NUM_SHEEP], file["segment"], float(file["fps"])
    drives = [xy[segment == number].astype(np.float64) for number in np.unique(segment)]
    whole = np.full((len(drives), max(map(len, drives)), *xy.shape[1:]), np.nan)
    for place, drive in enumerate(drives):
        whole[place, : len(drive)] = drive
    return make_tracks(whole, fps=fps, unit="m", source_file=path.name)
