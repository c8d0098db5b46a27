"""Tidy tables of an analysis: what its figures show, as data frames and as csv files."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.files import write_beside

__all__ = ["drawn_pairs", "tables_of", "write_tables"]

ENDS = {0.05: "low", 0.5: "median", 0.95: "high"}
#: Pairs whose correlation over delays is drawn at most.
PAIRS = 10
Tables = dict[str, pd.DataFrame]


def tables_of(datasets: Mapping[str, xr.Dataset]) -> Tables:
    """Return the tables of the datasets of an analysis; see :meth:`Analysis.to_pandas`."""
    tell: dict[str, Callable[[xr.Dataset], Tables]] = {
        "forces": _of_forces,
        "kernels": _of_kernels,
        "force_maps": _of_maps,
        "latents": _of_latents,
        "influence": _of_influence,
        "delays": _of_delays,
        "edges": _of_edges,
        "scores": _of_scores,
        "parameters": lambda found: {"parameters": found.to_dataframe().reset_index()},
    }
    tables: Tables = {}
    for name, dataset in datasets.items():
        tables |= tell[name](dataset)
    return tables


def write_tables(tables: Tables, folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Write each table as ``folder/NAME.csv``, and return the paths.

    Raises
    ------
    InputError
        If a file exists already, or cannot be written.
    """
    paths = []
    for name, table in tables.items():
        path = folder / f"{name}.csv"
        with write_beside(path, overwrite=overwrite) as temporary:
            table.to_csv(temporary, index=False)
        paths.append(path)
    return paths


def _ends(values: xr.DataArray) -> pd.DataFrame:
    """Return ``low``, ``median`` and ``high`` behind the other dimensions, and the unit."""
    others = [str(name) for name in values.dims if name != "quantile"]
    plain = values.transpose(*others, "quantile").reset_coords(drop=True)
    frame = pd.DataFrame({ENDS[q]: _column(plain.sel(quantile=q)) for q in ENDS})
    frame = pd.concat([_labels(plain.isel(quantile=0, drop=True)), frame], axis=1)
    return frame.assign(unit=str(values.attrs.get("units", "")))


def _labels(values: xr.DataArray) -> pd.DataFrame:
    """Return the labels of all dimensions, a row for each value."""
    labels = [values[name].to_numpy() for name in values.dims]
    index = pd.MultiIndex.from_product(labels, names=[str(name) for name in values.dims])
    return index.to_frame(index=False)


def _column(values: xr.DataArray) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return np.asarray(values.to_numpy(), dtype=np.float64).ravel()


def _frame(found: xr.Dataset, names: Iterable[str], *dims: str) -> pd.DataFrame:
    """Return variables over the same dimensions as columns."""
    known = {name: found[name].transpose(*dims) for name in names if name in found}
    labels = _labels(next(iter(known.values())))
    return labels.assign(**{name: _column(values) for name, values in known.items()})


def _of_forces(found: xr.Dataset) -> Tables:
    shares = _ends(100 * found["share"]).assign(unit="%", quantity="share")
    sizes = _ends(found["mean_magnitude"]).assign(quantity="magnitude")
    both = pd.concat([shares, sizes], ignore_index=True)
    return {
        "forces": both[["quantity", *(c for c in both if c != "quantity")]],
        "forces_by_individual": _ends(found["individual_magnitude"]),
        "forces_over_time": _ends(found["group_magnitude"]),
    }


def _of_kernels(found: xr.Dataset) -> Tables:
    inside = found.sel(distance=slice(None, found.attrs["believed_to"]))
    density = pd.Series(_column(inside["density"]), _column(inside["distance"]))
    curves = []
    for name in (str(own).removesuffix("_draws") for own in found if str(own).endswith("_draws")):
        curve = _ends(inside[name]).assign(kernel=name)
        if f"truth_{name}" in found:
            curve["truth"] = _column(inside[f"truth_{name}"])
        curves.append(curve)
    both = pd.concat(curves, ignore_index=True)
    both["density"] = both["distance"].map(density)
    tables = {"kernels": both[["kernel", *(c for c in both if c != "kernel")]]}
    ranges = []
    for name in ("preferred_distance", "interaction_range", "alignment_range"):
        if name in found:
            share = (
                found["has_preferred_distance"]
                if name.startswith("preferred")
                else (1.0 - found[f"{name}_open"])
            )
            low, middle, high = found[name].to_numpy()
            unit = found.attrs["unit"]
            ranges.append((name, low, middle, high, unit, float(share)))
    columns = ["quantity", "low", "median", "high", "unit", "share_of_draws"]
    tables["kernel_ranges"] = pd.DataFrame(ranges, columns=columns)
    if "modulation" in found:
        tables["modulation"] = _ends(found["modulation"])
    return tables


