"""The law behind simulated tracks, read back from them."""

import json

import xarray as xr

from swarmssm.errors import InputError
from swarmssm.simulate.boids import Boids
from swarmssm.simulate.couzin import Couzin
from swarmssm.simulate.recording import Law
from swarmssm.simulate.vicsek import Vicsek

__all__ = ["law_of"]

LAWS: dict[str, type[Boids] | type[Vicsek] | type[Couzin]] = {
    law.name: law for law in (Boids, Vicsek, Couzin)
}
#: What the record holds besides the parameters of the law.
OF_THE_RECORD = ("law", "observation_noise", "burn_in", "seed")


def law_of(tracks: xr.Dataset) -> Law:
    """Return the law by which tracks were simulated, to go on from any of their states.

    With ``force, graph = law.forces(positions, velocities)`` the next state free of noise is
    ``law.move(positions, velocities, force)``, and one with noise
    ``law.move(positions, velocities, force, generator)``. Tensors are ``(..., individual, space)``.

    Parameters
    ----------
    tracks
        What a simulator returned.

    Raises
    ------
    InputError
        If the tracks do not say so in ``attrs["simulation"]``.
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
        return law.from_dict({k: v for k, v in settings.items() if k not in OF_THE_RECORD})
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"tracks: the attribute simulation cannot be read ({error}). Simulate them anew."
        ) from error
