"""In which units parameters are: a power of length and one of time for each."""

from collections.abc import Mapping

from torch import nn

__all__ = ["Dimension", "unit_text", "units_of"]

#: Powers of length and of time; for instance ``(1, -2)``, an acceleration.
Dimension = tuple[float, float]


def units_of(model: nn.Module, unit: str) -> dict[str, str]:
    """Return the unit of each parameter of which it is known, by full name.

    Parameters
    ----------
    model
        Its parts say the dimensions of their parameters in an attribute ``dimensions``: name ->
        :data:`Dimension`.
    unit
        Of length; empty, ``"length"`` stands for it.
    """
    found = {}
    for place, module in model.named_modules():
        dimensions: Mapping[str, Dimension] = getattr(module, "dimensions", {})
        for name, dimension in dimensions.items():
            found[f"{place}.{name}" if place else name] = unit_text(dimension, unit)
    return found


def unit_text(dimension: Dimension, unit: str) -> str:
    """Write a unit, for instance ``cm/s^2``; a pure number is ``1``."""
    length, time = dimension
    above = [_power(name, power) for name, power in ((unit or "length", length), ("s", time))]
    over = [text for text, power in zip(above, dimension, strict=True) if power > 0]
    below = [_power(n, -p) for n, p in ((unit or "length", length), ("s", time)) if p < 0]
    top = " ".join(over) or "1"
    return f"{top}/{'/'.join(below)}" if below else top


def _power(name: str, power: float) -> str:
    return name if power == 1 else f"{name}^{power:g}"
