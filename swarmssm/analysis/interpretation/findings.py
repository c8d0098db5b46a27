"""The main numbers of an analysis, each with how sure it is: a row of a short table."""

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import xarray as xr

from swarmssm.analysis.interpretation.analyzed import Analysis
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.analysis.scoring.table import NOTHING, format_number, format_unit

__all__ = ["Summary", "findings", "findings_table"]

#: Per cent below which a share is told as 0.
NO_SHARE = 0.05
#: A preferred distance is told if at least this share of the draws has one.
ENOUGH_DRAWS = 0.05


@dataclass(frozen=True)
class Summary:
    """One number.

    Attributes
    ----------
    analysis
        Where it comes from.
    quantity
        What it is, in words.
    value
        The number; NaN if it is not known.
    low, high
        Ends of its 90 % interval; NaN if it has none.
    unit
        Empty for a plain number.
    beside
        What it has to be held against.
    """

    analysis: str
    quantity: str
    value: float
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    beside: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def findings(analysis: Analysis) -> list[Summary]:
    """Return the main numbers of an analysis.

    Parameters
    ----------
    analysis
        What :func:`swarmssm.analysis.interpretation.analyze` returned.
    """
    told: dict[str, Callable[[xr.Dataset], Iterator[Summary]]] = {
        "forces": _of_forces,
        "kernels": _of_kernels,
        "force_maps": _of_maps,
        "latents": _of_latents,
        "influence": _of_influence,
    }
    datasets = analysis.datasets
    return [row for name, tell in told.items() if name in datasets for row in tell(datasets[name])]


def findings_table(analysis: Analysis) -> list[dict[str, str]]:
    """Return :func:`findings` as text, column title to text."""
    rows = []
    for found in findings(analysis):
        value, low, high = (_text(one, found.unit) for one in (found.value, found.low, found.high))
        unit = format_unit(found.unit)
        sure = math.isfinite(found.low) and math.isfinite(found.high)
        rows.append(
            {
                "finding": f"{found.analysis}: {found.quantity}",
                "value": value if value == NOTHING else f"{value} {unit}".rstrip(),
                "90 % interval": f"{low} to {high}" if sure else NOTHING,
                "beside it": found.beside or NOTHING,
            }
        )
    return rows


def _text(value: float, unit: str) -> str:
    """Return a number, what is next to nothing of a whole as 0."""
    return format_number(0.0 if unit == "%" and abs(value) < NO_SHARE else value)


def _interval(values: xr.DataArray, scale: float = 1.0) -> tuple[float, float, float]:
    """Return the middle and the ends, to stand behind value, low, high."""
    low, middle, high = (scale * float(values.sel(quantile=q)) for q in (0.05, 0.5, 0.95))
    return middle, low, high


def _of_draws(values: xr.DataArray, scale: float) -> tuple[float, float, float]:
    """Return the middle and the ends over the draws."""
    low, middle, high = scale * quantiles(values.to_numpy())
    return float(middle), float(low), float(high)


def _of_forces(found: xr.Dataset) -> Iterator[Summary]:
    truth = "truth_r_squared" in found
    for term in found["term"].to_numpy():
        beside = ""
        if truth:
            one = found.sel(term=term)
            r2 = float(one["truth_r_squared"])
            if math.isfinite(r2):
                beside = (
                    f"truth: R² {r2:.3f}, "
                    f"{100 * float(one['truth_coverage']):.0f} % within intervals"
                )
        yield Summary(
            "forces",
            f"share of {term}",
            *_interval(found["share"].sel(term=term), 100.0),
            "%",
            beside,
        )
    words = {"model": "the model's own terms", "projection": "boids terms fitted to a free model"}
    yield Summary(
        "forces",
        "acceleration that is not other",
        *_of_draws(found["explained"], 100.0),
        "%",
        words.get(str(found.attrs["source"]), ""),
    )


