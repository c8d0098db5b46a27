"""The law behind simulated tracks, read back from them."""

import json

import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.simulate.boids import Boids
from swarmssm.simulate.couzin import Couzin
from swarmssm.simulate.particles import Charged, Particles, Springs
from swarmssm.simulate.recording import Law
from swarmssm.simulate.vicsek import Vicsek

__all__ = ["law_of"]

LAWS: dict[str, type[Boids] | type[Vicsek] | type[Couzin] | type[Particles]] = {
    law.name: law for law in (Boids, Vicsek, Couzin, Springs, Charged)
}
#: What the record holds besides the parameters of the law.
OF_THE_RECORD = ("law", "observation_noise", "burn_in", "switch_every", "seed")


def law_of(tracks: xr.Dataset) -> Law:
    """Return the law by which tracks were simulated, to go on from any of their states.

    With ``force, graph = law.forces(positions, velocities)`` the next state free of noise is
    ``law.move(positions, velocities, force)``, and one with noise
    ``law.move(positions, velocities, force, generator)``. Tensors are ``(..., individual, space)``.

    Springs and charges are no function of the state: their law holds those of the tracks, which
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
            "tracks: they have no attribute simulation, so their law is not known. Only simulated "
            "tracks have one."
        )
    try:
        settings = json.loads(text)
        law = LAWS[settings["law"]]
        found = law.from_dict({k: v for k, v in settings.items() if k not in OF_THE_RECORD})
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"tracks: the attribute simulation cannot be read ({error}). Simulate them anew."
        ) from error
    return _with_edges(found, tracks) if isinstance(found, Particles) else found


def _with_edges(law: Particles, tracks: xr.Dataset) -> Law:
    """Return the law of particles that are joined as in these tracks."""
    if "edge_type" not in tracks:
        raise InputError("tracks: they have no variable edge_type, so their law is not known.")
    kinds = tracks["edge_type"].transpose(..., "individual", "neighbor").to_numpy()
    kinds = kinds.reshape(-1, *kinds.shape[-2:])
    if (kinds != kinds[0]).any():
        raise InputError(
            "tracks: what joins the particles differs between trials or frames, and a law has one "
            "graph. Pick one trial, and frames without a switch."
        )
    return law.with_edges(torch.from_numpy(kinds[0].copy()))
