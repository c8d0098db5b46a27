"""Ranking by forecasts of held-out frames."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr

from swarmssm.analysis.scoring.differences import paired_difference
from swarmssm.analysis.scoring.fairness import held_out_frames
from swarmssm.analysis.scoring.ranking import NOISE_FLOOR, ranked, ranking
from swarmssm.analysis.scoring.rolling_origin import score
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.errors import InputError
from swarmssm.inference import Fit

__all__ = ["by_forecasts"]


def by_forecasts(
    fits: Mapping[str, Fit],
    tracks: xr.Dataset,
    part: str | None,
    horizons: Sequence[int],
    origins: int,
    draws: int,
    allow_seen: bool,
    seed: int,
    progress: Callable[[str], None] | None,
) -> xr.Dataset:
    """Rank by the log score of forecasts, averaged over horizons."""
    held_out_frames(fits, tracks, part, allow_seen=allow_seen)
    scores = score(
        fits,
        tracks,
        horizons=horizons,
        origins=origins,
        draws=draws,
        part=part,
        seed=seed,
        progress=None
        if progress is None
        else lambda now: progress(f"forecasting, {now.done} of {now.total}"),
    )
    used = [int(k) for k in scores["horizon"].values]
    whole = _over_horizons(scores)
    table = score_table(scores, "log_score")
    mean = score_table(whole, "log_score").isel(horizon=0).to_series()
    order = ranked({str(n): float(v) for n, v in mean.items()}, last=(NOISE_FLOOR,))
    best = next(name for name in order if name != NOISE_FLOOR)
    difference, error = {best: 0.0}, {best: 0.0}
    for name in order:
        if name != best:
            found = paired_difference(whole, "log_score", best, name, seed=seed).isel(horizon=0)
            difference[name] = float(found["difference"].sel(quantile=0.5))
            error[name] = float(found["se"])
    notes = [str(note) for note in scores.attrs["notes"]]
    if math.isnan(sum(error.values())):
        notes.append(
            "There are too few origins for standard errors; judge on more frames, or from more "
            "origins."
        )
    result = ranking(
        order,
        {name: float(mean[name]) for name in order},
        {name: _own_error(whole, name, seed) for name in order},
        difference,
        error,
        set(fits),
        "nat per coordinate",
    )
    result["log_score"] = table.sel(model=order).drop_vars(["title", "fitted"], errors="ignore")
    result.attrs |= {
        "method": "held-out",
        "part": scores.attrs["part"],
        "horizons": used,
        "origins": int(scores.sizes["origin"]),
        "draws": draws,
        "seed": seed,
        "unit": str(tracks.attrs.get("unit", "")),
        "notes": notes,
    }
    return result


def _over_horizons(scores: xr.Dataset) -> xr.Dataset:
    """Return the mean over horizons, at the origins that have them all, as one horizon."""
    known = (scores["number"] > 0).all("horizon").to_numpy()
    if not known.any():
        raise InputError(
            "horizons: no origin has room for all of them; take nearer ones, or more frames."
        )
    kept = scores.isel(origin=np.flatnonzero(known))
    mean = kept[["log_score"]].mean("horizon", skipna=False, keep_attrs=True)
    mean = mean.expand_dims("horizon", axis=-1)
    # Blocks of the bootstrap must reach beyond the longest horizon.
    mean = mean.assign_coords(
        horizon=scores["horizon"][-1:], ahead=("horizon", scores["ahead"].to_numpy()[-1:])
    )
    mean["log_score"] = mean["log_score"].transpose("model", "origin", "horizon")
    mean["number"] = kept["number"].isel(horizon=slice(-1, None))
    return mean


def _own_error(whole: xr.Dataset, name: str, seed: int) -> float:
    """Return the standard error of one score, by the bootstrap of the differences from nothing."""
    own = whole["log_score"].sel(model=name).to_numpy()
    both = whole.drop_dims("model").assign(
        log_score=(("model", "origin", "horizon"), np.stack([own, np.zeros_like(own)])),
        number=whole["number"],
    )
    both = both.assign_coords(model=[name, "nothing"])
    both["log_score"].attrs = whole["log_score"].attrs
    found = paired_difference(both, "log_score", name, "nothing", seed=seed)
    return float(found["se"].isel(horizon=0))
