"""Labels of parameters, the same in every table, figure and container: names, places, units."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from pyro.nn import PyroModule

from swarmssm.models import StateSpaceModel
from swarmssm.models.parameters import declaration
from swarmssm.models.units import units_of
from swarmssm.tracks import Array

__all__ = ["at_place", "label_draws", "label_numbers", "labelled_parameters", "short_names"]

#: Parameters whose free length is not the number of individuals.
NOT_OF_INDIVIDUALS = ("modulation",)


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Return full name -> the last part of it where that leaves no doubt, else all of it.

    Parameters
    ----------
    names
        Full names such as ``transition.center``, or of numbers such as ``transition.center[0]``.
    """
    last = [name.rpartition(".")[2] for name in names]
    return {
        name: own if last.count(own) == 1 else name for name, own in zip(names, last, strict=True)
    }


def label_numbers(values: Mapping[str, Any]) -> dict[str, float]:
    """Return each number of parameters by name and place, such as ``transition.center[0]``.

    Parameters
    ----------
    values
        Name -> array or tensor of one value of the parameter.
    """
    labelled = {}
    for name, value in values.items():
        array = np.asarray(value)
        for place in np.ndindex(array.shape):
            labelled[at_place(name, place)] = float(array[place])
    return labelled


def label_draws(values: Mapping[str, Any]) -> dict[str, Array]:
    """Return the draws of each number of parameters by name and place, ``(draw,)``.

    Parameters
    ----------
    values
        Name -> array or tensor ``(draw, ...)``.
    """
    labelled = {}
    for name, value in values.items():
        array = np.asarray(value)
        for place in np.ndindex(array.shape[1:]):
            labelled[at_place(name, place)] = array[(slice(None), *place)]
    return labelled


def at_place(name: str, place: tuple[int, ...]) -> str:
    """Return the label of one number of a parameter, such as ``center[0]``."""
    return name + (f"[{', '.join(map(str, place))}]" if place else "")


def labelled_parameters(
    model: StateSpaceModel,
    values: Mapping[str, Array],
    individuals: Sequence[str],
    space: Sequence[str],
    length: str,
) -> xr.Dataset:
    """Give draws of parameters dimensions, coordinates, units and full names.

    Parameters
    ----------
    model
        Whose they are.
    values
        ``(draw, ...)`` by full name.
    individuals, space
        Labels of the tracks.
    length
        Unit of length of the tracks.

    Returns
    -------
    Dataset over ``chain`` (one) and ``draw``; a parameter with a value for each individual has the
    dimension ``individual`` (pairs: ``neighbor`` too), for each axis ``space``, and others such as
    ``attraction_dim_0``.
    """
    short, units = short_names(list(values)), units_of(model, length)
    data: dict[str, Any] = {}
    coords: dict[str, Any] = {"chain": [0]}
    for full, value in values.items():
        place, _, own = full.rpartition(".")
        module = model.get_submodule(place)
        shape = value.shape[1:]
        dims = _dims(module, own, shape, len(individuals), len(space), short[full])
        array = np.asarray(value)[None]
        attrs = {
            "long_name": f"{own.replace('_', ' ')} ({full})",
            "full_name": full,
            "units": units.get(full, ""),
        }
        data[short[full]] = (("chain", "draw", *dims), array, attrs)
        coords["draw"] = np.arange(len(value))
        for dim, labels in (("individual", individuals), ("neighbor", individuals)):
            if dim in dims:
                coords[dim] = list(labels)
        if "space" in dims:
            coords["space"] = list(space)
    return xr.Dataset(data, coords)


def _dims(
    module: PyroModule,
    name: str,
    shape: tuple[int, ...],
    individuals: int,
    space: int,
    label: str,
) -> tuple[str, ...]:
    """Return the names of a parameter's own dimensions."""
    allowed = declaration(module, name).shapes or ()
    if shape == (space,) and (space,) in allowed:
        return ("space",)
    of_individuals = name not in NOT_OF_INDIVIDUALS
    if of_individuals and shape == (individuals,) and (-1,) in allowed:
        return ("individual",)
    if of_individuals and shape == (individuals,) * 2 and (-1, -1) in allowed:
        return ("individual", "neighbor")
    return tuple(f"{label}_dim_{k}" for k in range(len(shape)))
