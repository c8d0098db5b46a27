"""The verdict of an analysis: what moves the animals, how sure that is, and whether it forecasts.

A rule is believed on its forecasts. At each horizon the fit is compared with the best simple
baseline there by the continuous ranked probability score (CRPS) of held-out positions, with the
90 % interval of the paired difference. It passes if it is better beyond chance at one horizon or
more, and worse at none.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from swarmssm.analysis.interpretation.influence.delays import first_to_turn
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.scoring.differences import paired_difference
from swarmssm.analysis.scoring.references import REFERENCES
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.analysis.scoring.table import format_number

__all__ = ["ForecastTest", "forecast_test", "verdict_of"]

SOCIAL = ("cohesion", "separation", "alignment")
LEVEL = 0.9
#: Coverage that is this far below the level says that the intervals are too narrow.
TOLERANCE = 0.05


@dataclass(frozen=True)
class ForecastTest:
    """The forecasts of a fit against the best simple baseline at each horizon.

    Attributes
    ----------
    model
        The fit.
    baselines
        The best of them at each horizon.
    horizons
        Steps ahead.
    skill
        1 minus the ratio of the CRPS to that of the baseline, at each horizon.
    better, worse
        Horizons at which the difference is beyond chance.
    known
        Whether there were enough origins to tell.
    coverage
        Mean over the horizons of the share of coordinates inside the 90 % intervals.
    trained_on
        Whether some of the scored frames were trained on.
    """

    model: str
    baselines: tuple[str, ...]
    horizons: tuple[int, ...]
    skill: tuple[float, ...]
    better: tuple[int, ...]
    worse: tuple[int, ...]
    known: bool
    coverage: float
    trained_on: bool

    @property
    def passed(self) -> bool:
        """Whether the rule forecasts better than a simple baseline, and nowhere worse."""
        return bool(self.better) and not self.worse and not self.trained_on


def forecast_test(scores: xr.Dataset) -> ForecastTest:
    """Compare the first fit of a dataset of scores with the best simple baseline.

    Parameters
    ----------
    scores
        Forecast scores over ``model``, ``origin`` and ``horizon``, with at least one baseline.
    """
    models = [str(name) for name in scores["model"].to_numpy()]
    model, horizons = models[0], [int(k) for k in scores["horizon"].to_numpy()]
    simple = [name for name in models if name in REFERENCES]
    crps = score_table(scores, "crps")
    base = np.where(np.isnan(own := crps.sel(model=simple).to_numpy()), np.inf, own)
    best = [simple[index] for index in base.argmin(0)]
    low, high = {}, {}
    for name in set(best):
        difference = paired_difference(scores, "crps", model, name)["difference"]
        low[name] = difference.sel(quantile=0.05).to_numpy()
        high[name] = difference.sel(quantile=0.95).to_numpy()
    lows = np.array([low[name][index] for index, name in enumerate(best)])
    highs = np.array([high[name][index] for index, name in enumerate(best)])
    with np.errstate(invalid="ignore"):
        skill = 1.0 - crps.sel(model=model).to_numpy() / base.min(0)
    return ForecastTest(
        model=model,
        baselines=tuple(best),
        horizons=tuple(horizons),
        skill=tuple(float(value) for value in skill),
        better=tuple(k for k, end in zip(horizons, lows, strict=True) if end > 0),
        worse=tuple(k for k, end in zip(horizons, highs, strict=True) if end < 0),
        known=bool(np.isfinite(lows).any()),
        coverage=float(score_table(scores, "coverage", LEVEL).sel(model=model).mean()),
        trained_on=int(scores["trained_on"].sel(model=model)) > 0,
    )


def verdict_of(datasets: Mapping[str, xr.Dataset]) -> str:
    """Return the verdict of the datasets of an analysis; see :meth:`Analysis.verdict`."""
    parts = []
    if "forces" in datasets:
        parts.append(_forces(datasets["forces"]))
    if "kernels" in datasets:
        parts += _kernels(datasets["kernels"])
    if "delays" in datasets:
        parts += _delays(datasets["delays"])
    if "scores" in datasets:
        parts.append(_forecasts(datasets["scores"]))
    elif datasets.keys() - {"delays", "parameters"}:
        parts.append(UNTESTED)
    return " ".join(parts) or "No individual turns before the others beyond chance."


UNTESTED = "Forecasts were not scored: whether the rule can be believed is not known."


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
    social = share.sel(term=list(SOCIAL), quantile=0.5)
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
    """Say whether forecasts are better than the best simple baseline's, and what follows."""
    if not any(str(name) in REFERENCES for name in scores["model"].to_numpy()):
        return UNTESTED
    found = forecast_test(scores)
    names = joined([name.replace("-", " ") for name in dict.fromkeys(found.baselines)])
    last = found.skill[-1]
    side = "lower" if last > 0 else "higher"
    size = f"CRPS {abs(100 * last):.0f} % {side} at {_at(found.horizons[-1:])}"
    if found.trained_on:
        text = (
            f"No frames were held out: compared with {names} ({size}), the score is of frames that "
            "were trained on, and no test."
        )
    elif not found.known:
        text = (
            f"The held-out frames are too few for a test against the best simple baseline, {names} "
            f"({size}): whether the rule can be believed is not known."
        )
    elif found.passed:
        text = (
            f"It forecasts held-out frames better than the best simple baseline, {names}, at "
            f"{_at(found.better)} ({size})."
        )
    elif found.better:
        text = (
            f"Its forecasts of held-out frames are better than those of the best simple baseline, "
            f"{names}, at {_at(found.better)}, and worse at {_at(found.worse)} ({size}): the rule "
            "should be believed with reserve."
        )
    elif found.worse:
        text = (
            f"It forecasts held-out frames worse than the best simple baseline, {names}, at "
            f"{_at(found.worse)} ({size}): the rule should not be believed."
        )
    else:
        text = (
            f"It does not forecast held-out frames better than the best simple baseline, {names}, "
            f"beyond chance ({size}): the rule should not be believed."
        )
    if found.coverage < LEVEL - TOLERANCE:
        text += (
            f" Its 90 % forecast intervals hold {100 * found.coverage:.0f} %: it is too sure, and "
            "the intervals of the forces are likely to be too narrow as well."
        )
    return text


def _at(horizons: tuple[int, ...]) -> str:
    """Return horizons as text."""
    if horizons == (1,):
        return "1 step"
    return f"{joined([str(k) for k in horizons])} steps"
