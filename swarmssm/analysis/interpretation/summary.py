"""The main numbers of an analysis, each with its interval and a reference: a short table."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.analysis.interpretation.influence.delays import first_to_turn
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.analysis.scoring.table import NOTHING, format_number, format_unit

__all__ = ["FIXED", "Row", "formatted_summary", "rows_of", "summary_of"]

#: Per cent below which a share is shown as 0.
NO_SHARE = 0.05
#: A preferred distance is shown if at least this share of the draws has one.
ENOUGH_DRAWS = 0.05
#: Shown in place of an interval without width.
FIXED = "fixed"


class Row(NamedTuple):
    """One number; low and high are NaN where there is no interval."""

    analysis: str
    quantity: str
    value: float
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    reference: str = ""


def rows_of(datasets: Mapping[str, xr.Dataset]) -> list[Row]:
    """Return the main numbers of the datasets of an analysis."""
    told: dict[str, Callable[[xr.Dataset], Iterator[Row]]] = {
        "forces": _of_forces,
        "kernels": _of_kernels,
        "force_maps": _of_maps,
        "latents": _of_latents,
        "influence": _of_influence,
        "delays": _of_delays,
        "edges": _of_edges,
    }
    return [row for name, tell in told.items() if name in datasets for row in tell(datasets[name])]


def summary_of(datasets: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """Return :func:`rows_of` as a table; see :meth:`Analysis.summary`."""
    rows = rows_of(datasets)
    return pd.DataFrame(rows, columns=Row._fields).set_index(["analysis", "quantity"])


def formatted_summary(datasets: Mapping[str, xr.Dataset]) -> list[dict[str, str]]:
    """Return :func:`rows_of` as text, column title to text, for a console or a page."""
    rows = []
    for row in rows_of(datasets):
        value = format_value(row.value, row.unit)
        unit = format_unit(row.unit)
        rows.append(
            {
                "quantity": f"{row.analysis}: {row.quantity}",
                "value": value if value == NOTHING else f"{value} {unit}".rstrip(),
                "90 % interval": format_interval(row.low, row.high, row.unit) or NOTHING,
                "reference": row.reference or NOTHING,
            }
        )
    return rows


def format_value(value: float, unit: str) -> str:
    """Return a number as text, a negligible percentage as 0."""
    return format_number(0.0 if unit == "%" and abs(value) < NO_SHARE else value)


def format_interval(low: float, high: float, unit: str) -> str:
    """Return an interval as text; one without width is ``fixed``, none is empty."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return ""
    if math.isclose(low, high, rel_tol=1e-9, abs_tol=1e-12):
        return FIXED
    return f"{format_value(low, unit)} to {format_value(high, unit)}"


def _interval(values: xr.DataArray, scale: float = 1.0) -> tuple[float, float, float]:
    """Return median and ends, in the order of a row."""
    low, middle, high = (scale * float(values.sel(quantile=q)) for q in (0.05, 0.5, 0.95))
    return middle, low, high


def _of_draws(values: xr.DataArray, scale: float = 1.0) -> tuple[float, float, float]:
    """Return median and ends over the draws."""
    low, middle, high = scale * quantiles(values.to_numpy())
    return float(middle), float(low), float(high)


def _of_forces(found: xr.Dataset) -> Iterator[Row]:
    for term in found["term"].to_numpy():
        reference = ""
        if "truth_r_squared" in found:
            one = found.sel(term=term)
            r2 = float(one["truth_r_squared"])
            if math.isfinite(r2):
                reference = (
                    f"truth: R² {r2:.3f}, "
                    f"{100 * float(one['truth_coverage']):.0f} % within intervals"
                )
        share = _interval(found["share"].sel(term=term), 100.0)
        yield Row("forces", f"share of {term}", *share, "%", reference)
    shares = _interval(found["neighbor_share"], 100.0)
    names = [str(name) for name in found.attrs["neighbor_terms"]]
    yield Row("forces", "share of neighbours", *shares, "%", ", ".join(names))
    if str(found.attrs["source"]) == "projection":
        yield Row(
            "forces",
            "acceleration explained by the terms",
            *_of_draws(found["explained"], 100.0),
            "%",
            "least squares on the model's accelerations",
        )


