"""Names of parameters, and of the numbers in them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["named_draws", "named_numbers", "short_name"]


def named_numbers(values: Mapping[str, Any]) -> dict[str, float]:
    """Return each number of parameters by name and place, such as ``transition.center[0]``.

    Parameters
    ----------
    values
        Name -> array or tensor of one value of the parameter.
    """
    named = {}
    for name, value in values.items():
        array = np.asarray(value)
        for place in np.ndindex(array.shape):
            named[_at(name, place)] = float(array[place])
    return named


def named_draws(name: str, draws: Any) -> list[tuple[str, Any]]:
    """Return the draws of each number of a parameter with its name and place.

    Parameters
    ----------
    name
        Of the parameter.
    draws
        ``(draw, ...)``.
    """
    return [
        (_at(name, place), draws[(slice(None), *place)]) for place in np.ndindex(draws.shape[1:])
    ]


def short_name(name: str) -> str:
    """Return the name of a parameter without its part of the model.

    The noise of the emission is ``tracking noise``; that of the motion has a name of its own.
    """
    part, _, own = name.partition(".")
    return f"tracking {own}" if part == "emission" else own or part


def _at(name: str, place: tuple[int, ...]) -> str:
    return name + (f"[{', '.join(map(str, place))}]" if place else "")
