"""Analyses of several sets as rows of tables with a column for each set, and in sentences."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.interpretation.summary import Row as Summary
from swarmssm.analysis.interpretation.summary import rows_of
from swarmssm.analysis.scoring.table import NOTHING, format_number, format_unit

__all__ = ["Cell", "Row", "fact_rows", "finding_rows", "unit_of", "unit_sentence"]

#: Findings whose words name an individual are no row of several sets.
NO_ROWS = ("influence",)
#: A pixel is as long as the camera makes it.
PIXELS = ("px", "pixel", "pixels", "")


@dataclass(frozen=True)
class Cell:
    """A number of one set, its interval, and what it has to be held against."""

    value: str
    interval: str = ""
    beside: str = ""


@dataclass(frozen=True)
class Row:
    """One quantity of all sets, in the order of the sets; ``group`` is where it comes from."""

    group: str
    label: str
    cells: list[Cell]


def fact_rows(analyses: Mapping[str, Analysis]) -> list[tuple[str, list[str]]]:
    """Return what each analysis is of: a label, and a text for each set."""
    told = [_facts(analysis) for analysis in analyses.values()]
    return [(label, [facts[label] for facts in told]) for label in told[0]]


def finding_rows(analyses: Mapping[str, Analysis]) -> list[Row]:
    """Return the main numbers of all, each quantity that any of them has in one row."""
    told = [
        {(one.analysis, one.quantity): one for one in rows_of(analysis.datasets)}
        for analysis in analyses.values()
    ]
    order: list[tuple[str, str]] = []
    for own in told:
        # What only a later set has stands behind what it follows there.
        place = 0
        for key in own:
            if key in order:
                place = order.index(key) + 1
            else:
                order.insert(place, key)
                place += 1
    groups = list(dict.fromkeys(group for group, _ in order))
    return [
        Row(group, label, [_cell(own.get((group, label))) for own in told])
        for which in groups
        for group, label in order
        if group == which and group not in NO_ROWS
    ]


def unit_of(analysis: Analysis) -> str:
    """Return the unit of length, empty if it is not given."""
    units = [str(dataset.attrs["unit"]) for dataset in _told(analysis) if "unit" in dataset.attrs]
    return next(filter(None, units), "")


def unit_sentence(analyses: Mapping[str, Analysis]) -> str:
    """Say what may be compared between the sets; nothing of one."""
    units = {name: unit_of(analysis) for name, analysis in analyses.items()}
    if len(units) < 2:
        return ""
    free = "Shares, factors and correlations have no unit and can be compared."
    if len(set(units.values())) > 1:
        named = "; ".join(f"{name}: {unit or 'not given'}" for name, unit in units.items())
        return (
            f"The units of length differ ({named}). No axis is shared between sets, and distances, "
            f"forces and log scores of one unit cannot be held against those of another. {free}"
        )
    unit = next(iter(units.values()))
    if unit in PIXELS:
        what = "All lengths are in pixels" if unit else "No unit of length is given"
        return (
            f"{what}, and those of two recordings need not be equally long. No axis is shared "
            "between sets: within a set distances, forces and log scores can be compared, between "
            f"sets only the shapes of curves. {free}"
        )
    return (
        f"All lengths are in {unit}. Each figure has axes of its own all the same: read the "
        "numbers before comparing the sizes of two curves."
    )


def _told(analysis: Analysis) -> list[xr.Dataset]:
    """Return the datasets, forces first, which have all dimensions of the tracks."""
    return list(analysis.datasets.values())


def _facts(analysis: Analysis) -> dict[str, str]:
    """Return label to text, the same labels for all."""
    settings = analysis.settings
    guide = settings.get("guide")
    return {
        "individuals": _size(analysis, "individual"),
        "trials": _size(analysis, "trial"),
        "frames": _frames(analysis),
        "unit of length": unit_of(analysis) or "not given",
        "model": str(settings.get("model", NOTHING)),
        "guide": str(guide) if guide else NOTHING,
        "analysed part": {"all": "all frames"}.get(
            str(settings.get("part", "")), str(settings.get("part", NOTHING))
        ),
        "draws": str(settings.get("draws", NOTHING)),
        "seed": str(settings.get("seed", NOTHING)),
        "version": str(settings.get("version", NOTHING)),
    }


def _size(analysis: Analysis, dim: str) -> str:
    """Return how many there are, if any dataset tells."""
    sizes = [dataset.sizes[dim] for dataset in _told(analysis) if dim in dataset.sizes]
    return str(sizes[0]) if sizes else NOTHING


def _frames(analysis: Analysis) -> str:
    """Return how many frames there are, and how long they last, if any dataset tells."""
    timed = [dataset for dataset in _told(analysis) if "time" in dataset.sizes]
    if not timed:
        return NOTHING
    least = min(timed, key=lambda dataset: int(dataset.attrs.get("stride", 1)))
    stride = int(least.attrs.get("stride", 1))
    seconds = least["time"].to_numpy()
    count = len(seconds)
    long = f", {format_number(float(np.ptp(seconds)))} s" if count > 1 else ""
    if stride == 1:
        return f"{count}{long}"
    # Of the last of the frames between there may be fewer.
    return f"about {count * stride}{long}; one in {stride} kept"


def _cell(found: Summary | None) -> Cell:
    """Return a number as people read it."""
    if found is None or not math.isfinite(found.value):
        return Cell(NOTHING)
    unit = format_unit(found.unit)
    sure = math.isfinite(found.low) and math.isfinite(found.high)
    ends = f"{_number(found, found.low)} to {_number(found, found.high)}" if sure else ""
    return Cell(f"{_number(found, found.value)} {unit}".rstrip(), ends, found.reference)


def _number(found: Summary, value: float) -> str:
    """Return three digits, and of a percentage none that nobody needs."""
    if found.unit == "%":
        return f"{value:.0f}" if abs(value) >= 10 else f"{value:.1f}"
    return format_number(value)