def _of_kernels(found: xr.Dataset) -> Iterator[Row]:
    unit = str(found.attrs["unit"])
    share = float(found["has_preferred_distance"])
    if share >= ENOUGH_DRAWS:
        yield Row(
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
        if name not in found:
            continue
        ends = 100 * (1.0 - float(found[f"{name}_open"]))
        if ends < 50:
            yield Row(
                "kernels",
                words,
                float(found.attrs["believed_to"]),
                unit=unit,
                reference=f"at least; ends within the data in {ends:.0f} % of the draws",
            )
        else:
            reference = f"ends within the data in {ends:.0f} % of the draws"
            yield Row("kernels", words, *_interval(found[name]), unit, reference)
    yield Row("kernels", "neighbours", *_interval(found["neighbors"]), "", "mean number")
    if "neighbor_r2" in found:
        yield Row(
            "kernels",
            "acceleration explained by neighbours",
            *_of_draws(found["neighbor_r2"], 100.0),
            "%",
            f"of {100 * float(found['projection_r2'].median()):.0f} % with the individual's own "
            "terms, in blocks of time left out",
        )
    for name in found["kernel"].to_numpy() if "kernel" in found.dims else ():
        one = found.sel(kernel=name)
        yield Row(
            "kernels",
            f"error of {name}",
            100 * float(one["truth_error"]),
            unit="%",
            reference=f"truth: {100 * float(one['truth_inside']):.0f} % within the band",
        )


def _of_maps(found: xr.Dataset) -> Iterator[Row]:
    for name in found["map"].to_numpy():
        one = found.sel(map=name)
        reliability = float(one["reliability"])
        reference = "too few pairs in the bins"
        if math.isfinite(reliability):
            reference = (
                f"slope {format_number(float(one['slope']), 2)}; {100 * reliability:.0f} % of the "
                "raw map is more than sampling error"
            )
        quantity = f"{name}: correlation with raw data"
        yield Row("force maps", quantity, float(one["correlation"]), reference=reference)


def _of_latents(found: xr.Dataset) -> Iterator[Row]:
    linear = found.sel(probe="linear")
    for term in found["term"].to_numpy():
        own = linear.sel(source="latents", term=term)
        reference = f"p = {format_number(float(own['source_p']), 2)}"
        fresh = own["untrained_r2"].to_numpy()
        if np.isfinite(fresh).any():
            reference += f"; untrained {float(np.nanmean(fresh)):.2f}"
        if "observed terms" in found["source"].to_numpy():
            plain = linear["source_vector_r2"].sel(source="observed terms", term=term)
            reference += f"; from observations {float(plain):.2f}"
        r2 = float(own["source_vector_r2"])
        yield Row("latents", f"R² of {term} from all latents", r2, reference=reference)


def _of_influence(found: xr.Dataset) -> Iterator[Row]:
    middle = found["leadership"].sel(quantile=0.5)
    if not middle.notnull().any():
        return
    first = int(middle.argmax("individual"))
    top = str(found["individual"].to_numpy()[first])
    unit = str(found["leadership"].attrs.get("units", ""))
    chance = float(found["rank_probability"].sel(rank=1).isel(individual=first))
    yield Row(
        "influence",
        f"of individual {top} on another",
        *_interval(found["leadership"].isel(individual=first)),
        unit,
        "the largest"
        + ("" if found.attrs.get("certain") else f" in {100 * chance:.0f} % of the draws"),
    )
    yield Row("influence", "of the median individual on another", float(middle.median()), unit=unit)
    by = str(found.attrs.get("leader_by", "nothing"))
    if by == "nothing":
        return
    leader = str(found.attrs["leader"])
    rate = format_number(100 * float(found.attrs["leader_rate"]), 2)
    yield Row(
        "influence",
        "p-value of the most likely leader"
        if by == "trials"
        else "alarm rate of the likely leader",
        float(found["leader_alarm"].min()),
        reference=f"by {by}, at a rate of false alarms of {rate} %: "
        + (f"{leader} leads" if leader else "no leader"),
    )


def _of_delays(found: xr.Dataset) -> Iterator[Row]:
    first = first_to_turn(found)
    if first is None:
        return
    known = int(found["delay_of_pair"].notnull().sum()) // 2
    number = found.sizes["individual"]
    yield Row(
        "delays",
        f"the others follow {first.name} by",
        first.lead,
        first.low,
        first.high,
        "s",
        f"directions alone, no model; {known} of {number * (number - 1) // 2} pairs have a delay, "
        f"each to one frame, {format_number(float(found.attrs['time_step']), 2)} s",
    )


def _of_edges(found: xr.Dataset) -> Iterator[Row]:
    for kind in found["edge_type"].to_numpy():
        share = 100 * float(found["share"].sel(edge_type=kind))
        yield Row("edges", f"mean probability of {kind}", share, unit="%")
    chance = f"by chance {1 / found.sizes['edge_type']:.2f}"
    yield Row(
        "edges",
        "mean probability of the most probable type",
        float(found["certainty"]),
        reference=chance,
    )
    nearness = float(found["nearness_auc"])
    yield Row("edges", "AUC for the nearer half of the pairs", nearness, reference="by chance 0.50")
    if "graph_auc" in found:
        reference = f"by distance alone {float(found['distance_auc']):.2f}"
        auc = float(found["graph_auc"])
        yield Row("edges", "AUC for the graph of the tracks", auc, reference=reference)
