"""The truth behind tracks of which the dynamics are known but that did not bring it along."""

import json

import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.simulate.recording import Dynamics

__all__ = ["add_truth"]


def add_truth(tracks: xr.Dataset, dynamics: Dynamics) -> xr.Dataset:
    """Attach what a simulator of this package would have written beside exact states.

    Parameters
    ----------
    tracks
        Tracks with trials, of states without tracking noise and without gaps.
    dynamics
        The dynamics by which they were made.

    Returns
    -------
    The tracks with ``next_position`` and ``next_velocity`` free of noise, ``adjacency``, and
    ``attrs["simulation"]``, see :func:`swarmssm.simulate.simulate_boids`.

    Raises
    ------
    InputError
        If a state is unknown.
    """
    dims = ("trial", "time", "space", "individual")
    if "velocity" not in tracks:
        raise InputError("tracks: they have no velocity, and the truth needs exact states.")
    order = ("trial", "time", "individual", "space")
    positions, velocities = (
        torch.from_numpy(tracks[name].transpose(*order).to_numpy().astype("float64"))
        for name in ("position", "velocity")
    )
    if not bool((positions + velocities).isfinite().all()):
        raise InputError("tracks: a state is unknown, and the truth needs exact states.")
    force, graph = dynamics.forces(positions, velocities)
    following = dynamics.move(positions, velocities, force)
    settings = {
        **dynamics.to_dict(),
        "dynamics": dynamics.name,
        "observation_noise": 0.0,
        "burn_in": 0,
    }
    rule = dynamics.graph_rule
    attrs = {} if rule is None else {"rule": json.dumps(rule.to_dict())}
    edges = (("trial", "time", "individual", "neighbor"), graph.to(torch.uint8).numpy(), attrs)
    return tracks.assign(
        next_position=(dims, following[0].mT.numpy()),
        next_velocity=(dims, following[1].mT.numpy()),
        adjacency=edges,
    ).assign_attrs(simulation=json.dumps(settings))
