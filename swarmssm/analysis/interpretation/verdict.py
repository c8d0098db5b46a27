"""The verdict of an analysis: what moves the animals, how sure that is, and whether it forecasts.

A rule is judged by its forecasts. At each horizon the fit is compared with the best simple baseline
there by the continuous ranked probability score (CRPS) of held-out positions, with the 90 %
interval of the paired difference. It passes if it is better beyond chance at one horizon or more,
and worse at none.
"""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from swarmssm.analysis.interpretation.influence.delays import first_to_turn
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.analysis.scoring.table import format_number
from swarmssm.analysis.scoring.verdicts import Skill, skill_at, verdict

__all__ = ["forecast_test", "forecast_verdict", "rule_verdict", "verdict_of"]

#: In place of a forecast test.
UNTESTED = "Forecasts were not scored: whether the rule can be believed is not known."


def forecast_test(scores: xr.Dataset, model: str) -> tuple[list[Skill], str]:
    """Return the skill of a fit over the best reference at each horizon, and what follows.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`, with references.
    model
        The fit.
    """
    skills = [skill_at(scores, model, int(k)) for k in scores["horizon"].to_numpy()]
    signs = {skill.differs for skill in skills}
    if int(scores["trained_on"].sel(model=model)) > 0:
        return skills, "Without held-out frames the rule is not tested."
    if not np.isfinite([skill.value for skill in skills]).all():
        return skills, "The rule should not be believed: its forecasts diverge."
    if not np.isfinite([skill.low for skill in skills]).any():
        return skills, "Whether the rule can be believed is not known: too few frames are held out."
    if signs >= {1, -1}:
        return skills, "The rule should be believed with reserve."
    if 1 in signs:
        return skills, "The rule forecasts better than simple baselines, and can be interpreted."
    return skills, (
        "The rule should not be believed: it forecasts no better than a simple baseline."
    )


def verdict_of(datasets: Mapping[str, xr.Dataset]) -> str:
    """Return the verdict of the datasets of an analysis; see :meth:`Analysis.verdict`."""
    parts = [rule_verdict(datasets)]
    if datasets.keys() - {"delays", "parameters"}:
        parts.append(forecast_verdict(datasets.get("scores")))
    return " ".join(filter(None, parts)) or "No individual turns before the others beyond chance."


def rule_verdict(datasets: Mapping[str, xr.Dataset]) -> str:
    """Return what moves the animals; empty where no analysis tells it."""
    parts = []
    if "forces" in datasets:
        parts.append(_forces(datasets["forces"]))
    if "kernels" in datasets:
        parts += _kernels(datasets["kernels"])
    if "delays" in datasets:
        parts += _delays(datasets["delays"])
    return " ".join(parts)


def forecast_verdict(scores: xr.Dataset | None) -> str:
    """Return whether forecasts are better than the best simple baseline's, and what follows."""
    return UNTESTED if scores is None else _forecasts(scores)


def _share(values: np.ndarray) -> str:
    """Return a median in per cent with its interval."""
    low, middle, high = 100.0 * values
    if f"{low:.0f}" == f"{high:.0f}":
        return f"{middle:.0f} %"
    return f"{middle:.0f} % (90 % interval {low:.0f} to {high:.0f})"


def _forces(found: xr.Dataset) -> str:
    """Say how large the share of neighbours and of the largest terms is."""
    share = found["share"].transpose("quantile", "term")
    neighbors = found["neighbor_share"].to_numpy()
    if not np.isfinite(neighbors).all():
        return "No force acts."
    social = share.sel(term=list(found.attrs["neighbor_terms"]), quantile=0.5)
    largest = str(social["term"].to_numpy()[int(np.argmax(social.to_numpy()))])
    text = f"Neighbours make up {_share(neighbors)} of the mean force"
    if float(social.max()) >= 0.005:
        text += f", mostly {largest}"
    own = share.sel(term=["self", "other"]).to_numpy()
    text += f"; the individual's own terms {_share(own[:, 0])}, other {_share(own[:, 1])}."
    if found.attrs["source"] == "projection":
        _, middle, _ = 100 * quantiles(found["explained"].to_numpy())
        text += (
            f" The model has no named forces; these terms fitted to it explain {middle:.0f} % of "
            "its accelerations."
        )
    return text


def _kernels(found: xr.Dataset) -> list[str]:
    """Say at which distance neighbours keep, and of a projection whether they matter at all."""
    if "neighbor_r2" in found:
        low, middle, high = 100 * quantiles(found["neighbor_r2"].to_numpy())
        gain = f"{middle:.0f} % ({low:.0f} to {high:.0f})"
        if not np.isfinite(middle):
            return ["The model expects no acceleration."]
        if low <= 0.5:
            return [f"Neighbours explain {gain} of the accelerations, which is not surely above 0."]
        tested = [
            f"Neighbours explain {gain} of the accelerations beyond the individual's own terms."
        ]
    else:
        tested = []
    if float(found["has_preferred_distance"]) >= 0.5:
        low, middle, high = (format_number(float(v), 2) for v in found["preferred_distance"])
        unit = found.attrs["unit"]
        tested.append(f"They repel within and attract beyond {middle} {unit} ({low} to {high}).")
    return tested


def _delays(found: xr.Dataset) -> list[str]:
    """Say who turns first, if that is beyond chance."""
    first = first_to_turn(found)
    if first is None or not first.low > 0:
        return []
    name = first.name
    lead, start, end = (format_number(v, 2) for v in (first.lead, first.low, first.high))
    return [
        f"By directions alone, {name} turns first, {lead} s before the others ({start} to {end})."
    ]


def _forecasts(scores: xr.Dataset) -> str:
    """Say how the analysed fit, the first, forecasts, and what follows for its rule."""
    model = str(scores["model"].to_numpy()[0])
    return f"{verdict(scores, model)} {forecast_test(scores, model)[1]}"
