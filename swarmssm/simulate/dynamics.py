"""The dynamics behind simulated tracks, read back from them."""

import json

import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.simulate.boids import Boids
from swarmssm.simulate.couzin import Couzin
from swarmssm.simulate.particles import Charged, Particles, Springs
from swarmssm.simulate.recording import Dynamics
from swarmssm.simulate.vicsek import Vicsek

__all__ = ["dynamics_of"]

DYNAMICS: dict[str, type[Boids] | type[Vicsek] | type[Couzin] | type[Particles]] = {
    dynamics.name: dynamics for dynamics in (Boids, Vicsek, Couzin, Springs, Charged)
}
#: What the record holds besides the parameters of the dynamics.
OF_THE_RECORD = ("dynamics", "observation_noise", "burn_in", "switch_every", "seed")


def dynamics_of(tracks: xr.Dataset) -> Dynamics:
    """Return the dynamics by which tracks were simulated, to go on from any of their states.

    With ``force, graph = dynamics.forces(positions, velocities)`` the next state free of noise is
    ``dynamics.move(positions, velocities, force)``, and one with noise
    ``dynamics.move(positions, velocities, force, generator)``. Tensors are
    ``(..., individual, space)``.

    Springs and charges are no function of the state: their dynamics hold those of the tracks, which
    must be the same in every trial and frame, as they are in one trial without a switch.

    Parameters
    ----------
    tracks
        What a simulator returned.

    Raises
    ------
    InputError
        If the tracks do not say so in ``attrs["simulation"]``, or what joins the particles differs
        between their trials or frames.
    """
    text = tracks.attrs.get("simulation")
    if text is None:
        raise InputError(
            "tracks: they have no attribute simulation, so their dynamics are not known. Only "
            "simulated tracks have one."
        )
    try:
        settings = json.loads(text)
        dynamics = DYNAMICS[settings["dynamics"]]
        found = dynamics.from_dict({k: v for k, v in settings.items() if k not in OF_THE_RECORD})
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"tracks: the attribute simulation cannot be read ({error}). Simulate them anew."
        ) from error
    return _with_edges(found, tracks) if isinstance(found, Particles) else found


def _with_edges(dynamics: Particles, tracks: xr.Dataset) -> Dynamics:
    """Return the dynamics of particles that are joined as in these tracks."""
    if "edge_type" not in tracks:
        raise InputError(
            "tracks: they have no variable edge_type, so their dynamics are not known."
        )
    kinds = tracks["edge_type"].transpose(..., "individual", "neighbor").to_numpy()
    kinds = kinds.reshape(-1, *kinds.shape[-2:])
    if (kinds != kinds[0]).any():
        raise InputError(
            "tracks: the edge types differ between trials or frames, and dynamics have one graph. "
            "Pick one trial, and frames without a switch."
        )
    return dynamics.with_edges(torch.from_numpy(kinds[0].copy()))
