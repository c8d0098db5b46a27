"""Designs of a recovery study: sizes and noise of data sets, and which of them are tried."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from typing import Any

import numpy as np

from swarmssm.errors import InputError

__all__ = ["FACTORS", "Design", "designs_of", "titles_of", "varied_values"]

#: What may be varied.
FACTORS = ("individuals", "density", "radius", "noise", "frames", "trials")
WHOLE = ("individuals", "frames", "trials")
#: Multiples of the base design that are tried where no values are named.
MULTIPLES = {
    "individuals": (0.5, 1.0, 2.0),
    "density": (0.25, 1.0, 4.0),
    "radius": (0.5, 1.0, 2.0),
    "noise": (1.0 / 3.0, 1.0, 3.0),
    "frames": (0.5, 1.0, 2.0, 4.0),
}


@dataclass(frozen=True)
class Design:
    """Size and noise of a simulated data set.

    Attributes
    ----------
    individuals
        In each trial.
    density
        Individuals in a unit of area (or volume) at the start.
    radius
        Radius of perception; ``None``: the model's own edges or the graph define neighbours.
    noise
        Standard deviation of the tracking noise of a coordinate.
    frames, trials
        Frames of each trial, and their number.
    """

    individuals: int = 8
    density: float = 1.0
    radius: float | None = 2.0
    noise: float = 0.03
    frames: int = 100
    trials: int = 2

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name == "radius" and value is None:
                continue
            whole = name in WHOLE
            kind = "a whole number from" if whole else "a number above"
            least = 4 if name == "frames" else 1 if whole else 0
            right = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not right or not math.isfinite(value) or (whole and value != int(value)):
                raise InputError(f"{name}: it must be {kind} {least}, not {value!r}.")
            if value < least or (not whole and value == 0):
                raise InputError(f"{name}: it must be {kind} {least}, not {value!r}.")
            object.__setattr__(self, name, int(value) if whole else float(value))

    @property
    def digits(self) -> list[int]:
        """Whole numbers that identify a design, for seeds."""
        return [round(1e6 * (getattr(self, part.name) or 0.0)) for part in fields(self)]

    def changed(self, **values: Any) -> "Design":
        """Return a design with other values.

        Raises
        ------
        InputError
            If there is no such factor, or a value is out of range.
        """
        for name in values:
            if name not in FACTORS:
                raise InputError(f"factors: there is no {name}; choose among {', '.join(FACTORS)}.")
        return replace(self, **values)


def varied_values(
    factors: Mapping[str, Sequence[float]] | Sequence[str] | None, base: Design
) -> dict[str, list[float]]:
    """Return the values of each factor."""
    if factors is None:
        factors = [n for n in MULTIPLES if n != "radius" or base.radius is not None]
    if isinstance(factors, str):
        raise InputError(f"factors: they must be a list of names, not {factors!r}.")
    if isinstance(factors, Mapping):
        varied = {name: [float(v) for v in values] for name, values in factors.items()}
    else:
        varied = {}
        for name in factors:
            own = getattr(base, name, None) if name in FACTORS else 0.0
            if own is None:
                raise InputError("factors: the base has no radius to be varied; name its values.")
            multiples = MULTIPLES.get(name, (1.0, 2.0, 4.0))
            least = 2 if name == "individuals" else 4 if name == "frames" else 1
            varied[name] = [
                float(max(least, round(own * m))) if name in WHOLE else own * m for m in multiples
            ]
    for name, tried in varied.items():
        if name not in FACTORS:
            raise InputError(f"factors: there is no {name}; choose among {', '.join(FACTORS)}.")
        if not tried:
            raise InputError(f"factors: {name} has no values.")
    return varied


def designs_of(
    varied: Mapping[str, Sequence[float]], base: Design, grid: bool
) -> tuple[list[tuple[str, float]], list[Design]]:
    """Return what is varied in each design, and the designs; the base first, each once."""
    labels: list[tuple[str, float]] = []
    chosen: list[Design] = []
    if grid:
        names = list(varied)
        for combination in product(*(varied[name] for name in names)):
            own = base.changed(**dict(zip(names, combination, strict=True)))
            if own not in chosen:
                labels.append(("grid", math.nan))
                chosen.append(own)
        return labels, chosen
    labels.append(("base", math.nan))
    chosen.append(base)
    for name, values in varied.items():
        for value in values:
            own = base.changed(**{name: value})
            if own not in chosen:
                labels.append((name, float(value)))
                chosen.append(own)
    return labels, chosen


def titles_of(
    labels: Sequence[tuple[str, float]],
    designs: Sequence[Design],
) -> list[str]:
    """Return a title for each design."""
    titles = []
    for (factor, value), own in zip(labels, designs, strict=True):
        if factor == "base":
            titles.append("base")
        elif factor == "grid":
            titles.append(", ".join(f"{n} {v:.4g}" for n, v in asdict(own).items() if v))
        else:
            titles.append(f"{factor} {value:.4g}")
    return titles
