"""The walls of a recording: those of its file, else where a model's wall force begins."""

import json
from typing import Any

import numpy as np
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.guides import PathGuide
from swarmssm.metrics.arena import Arena
from swarmssm.models import StateSpaceModel
from swarmssm.models.transitions import Walls

__all__ = ["SOFT_WALLS", "arena_of", "wall_name"]

#: Attributes of tracks that hold the corners of the arena, with or without ``_<unit>`` behind.
ATTRIBUTES = ("arena", "arena_border", "tank_wall")


#: Source of an arena that is no tank: there the wall force of the fitted model begins.
SOFT_WALLS = "the onset of the fitted wall force"


def wall_name(walls: Arena | None) -> str:
    """Return what distances to the walls are measured to."""
    return SOFT_WALLS if walls is not None and walls.source == SOFT_WALLS else "the wall"


def arena_of(fit: Fit, tracks: xr.Dataset, walls: Arena | str | None = None) -> Arena | None:
    """Return the arena; its ``source`` says where it is known from.

    Parameters
    ----------
    fit
        Without an attribute of the tracks, the place where the model's wall force begins (at the
        posterior median), if it has one. Animals of a tank swim beyond it, up to the real wall.
    tracks
        Their attribute ``arena``, ``arena_border`` or ``tank_wall`` comes first: corners, as an
        array or as JSON, two of them for a box.
    walls
        An arena; ``"hull"``: the convex hull of all positions; ``"none"``; absent: as above.

    Raises
    ------
    InputError
        If ``walls`` is something else, or has other dimensions than the tracks.
    """
    space = int(tracks.sizes["space"])
    if isinstance(walls, Arena):
        if walls.num_space != space:
            raise InputError(
                f"walls: they have {walls.num_space} dimensions, and the tracks have {space}."
            )
        return walls
    if walls == "hull":
        points = tracks["position"].transpose(..., "space").to_numpy().reshape(-1, space)
        return Arena.around(points, "the convex hull of all recorded positions")
    if walls not in (None, "none"):
        raise InputError(f"walls: give an Arena, 'hull' or 'none', not {walls!r}.")
    if walls == "none" or space < 2:
        return None
    return _recorded(tracks, space) or _inferred(fit, space)


def _recorded(tracks: xr.Dataset, space: int) -> Arena | None:
    """Return the arena in the attributes of the tracks."""
    unit = str(tracks.attrs.get("unit", ""))
    for name in ATTRIBUTES:
        for label in (name, f"{name}_{unit}"):
            value: Any = tracks.attrs.get(label)
            if value is None:
                continue
            try:
                corners = np.asarray(json.loads(value) if isinstance(value, str) else value, float)
                if corners.ndim != 2 or corners.shape[1] != space:
                    raise ValueError(f"its shape is {corners.shape}")
                return Arena.around(corners, f"the tracks' attribute {label}")
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"tracks: the attribute {label} must hold corners (corner, space) of the "
                    f"arena, two for a box ({error}). Correct it, or pass walls='none'."
                ) from error
    return None


def _inferred(fit: Fit, space: int) -> Arena | None:
    """Return where the wall force of a model begins, at the posterior median."""
    model = fit.model
    if not isinstance(model, StateSpaceModel) or not isinstance(model.transition, Walls):
        return None
    middle = fit.guide.parameters_guide.median() if isinstance(fit.guide, PathGuide) else {}
    with fit.with_parameters(middle):
        box = model.transition.box()
        if box is None:
            return None
        half, centre = (np.broadcast_to(value.detach().double().numpy(), (space,)) for value in box)
    scaler = fit.preparation.scaler
    scale, offset = np.array(scaler.scale[:space]), np.array(scaler.offset[:space])
    low, high = ((centre + sign * half) * scale + offset for sign in (-1, 1))
    return Arena.box(low, high, SOFT_WALLS)
