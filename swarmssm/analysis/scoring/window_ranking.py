"""Ranking by the densities of windows that are left out of what a model has learned."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.analysis.posterior.foresight import predict_one_step
from swarmssm.analysis.posterior.log_likelihood import Window, window_sums, windows_over
from swarmssm.analysis.scoring.importance import LeftOut, good_k, psis_lfo, psis_loo
from swarmssm.analysis.scoring.ranking import ranked, ranking
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array, with_trials
from swarmssm.tracks.splits import Segment

__all__ = ["by_windows"]

#: With at least so many trials these are left out as they are; else they are cut into windows.
ENOUGH_TRIALS = 10
#: About so many windows are made, of at least so many frames.
WINDOWS, LEAST_FRAMES = 30, 10
#: Of fewer windows a standard error says little.
FEW = 10
Mask = npt.NDArray[np.bool_]


def by_windows(
    fits: Mapping[str, Fit],
    tracks: xr.Dataset,
    method: str,
    segments: Sequence[Segment],
    part: str,
    draws: int,
    window: int | None,
    seed: int,
    progress: Callable[[str], None] | None,
    notes: list[str],
) -> xr.Dataset:
    """Rank by the windows' expected log predictive densities."""
    densities: dict[str, Mask] = {}
    joints: dict[str, Array] = {}
    hows: dict[str, str] = {}
    for name, fit in fits.items():
        if progress is not None:
            progress(f"filtering with {name}")
        found = predict_one_step(fit, tracks, draws, seed)
        densities[name] = np.logical_and.reduce(~np.isnan(found.density), axis=0)
        joints[name], hows[name] = found.joint, found.how
    scored, more = _common(densities)
    scored &= _after_given(fits, scored)
    if not scored.any():
        raise InputError("tracks: the trials are too short for anything to be scored.")
    notes = [*notes, *more]
    labels = [str(name) for name in with_trials(tracks)["trial"].values]
    windows = windows_over(scored, labels, segments, window or _length(segments, window))
    leave = psis_loo if method == "loo" else psis_lfo
    results = {
        name: leave(_all_draws(window_sums(np.where(scored, joint, 0.0), windows), draws))
        for name, joint in joints.items()
    }
    total = {name: float(result.elpd.sum()) for name, result in results.items()}
    order = ranked(total)
    best = order[0]
    apart = {name: results[best].elpd - results[name].elpd for name in order}
    count = len(windows)
    result = ranking(
        order,
        total,
        {name: _sum_error(results[name].elpd) for name in order},
        {name: float(apart[name].sum()) for name in order},
        {name: _sum_error(apart[name]) for name in order},
        set(fits),
        "nat",
    )
    over = ("model", "window")
    for variable, words in (
        ("elpd", "expected log predictive density of a window"),
        ("pareto_k", "shape of the tail of the weights"),
        ("believed", "the weights can be believed"),
    ):
        attribute = "learned" if variable == "believed" else variable
        values = np.stack([getattr(results[name], attribute) for name in order])
        units = "nat" if variable == "elpd" else "1"
        result[variable] = (over, values, {"units": units, "long_name": words})
    if method == "loo":
        result["effective_parameters"] = (
            "model",
            [float((results[n].in_sample - results[n].elpd).sum()) for n in order],
            {"units": "1", "long_name": "by how much frames are better known for having been seen"},
        )
    result = result.assign_coords(
        trial=("window", [labels[w.trial] for w in windows]),
        start=("window", [w.start for w in windows]),
        stop=("window", [w.stop for w in windows]),
    )
    notes += _words_of_k(results, method, draws)
    notes += _words_of_windows(windows, count)
    if len(set(hows.values())) > 1:
        notes.append(
            "The models' densities are not computed alike: "
            + "; ".join(f"{name}: {how}" for name, how in hows.items())
            + "."
        )
    result.attrs |= {
        "method": method,
        "part": part,
        "draws": draws,
        "windows": count,
        "positions": int(sum(_positions(densities, scored, w) for w in windows)),
        "seed": seed,
        "unit": str(tracks.attrs.get("unit", "")),
        "notes": notes,
    }
    return result