def _of_maps(found: xr.Dataset) -> Tables:
    names = ("turning", "turning_error", "speeding", "speeding_error", "count")
    return {"force_maps": _frame(found, names, "source", "front_back", "left_right")}


def _of_latents(found: xr.Dataset) -> Tables:
    names = ("source_vector_r2", "source_p")
    return {"latents": _frame(found, names, "source", "probe", "term")}


def _of_influence(found: xr.Dataset) -> Tables:
    pairs = _ends(found["influence"])
    own = _ends(found["leadership"]).assign(
        first_rank_probability=_column(found["rank_probability"].sel(rank=1))
    )
    for name in ("leads", "isolated"):
        if name in found:
            own[name] = found[name].to_numpy().astype(bool)
    return {"influence": pairs[pairs["individual"] != pairs["neighbor"]], "leadership": own}


def _of_delays(found: xr.Dataset) -> Tables:
    dims = ("individual", "neighbor")
    pairs = _frame(found, ("delay_of_pair", "agreement", "follows_probability"), *dims)
    ends = _ends(found["delay_interval"])
    pairs = pairs.rename(columns={"delay_of_pair": "delay"})
    pairs[["low", "high"]] = ends[["low", "high"]]
    lead = _frame(found, ("lead",), "individual")
    lead[["low", "high"]] = _ends(found["lead_interval"])[["low", "high"]]
    curves = []
    for one, other in drawn_pairs(found):
        correlation = found["correlation"].sel(individual=one, neighbor=other)
        curve = pd.DataFrame(
            {"delay": _column(found["delay"]), "correlation": _column(correlation)}
        )
        curves.append(curve.assign(individual=one, neighbor=other))
    tables = {
        "delays": pairs[pairs["individual"] != pairs["neighbor"]].assign(unit="s"),
        "delay_leads": lead.assign(unit="s"),
    }
    return tables | ({"delay_correlations": pd.concat(curves)} if curves else {})


def drawn_pairs(delays: xr.Dataset) -> list[tuple[str, str]]:
    """Return the pairs whose directions agree best, the follower first, at most ten."""
    delay = delays["delay_of_pair"].to_numpy()
    agreement = np.where(delay >= 0, delays["agreement"].to_numpy(), -np.inf)
    # Of a pair that turns at the same time both orders have delay 0: one of them is enough.
    agreement = np.where(
        (delay == 0) & np.tril(np.ones_like(delay, dtype=bool)), -np.inf, agreement
    )
    order = np.argsort(-agreement, axis=None)[:PAIRS]
    names = [str(name) for name in delays["individual"].to_numpy()]
    places = [np.unravel_index(place, agreement.shape) for place in order]
    return [(names[i], names[j]) for i, j in places if np.isfinite(agreement[i, j])]


def _of_edges(found: xr.Dataset) -> Tables:
    mean = found["edge_probability"].mean(("trial", "time")).to_dataset(name="probability")
    return {"edges": _frame(mean, ("probability",), "individual", "neighbor", "edge_type")}


def _of_scores(found: xr.Dataset) -> Tables:
    names = ("log_score", "crps", "energy_score", "mse", "coverage", "width")
    tables = {name: score_table(found, name) for name in names}
    frame = _frame(xr.Dataset(tables), names, "model", "horizon")
    ahead = dict(zip(found["horizon"].to_numpy(), found["ahead"].to_numpy(), strict=True))
    frame.insert(2, "seconds", frame["horizon"].map(ahead))
    return {"scores": frame}
