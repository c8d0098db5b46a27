"""A comparison as a table for people, and in words."""

import math
from typing import Any

import numpy as np
import xarray as xr

from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.scoring.compare.ranking import NOISE_FLOOR
from swarmssm.analysis.scoring.table import format_number

__all__ = ["comparison_dict", "comparison_table", "sentence"]

#: Differences of so many standard errors are more than chance.
SURE = 2.0
#: With a greater share of windows that cannot be left out by weights, a ranking is not one.
DOUBT = 0.1
METHOD_WORDS = {
    "held-out": "log score of forecasts of held-out frames",
    "loo": "leave-one-out density of the frames that all were trained on",
    "lfo": "density of held-out frames, each from those before",
}


def comparison_table(result: xr.Dataset) -> list[dict[str, str]]:
    """Return one row a model, best first, column title to text.

    Parameters
    ----------
    result
        From :func:`swarmssm.analysis.scoring.compare.compare`.
    """
    held_out = result.attrs["method"] == "held-out"
    score = "log score" if held_out else "elpd"
    rows = []
    for name in map(str, result["model"].values):
        own = result.sel(model=name)
        rank = int(own["rank"])
        best = rank == 1
        row = {
            "rank": str(rank) if rank else "–",
            "model": name,
            score: _pair(own["score"], own["se"]),
            "behind the best": "–" if best else _pair(own["difference"], own["difference_se"]),
            "in standard errors": "–" if best else _ratio(own),
        }
        if held_out:
            for k in result["horizon"].values:
                row[f"{k} ahead"] = format_number(float(own["log_score"].sel(horizon=k)))
        else:
            believed = own["believed"].to_numpy()
            row["windows believed"] = f"{int(believed.sum())} of {believed.size}"
        if "effective_parameters" in result:
            row["effective parameters"] = format_number(float(own["effective_parameters"]))
        rows.append(row)
    return rows


def comparison_dict(result: xr.Dataset) -> dict[str, Any]:
    """Return a comparison as plain values for JSON, models in the order of their ranks.

    Parameters
    ----------
    result
        From :func:`swarmssm.analysis.scoring.compare.compare`.
    """
    settings = {name: value for name, value in result.attrs.items() if name != "notes"}
    models = []
    for name in map(str, result["model"].values):
        own = result.sel(model=name)
        row: dict[str, Any] = {"model": name}
        for variable in ("rank", "fitted", "score", "se", "difference", "difference_se"):
            row[variable] = own[variable].item()
        if "log_score" in own:
            values = own["log_score"].to_series()
            row["log_score"] = {str(k): float(value) for k, value in values.items()}
        else:
            row |= {v: own[v].to_numpy().tolist() for v in ("elpd", "pareto_k", "believed")}
        if "effective_parameters" in own:
            row["effective_parameters"] = own["effective_parameters"].item()
        models.append(row)
    found = {"settings": settings, "models": models}
    if "window" in result.dims:
        found["windows"] = [
            {name: result[name].isel(window=k).item() for name in ("trial", "start", "stop")}
            for k in range(result.sizes["window"])
        ]
    return found | {"sentence": sentence(result), "notes": list(result.attrs["notes"])}


def sentence(result: xr.Dataset) -> str:
    """Return in words which model is best, and how far that can be believed.

    Parameters
    ----------
    result
        From :func:`swarmssm.analysis.scoring.compare.compare`.
    """
    names = [str(n) for n in result["model"].values if str(n) != NOISE_FLOOR]
    best, rest = names[0], names[1:]
    units = "nats a coordinate" if result.attrs["method"] == "held-out" else "nats"
    text = (
        f"By the {METHOD_WORDS[result.attrs['method']]}, {best} is first with "
        f"{format_number(float(result['score'].sel(model=best)))} {units}"
    )
    if rest:
        second = result.sel(model=rest[0])
        error = float(second["difference_se"])
        told = f"standard error {format_number(error)}"
        text += (
            f", {format_number(float(second['difference']))} "
            f"({'no standard error' if math.isnan(error) else told}) before {rest[0]}"
        )
    text += ". "
    unknown = [name for name in rest if math.isnan(float(result["difference_se"].sel(model=name)))]
    close = [name for name in rest if name not in unknown and not _is_behind(result, name)]
    if unknown:
        text += (
            f"By how much {joined(unknown)} could be behind by chance cannot be told: this is an "
            "order, and no finding."
        )
    elif close:
        verb = "are" if len(close) > 1 else "is"
        text += (
            f"{joined(close)} {verb} not behind by {SURE:g} standard errors: these data do not "
            "tell which is better."
        )
    elif rest:
        text += "All others are behind by more than two standard errors."
    fitted = [n for n in names if bool(result["fitted"].sel(model=n))]
    beaten = [n for n in fitted if names.index(n) > _place(names, "constant-velocity")]
    if beaten:
        have = "do" if len(beaten) > 1 else "does"
        text += (
            f" {joined(beaten)} {have} not forecast better than going straight on: no rule can be "
            "read from a model that loses to none."
        )
    if "believed" in result:
        doubtful = int((~result["believed"]).any("model").sum())
        if doubtful:
            text += (
                f" In {doubtful} of {result.sizes['window']} windows the weights cannot be believed"
            )
            much = result.attrs["method"] == "loo" and doubtful > DOUBT * result.sizes["window"]
            text += ": read no ranking from it, and take another method." if much else "."
    return text


def _place(names: list[str], name: str) -> int:
    """Return where a name stands, behind all if it does not."""
    return names.index(name) if name in names else len(names)


def _is_behind(result: xr.Dataset, name: str) -> bool:
    """Return whether a model is surely behind the best."""
    own = result.sel(model=name)
    difference, error = float(own["difference"]), float(own["difference_se"])
    if math.isinf(difference):
        return True
    return math.isfinite(error) and difference > SURE * error


def _pair(value: xr.DataArray, error: xr.DataArray) -> str:
    """Return a number with its standard error."""
    own = format_number(float(error), 2)
    return (
        f"{format_number(float(value), 4)} ± {own}" if own != "–" else format_number(value.item())
    )


def _ratio(own: xr.Dataset) -> str:
    """Return how many standard errors a difference is."""
    error = float(own["difference_se"])
    if not np.isfinite(error) or error == 0:
        return "–"
    return f"{float(own['difference']) / error:.1f}"
