"""Numbers and units as people read them."""

import math

__all__ = ["NOTHING", "format_number", "format_unit"]

#: What stands where there is no number.
NOTHING = "–"


def format_number(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits, as people write it."""
    if value is None or math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "infinite" if value > 0 else "-infinite"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -4 <= exponent < 6:
        return f"{value:.{digits - 1}e}".replace("e-0", "e-").replace("e+0", "e")
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def format_unit(unit: str) -> str:
    """Return a unit as people read it: ``px/s²`` where data have ``px/s^2``; none for ``1``."""
    return "" if unit == "1" else unit.replace("^2", "²")
