"""Held-out log scores of a model and its rivals, as a table and in words."""

import numpy as np
import xarray as xr

from swarmssm.analysis.plots.gathered import BASELINES
from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.report.wording import capital
from swarmssm.analysis.scoring.differences import paired_difference
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.analysis.scoring.table import format_number

__all__ = ["CAUTION", "own_model", "score_rows", "score_sentence", "shown_models"]

#: The answer itself is no rival.
NO_RIVALS = ("noise-floor",)
#: To be said beside sentences on scores.
CAUTION = (
    "Better or worse is said where the 90 % interval of the difference, from a bootstrap of blocks "
    "of starts near each other, leaves out 0; of too few starts nothing is said."
)


def shown_models(scores: xr.Dataset) -> dict[str, str]:
    """Return the models that were scored, name -> words."""
    names = [str(name) for name in scores["model"].to_numpy()]
    if "title" in scores.coords:
        return dict(zip(names, map(str, scores["title"].to_numpy()), strict=True))
    return {name: BASELINES.get(name, name) for name in names}


def own_model(scores: xr.Dataset, model: str) -> str:
    """Return which of the scored models the analysis is of: that of its name, else the first."""
    names = list(shown_models(scores))
    return model if model in names else names[0]


def score_rows(scores: xr.Dataset) -> list[dict[str, str]]:
    """Return a row a model with its mean log score over the origins at each horizon."""
    means = score_table(scores)
    return [
        {"model": title}
        | {
            str(step): f"{value:.2f}" if abs(value) < 1e3 else format_number(value)
            for step, value in (
                (int(step), float(means.sel({"model": name, "horizon": step})))
                for step in means["horizon"].to_numpy()
            )
        }
        for name, title in shown_models(scores).items()
    ]


def score_sentence(scores: xr.Dataset, model: str) -> str:
    """Say at which horizons a model forecasts better than each rival, and from how many starts.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    model
        Name of the model that is compared with the others.
    """
    titles = shown_models(scores)
    steps = [int(step) for step in scores["horizon"].to_numpy()]
    parts = []
    for rival, title in titles.items():
        if rival == model or rival in NO_RIVALS:
            continue
        ahead: dict[str, list[int]] = {"better": [], "worse": []}
        for step, verdict in zip(steps, _verdicts(scores, model, rival), strict=True):
            if verdict:
                ahead[verdict].append(step)
        said = [f"{word} {_at(some, steps)}" for word, some in ahead.items() if some]
        parts.append(f"than {title} it is {' and '.join(said) or 'neither better nor worse'}")
    starts = scores.sizes["origin"]
    trials = len(set(map(str, scores["trial"].to_numpy())))
    text = f"{capital(titles[model])} beside its rivals: {'; '.join(parts)}. " if parts else ""
    return (
        f"{text}Means over {starts} start{'s' * (starts != 1)} of {trials} "
        f"trial{'s' * (trials != 1)}, the same for all."
    )


def _verdicts(scores: xr.Dataset, model: str, rival: str) -> list[str]:
    """Return for each horizon whether a model is better or worse, or nothing if none can tell."""
    with np.errstate(invalid="ignore"):
        found = paired_difference(scores, "log_score", model, rival)["difference"]
    verdicts = []
    for low, middle, high in found.transpose("horizon", "quantile").to_numpy():
        if np.isinf(middle):
            # A forecast that broke down once is infinitely bad in the mean.
            low = high = middle
        verdicts.append("better" if low > 0 else "worse" if high < 0 else "")
    return verdicts


def _at(some: list[int], steps: list[int]) -> str:
    """Return at which steps, in words."""
    if some == steps and len(steps) > 1:
        return "at every horizon"
    return f"at {joined([str(step) for step in some])} step{'s' * (some != [1])}"
