"""What a backtest shows, in words."""

import numpy as np
import xarray as xr

from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.scoring.differences import paired_difference
from swarmssm.analysis.scoring.table import format_number
from swarmssm.analysis.scoring.tables import score_table, skill

__all__ = ["sentence"]

RIVAL, FLOOR, LEVEL = "constant-velocity", "noise-floor", 0.9
#: Sampled from so few numbers, a coverage this far off is chance.
TOLERANCE = 0.05


def sentence(scores: xr.Dataset) -> str:
    """Return in words how good the forecasts are, and how far that can be believed.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.backtest`.
    """
    models = [str(model) for model in scores["model"].values]
    fits = [model for model in models if model not in (RIVAL, FLOOR, "stay-put")]
    horizons = scores["horizon"].to_numpy()
    last = int(horizons[-1])
    table = score_table(scores, "crps").sel(horizon=last).to_series()
    unit = f" {scores.attrs['unit']}".rstrip()
    ahead = format_number(float(scores["ahead"].values[-1]))
    ranked = sorted(fits, key=lambda name: np.inf if np.isnan(table[name]) else table[name])
    best = ranked[0]
    number = int(scores["number"].sel(horizon=last).sum())
    text = (
        f"{_steps(last)} ahead ({ahead} s), {best} is off by a CRPS of "
        f"{format_number(float(table[best]))}{unit}"
    )
    others = [f"{format_number(float(table[name]))} of {name}" for name in ranked[1:]]
    rivals = [name for name in (RIVAL, FLOOR) if name in models]
    others += [f"{format_number(float(table[name]))} of {_spoken(name)}" for name in rivals]
    if others:
        text += ", beside " + joined(others)
    text += f", over {number} forecasts from {scores.sizes['origin']} frames. "
    if RIVAL in models:
        text += _against_rival(scores, best)
    if FLOOR in models and RIVAL in models:
        closed = float(skill(scores, RIVAL, FLOOR)["crps"].sel(model=best).isel(horizon=0))
        first = f"{_steps(int(horizons[0]))} ahead it"
        text += (
            f"{first} closes {100 * closed:.0f} % of the gap between constant velocity and the "
            "true rule. "
            if closed >= 0
            else f"{first} is farther from the true rule than constant velocity. "
        )
    text += _covered(scores, best)
    trained = [str(name) for name in fits if int(scores["trained_on"].sel(model=name)) > 0]
    if trained:
        text += (
            f" {joined(trained)} had seen some of these frames in training: this is no test of "
            f"{'them' if len(trained) > 1 else 'it'}."
        )
    return text


def _against_rival(scores: xr.Dataset, best: str) -> str:
    """Say at which horizons a model beats constant velocity by more than chance."""
    found = paired_difference(scores, "crps", best, RIVAL)
    low, high = (found["difference"].sel(quantile=q).to_numpy() for q in (0.05, 0.95))
    horizons = [str(int(k)) for k in scores["horizon"].values]
    if np.isnan(low).all():
        return (
            "Whether it is better than constant velocity by more than chance cannot be told: the "
            "origins are too few. "
        )
    better = [k for k, end in zip(horizons, low, strict=True) if end > 0]
    worse = [k for k, end in zip(horizons, high, strict=True) if end < 0]
    if len(better) == len(horizons):
        return "It is better than constant velocity at each horizon, and not by chance. "
    parts = []
    if better:
        parts.append(f"better than constant velocity at {_at(better)}")
    if worse:
        parts.append(f"worse than constant velocity at {_at(worse)}")
    rest = [k for k in horizons if k not in better and k not in worse]
    if not parts:
        return "At no horizon does it differ from constant velocity by more than chance. "
    text = "It is " + " and ".join(parts) + " (90 % intervals)"
    return text + (f"; at {joined(rest)} chance is not ruled out. " if rest else ". ")


def _covered(scores: xr.Dataset, best: str) -> str:
    """Say whether the intervals hold what they promise."""
    levels = scores["level"].to_numpy()
    level = float(levels[np.argmin(np.abs(levels - LEVEL))])
    row = score_table(scores, "coverage", level).sel(model=best).to_numpy()
    low, high = float(np.nanmin(row)), float(np.nanmax(row))
    share = (
        f"{100 * low:.0f} %"
        if f"{100 * low:.0f} %" == f"{100 * high:.0f} %"
        else f"{100 * low:.0f} % to {100 * high:.0f} %"
    )
    text = f"Its {100 * level:.0f} % intervals hold {share} of what came"
    if low < level - TOLERANCE and high > level + TOLERANCE:
        return text + ": too narrow at some horizons, too wide at others."
    if low < level - TOLERANCE:
        return text + ": too narrow, it is surer than it should be."
    if high > level + TOLERANCE:
        return text + ": too wide, it is less sure than it could be."
    return text + ", as they should."


def _steps(number: int) -> str:
    """Return a number of steps in words."""
    return "One step" if number == 1 else f"{number} steps"


def _at(horizons: list[str]) -> str:
    """Return horizons in words."""
    return "one step" if horizons == ["1"] else f"{joined(horizons)} steps"


def _spoken(name: str) -> str:
    """Return the words for a rival."""
    return {RIVAL: "constant velocity", FLOOR: "the true rule"}.get(name, name)