def _of_kernels(found: xr.Dataset) -> Iterator[Summary]:
    unit = str(found.attrs["unit"])
    share = float(found["has_preferred_distance"])
    if share >= ENOUGH_DRAWS:
        yield Summary(
            "kernels",
            "preferred distance",
            *_interval(found["preferred_distance"]),
            unit,
            f"in {100 * share:.0f} % of the draws",
        )
    for name, words in (
        ("interaction_range", "range of the force"),
        ("alignment_range", "range of alignment"),
    ):
        if name in found:
            ends = 100 * (1.0 - float(found[f"{name}_open"]))
            yield Summary(
                "kernels",
                words,
                *_interval(found[name]),
                unit,
                f"ends within the data in {ends:.0f} % of the draws"
                + ("; it is at least this" if ends < 50 else ""),
            )
    yield Summary("kernels", "neighbours", *_interval(found["neighbors"]), "", "mean number")
    if "explained" in found:
        yield Summary(
            "kernels",
            "acceleration that they explain",
            *_of_draws(found["explained"], 100.0),
            "%",
            "of a free model, in blocks of time left out",
        )
    for name in found["kernel"].to_numpy() if "kernel" in found.dims else ():
        one = found.sel(kernel=name)
        yield Summary(
            "kernels",
            f"error of {name}",
            100 * float(one["truth_error"]),
            unit="%",
            beside=f"truth: {100 * float(one['truth_inside']):.0f} % within the band",
        )


def _of_maps(found: xr.Dataset) -> Iterator[Summary]:
    for name in found["map"].to_numpy():
        one = found.sel(map=name)
        reliability = float(one["reliability"])
        beside = ""
        if math.isfinite(reliability):
            beside = (
                f"slope {format_number(float(one['slope']), 2)}; {100 * reliability:.0f} % of the "
                "raw map is more than sampling error"
            )
        yield Summary(
            "force maps",
            f"{name}: correlation with raw data",
            float(one["correlation"]),
            beside=beside,
        )


def _of_latents(found: xr.Dataset) -> Iterator[Summary]:
    linear = found.sel(probe="linear")
    for term in found["term"].to_numpy():
        own = linear.sel(source="latents", term=term)
        beside = f"p = {format_number(float(own['source_p']), 2)}"
        fresh = own["untrained_r2"].to_numpy()
        if np.isfinite(fresh).any():
            beside += f"; untrained {float(np.nanmean(fresh)):.2f}"
        if "observed terms" in found["source"].to_numpy():
            plain = linear["source_vector_r2"].sel(source="observed terms", term=term)
            beside += f"; plain from observations {float(plain):.2f}"
        yield Summary(
            "latents",
            f"R² of {term} from all latents",
            float(own["source_vector_r2"]),
            beside=beside,
        )


def _of_influence(found: xr.Dataset) -> Iterator[Summary]:
    middle = found["leadership"].sel(quantile=0.5)
    if not middle.notnull().any():
        return
    first = middle.argmax("individual")
    top = str(found["individual"].to_numpy()[int(first)])
    unit = str(found["leadership"].attrs.get("units", ""))
    certain = bool(found.attrs.get("certain", 0))
    chance = float(found["rank_probability"].sel(rank=1).isel(individual=int(first)))
    yield Summary(
        "influence",
        f"of individual {top} on another",
        *_interval(found["leadership"].isel(individual=int(first))),
        unit,
        "the most of all" + ("" if certain else f" in {100 * chance:.0f} % of the draws"),
    )
    others = found["leadership"].sel(quantile=0.5).median()
    yield Summary("influence", "of the median individual on another", float(others), unit=unit)
    by = str(found.attrs.get("leader_by", "nothing"))
    if by == "nothing":
        return
    leader = str(found.attrs["leader"])
    rate = format_number(100 * float(found.attrs["leader_rate"]), 2)
    yield Summary(
        "influence",
        "p-value of the likeliest leader" if by == "trials" else "doubt of the likeliest leader",
        float(found["leader_alarm"].min()),
        beside=f"by {by}, at a rate of false alarms of {rate} %: "
        + (f"{leader} leads" if leader else "nobody leads"),
    )
