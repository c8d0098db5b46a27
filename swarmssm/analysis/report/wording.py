"""Words and phrases that sentences on scores are made of."""

import math
from typing import Any

from swarmssm.analysis.scoring.evaluation import Evaluation
from swarmssm.analysis.scoring.table import format_number

__all__ = [
    "ALIKE",
    "better",
    "capital",
    "percent",
    "quantity",
    "setting_words",
    "times",
    "title_of",
]

#: Numbers that differ by less than this share of the larger are called equal.
ALIKE = 0.05


def better(own: float, rival: float) -> int | None:
    """Return 1 if the first error is lower, -1 if higher, 0 if alike, None if one is unknown."""
    if math.isnan(own) or math.isnan(rival):
        return None
    if own == rival or (
        math.isfinite(own) and math.isfinite(rival) and abs(own - rival) <= ALIKE * max(own, rival)
    ):
        return 0
    return 1 if own < rival else -1


def title_of(evaluation: Evaluation, method: str) -> str:
    """Return the words for a method."""
    return str(evaluation.scores["title"].sel({"method": method}).item())


def capital(text: str) -> str:
    """Return a text that starts a sentence, names such as graph-vae being left alone."""
    first = text.split(" ", 1)[0]
    return text if "-" in first else text[:1].upper() + text[1:]


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{100 * share:.1f} %" if not math.isnan(share) else "–"


def times(ratio: float) -> str:
    """Return how many times."""
    return f"{format_number(ratio, 2 if ratio < 100 else 3)} times"


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit."""
    return f"{format_number(value)} {unit}".rstrip()


def setting_words(value: Any) -> str:
    """Return a setting as text."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name} {setting_words(one)}" for name, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(setting_words(one) for one in value)
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)
