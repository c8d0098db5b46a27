"""What scores show: one line, and a table with a row a method."""

from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.scoring.differences import paired_difference
from swarmssm.analysis.scoring.references import REFERENCES
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.analysis.scoring.table import format_number
from swarmssm.errors import InputError

__all__ = ["Skill", "best_reference", "fitted_methods", "skill_at", "summary", "verdict"]

#: Of the intervals whose coverage is given.
LEVEL = 0.9
#: Estimated from so few numbers, a coverage this far off is chance.
TOLERANCE = 0.05


class Skill(NamedTuple):
    """How much lower the CRPS of a method is than that of a reference, as a share of the latter."""

    value: float
    low: float
    high: float
    reference: str

    @property
    def differs(self) -> int:
        """1 where the method is better by the 90 % interval, -1 where it is worse, else 0."""
        return int(self.low > 0.0) - int(self.high < 0.0)


def fitted_methods(scores: xr.Dataset) -> list[str]:
    """Return the methods that were asked for, the lowest CRPS at the last horizon first."""
    last = score_table(scores, "crps").isel(horizon=-1).to_series()
    names = [str(name) for name in scores["model"].values[scores["fitted"].values]]
    return sorted(names, key=lambda name: np.inf if np.isnan(last[name]) else last[name])


def best_reference(scores: xr.Dataset, horizon: int) -> str:
    """Return staying put or constant velocity, whichever has the lower CRPS.

    Raises
    ------
    InputError
        If neither was scored.
    """
    table = score_table(scores, "crps").sel(horizon=horizon).to_series()
    names = [name for name in REFERENCES if name in table.index]
    if not names:
        raise InputError("scores: no reference was scored; score with references=True.")
    return min(names, key=lambda name: np.inf if np.isnan(table[name]) else table[name])


def skill_at(scores: xr.Dataset, model: str, horizon: int) -> Skill:
    """Return the CRPS skill of a method over the best reference, with its 90 % interval.

    The interval is that of :func:`swarmssm.analysis.scoring.paired_difference`, divided by the CRPS
    of the reference; NaN where origins are too few.
    """
    reference = best_reference(scores, horizon)
    base = float(score_table(scores, "crps").sel(model=reference, horizon=horizon))
    found = paired_difference(scores, "crps", model, reference).sel(horizon=horizon)
    with np.errstate(divide="ignore", invalid="ignore"):
        low, middle, high = (found["difference"].to_numpy() / base).tolist()
    return Skill(middle, low, high, reference)


def verdict(scores: xr.Dataset, model: str | None = None) -> str:
    """Return one line: skill over the best simple baseline with interval, and coverage.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`, with references.
    model
        One of its methods; absent, the one with the lowest CRPS at the last horizon.

    Raises
    ------
    InputError
        If there is no such model, or no reference was scored.
    """
    model = model or fitted_methods(scores)[0]
    horizons = [int(k) for k in scores["horizon"].values]
    last = horizons[-1]
    own = skill_at(scores, model, last)
    ahead = format_number(float(scores["ahead"].values[-1]))
    steps = "one step" if last == 1 else f"{last} steps"
    where = f"{steps} ({ahead} s) ahead"
    title = str(scores["title"].sel(model=own.reference).item())
    if not np.isfinite(own.value):
        text = f"{model}: forecasts diverge {where}"
    else:
        share = f"{100 * abs(own.value):.0f} % {'lower' if own.value >= 0 else 'higher'}"
        text = f"{model}: CRPS {where} {share} than {title}"
        if np.isnan(own.low):
            text += " (too few origins for an interval)"
        else:
            text += f" (skill {100 * own.value:.0f} %, 90 % interval {100 * own.low:.0f} to "
            text += f"{100 * own.high:.0f} %)"
            text += ("; no clear difference", "", "; worse than this simple baseline")[own.differs]
    nearer = [k for k in horizons[:-1] if skill_at(scores, model, k).differs < 0]
    if nearer and own.differs >= 0:
        text += f"; worse at {joined([str(k) for k in nearer])} steps"
    text += f". {_covered(scores, model)}"
    if int(scores["trained_on"].sel(model=model)) > 0:
        text += f" {model} was trained on scored frames: this is not a test."
    return text


def summary(scores: xr.Dataset) -> pd.DataFrame:
    """Return a row a method, indexed by ``model``, at each horizon.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`, with references.

    Returns
    -------
    Columns ``(score, horizon)``: ``skill``, ``skill_low`` and ``skill_high`` over the best
    reference, ``crps``, ``log_score``, and ``coverage`` of the 90 % interval (or the nearest
    level).
    """
    columns = {}
    names = [str(name) for name in scores["model"].values]
    for k in (int(k) for k in scores["horizon"].values):
        found = [skill_at(scores, name, k) for name in names]
        columns["skill", k] = [one.value for one in found]
        columns["skill_low", k] = [one.low for one in found]
        columns["skill_high", k] = [one.high for one in found]
    for name in ("crps", "log_score", "coverage"):
        table = score_table(scores, name, _level(scores))
        for k in (int(k) for k in scores["horizon"].values):
            columns[name, k] = table.sel(horizon=k).to_numpy().tolist()
    frame = pd.DataFrame(columns, index=pd.Index(names, name="model"))
    return frame.rename_axis(columns=["score", "horizon"])


def _level(scores: xr.Dataset) -> float:
    """Return the level of intervals that is nearest to 90 %."""
    levels = scores["level"].to_numpy()
    return float(levels[np.argmin(np.abs(levels - LEVEL))])


def _covered(scores: xr.Dataset, model: str) -> str:
    """Tell the coverage of the intervals, over all horizons."""
    level = _level(scores)
    row = score_table(scores, "coverage", level).sel(model=model).to_numpy()
    row = row[~np.isnan(row)]
    if not row.size:
        return "Its intervals could not be scored."
    low, high = (f"{100 * end:.0f} %" for end in (row.min(), row.max()))
    text = f"Its {100 * level:.0f} % intervals contain {low if low == high else f'{low} to {high}'}"
    narrow, wide = row.min() < level - TOLERANCE, row.max() > level + TOLERANCE
    if narrow and wide:
        return f"{text} of observations: too narrow at some horizons, too wide at others."
    return f"{text} of observations{': too narrow' if narrow else ': too wide' if wide else ''}."
