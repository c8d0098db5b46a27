"""The order of models by their scores, and the dataset that every comparison returns."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import xarray as xr

__all__ = ["NOISE_FLOOR", "ranked", "ranking"]

#: The true rule of simulated tracks, which has no rank.
NOISE_FLOOR = "noise-floor"


def ranked(score: Mapping[str, float], last: Sequence[str] = ()) -> list[str]:
    """Return names from the best on; what is not known, and what has no rank, at the end."""

    def key(name: str) -> tuple[bool, float]:
        value = score[name]
        return name in last, math.inf if math.isnan(value) else -value

    return sorted(score, key=key)


def ranking(
    order: Sequence[str],
    score: Mapping[str, float],
    error: Mapping[str, float],
    difference: Mapping[str, float],
    difference_error: Mapping[str, float],
    fitted: set[str],
    units: str,
) -> xr.Dataset:
    """Put what all methods have into one dataset."""
    ranked_names = [name for name in order if name in fitted or name != NOISE_FLOOR]
    data: dict[str, Any] = {
        "rank": (
            "model",
            [ranked_names.index(name) + 1 if name in ranked_names else 0 for name in order],
            {"units": "1", "long_name": "rank, 1 the best"},
        ),
        "fitted": (
            "model",
            [name in fitted for name in order],
            {"units": "1", "long_name": "is one of the fits"},
        ),
    }
    for name, values, words in (
        ("score", score, "log score, higher is better"),
        ("se", error, "standard error of the score"),
        ("difference", difference, "how much worse than the best"),
        ("difference_se", difference_error, "standard error of the difference"),
    ):
        attrs = {"units": units, "long_name": words}
        data[name] = ("model", [values[model] for model in order], attrs)
    return xr.Dataset(data, {"model": list(order)})