def _common(densities: Mapping[str, Mask]) -> tuple[Mask, list[str]]:
    """Return the frames in which all models forecast the same positions, ``(trial, time)``."""
    masks = list(densities.values())
    same = np.logical_and.reduce([(mask == masks[0]).all(-1) for mask in masks])
    scored: Mask = same & masks[0].any(-1)
    dropped = int((np.logical_or.reduce([mask.any(-1) for mask in masks]) & ~same).sum())
    if not scored.any():
        raise InputError("fits: they forecast no frame in common, so that they cannot be compared.")
    if not dropped:
        return scored, []
    return scored, [
        f"{dropped} frames are left out in which the models do not forecast the same individuals."
    ]


def _after_given(fits: Mapping[str, Fit], scored: Mask) -> Mask:
    """Return the frames of each trial after those that a fit takes as given.

    Few groups begin as a law of first states says, so that fits leave the beginning out of their
    likelihood; a posterior that has not learned from it cannot forget it.
    """
    given = max(int(getattr(fit.guide, "given", 0)) for fit in fits.values())
    begun = scored.cumsum(1)
    quarter = begun.max(1, keepdims=True, initial=0) // 4
    after: Mask = begun > np.minimum(given, quarter)
    return after


def _positions(densities: Mapping[str, Mask], scored: Mask, window: Window) -> int:
    """Return how many positions a window has."""
    mask = next(iter(densities.values())) & scored[..., None]
    return int(mask[window.trial, window.start : window.stop].sum())


def _all_draws(values: Array, draws: int) -> Array:
    """Return a row for each draw where there is but one."""
    return np.ascontiguousarray(np.broadcast_to(values, (draws, values.shape[1])))


def _length(segments: Sequence[Segment], window: int | None) -> int | None:
    """Return how many frames a window has if nobody said so."""
    if window is not None or len(segments) >= ENOUGH_TRIALS:
        return window
    frames = sum(s.stop - s.start for s in segments)
    return max(LEAST_FRAMES, frames // WINDOWS)


def _sum_error(values: Array) -> float:
    """Return the standard error of a sum of independent terms; NaN of a single one."""
    if len(values) < 2 or not np.isfinite(values).all():
        return math.nan
    return float(math.sqrt(len(values)) * values.std(ddof=1))


def _words_of_k(results: Mapping[str, LeftOut], method: str, draws: int) -> list[str]:
    """Return what the tails of the weights say, in words."""
    notes = []
    limit = good_k(draws)
    for name, result in results.items():
        bad = int((~result.learned).sum())
        if not bad:
            continue
        worst = float(np.nanmax(result.pareto_k))
        many = f"{bad} of {len(result.elpd)} windows"
        if method == "lfo":
            first = int(np.flatnonzero(~result.learned)[0]) + 1
            notes.append(
                f"{name}: from window {first} of {len(result.elpd)} on, its parameters no longer "
                f"learn from the frames before (Pareto k {worst:.2f} at most, above {limit:.2f}): "
                "the weights cannot be believed, and a new fit would be needed. Its scores there "
                "are of what it knew until then."
            )
        else:
            notes.append(
                f"{name}: {many} move its posterior so much that it is unknown without them "
                f"(Pareto k up to {worst:.2f}, above {limit:.2f}): its score is presumably too "
                "high. Take shorter windows, more draws, or method held-out."
            )
    return notes


def _words_of_windows(windows: Sequence[Window], count: int) -> list[str]:
    """Return what the standard errors rest on, in words."""
    notes = []
    if count < FEW:
        notes.append(f"There are only {count} windows: standard errors of so few say little.")
    if len({w.trial for w in windows}) < count:
        notes.append(
            "Windows of one trial follow each other and are not quite independent: standard "
            "errors may be too small."
        )
    return notes
