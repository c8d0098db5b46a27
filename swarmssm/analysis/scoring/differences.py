"""Whether one model is better than another by more than chance: paired differences."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy
import xarray as xr

from swarmssm.analysis.posterior.intervals import QUANTILES
from swarmssm.analysis.scoring.scores import SCORES
from swarmssm.analysis.scoring.summaries import at_level, check_model
from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["block_length", "moving_blocks", "paired_difference", "score_intervals"]

Rows = npt.NDArray[np.int64]
#: Fewer blocks than these cannot tell how much chance there is in their mean.
LEAST_BLOCKS = 5


def paired_difference(
    scores: xr.Dataset,
    score: str,
    model: str,
    reference: str,
    *,
    resamples: int = 4000,
    block: int | None = None,
    seed: int = 0,
) -> xr.Dataset:
    """Return how much better a model is than another, with a moving-block bootstrap interval.

    Origin by origin, so that what makes some frames hard for both cancels. Forecasts from
    neighbouring origins err together; blocks of them are therefore drawn, each within a trial.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    score
        One of :data:`swarmssm.analysis.scoring.SCORES` in which higher or lower is better.
    model, reference
        Names.
    resamples
        Of the bootstrap.
    block
        Origins in a block. Absent: at each horizon so many that blocks reach beyond it, and at
        least the cube root of their number.
    seed
        Of the bootstrap.

    Returns
    -------
    ``difference (horizon, quantile)``: positive where ``model`` is better, in the score's unit;
    quantile 0.5 is the observed mean difference, the ends those of the central 90 % interval,
    widened as Student's t is where blocks are few.
    ``se (horizon)``: standard deviation over resamples. ``block (horizon)`` and ``blocks
    (horizon)``: origins in a block, and how many fit into the origins; with fewer than five the
    interval says little, and is NaN.

    Raises
    ------
    InputError
        If there is no such score or model, or an argument is out of range.

    References
    ----------
    H. R. Künsch (1989), The jackknife and the bootstrap for general stationary observations, Ann.
    Statist. 17.
    """
    comparable = [name for name, one in SCORES.items() if one.sign]
    if score not in comparable:
        raise InputError(
            f"score: {score!r} cannot be compared; choose one of {', '.join(comparable)}."
        )
    check_model(scores, model, "model")
    check_model(scores, reference, "reference")
    if resamples < 100:
        raise InputError(f"resamples: there must be at least 100, not {resamples}.")
    if block is not None and block < 1:
        raise InputError(f"block: it must be at least 1 origin, and it is {block}.")
    values = at_level(scores, score, 0.0)
    sign = SCORES[score].sign
    with np.errstate(invalid="ignore"):
        apart = sign * (values.sel(model=model) - values.sel(model=reference)).to_numpy()
    found = _over_horizons(scores, apart, resamples, block, seed)
    units = scores[score].attrs["units"]
    name = f"{score} of {model} better than of {reference} by"
    return xr.Dataset(
        {
            "difference": (
                ("horizon", "quantile"),
                found.ends,
                {"units": units, "long_name": name},
            ),
            "se": ("horizon", found.errors, {"units": units, "long_name": "standard error"}),
            "block": ("horizon", found.lengths, {"units": "1", "long_name": "origins in a block"}),
            "blocks": ("horizon", found.counts, {"units": "1", "long_name": "blocks in them all"}),
        },
        {
            "horizon": scores["horizon"],
            "ahead": scores["ahead"],
            "quantile": ("quantile", list(QUANTILES), {"units": "1", "long_name": "quantile"}),
        },
        {"score": score, "model": model, "reference": reference, "resamples": resamples},
    )


def score_intervals(
    scores: xr.Dataset, score: str, level: float = 0.9, *, resamples: int = 1000, seed: int = 0
) -> xr.DataArray:
    """Return mean scores with intervals of the moving-block bootstrap, for each model by itself.

    Two models whose intervals overlap may yet differ for sure: see :func:`paired_difference`.

    Parameters
    ----------
    scores, score, level
        As in :func:`swarmssm.analysis.scoring.score_table`.
    resamples, seed
        Of the bootstrap.

    Returns
    -------
    ``(model, horizon, quantile)``; the ends are NaN where there are fewer than five blocks.
    """
    values = at_level(scores, score, level)
    rows = [
        _over_horizons(scores, values.sel(model=name).to_numpy(), resamples, None, seed).ends
        for name in scores["model"].values
    ]
    coords = {name: scores[name] for name in ("model", "title", "horizon", "ahead")}
    coords["quantile"] = xr.DataArray(list(QUANTILES), dims="quantile", attrs={"units": "1"})
    dims = ("model", "horizon", "quantile")
    return xr.DataArray(np.stack(rows), coords, dims, attrs=dict(scores[score].attrs))


class _Found(NamedTuple):
    """Of each horizon: ends and middle, standard error, origins in a block, number of blocks."""

    ends: Array
    errors: Array
    lengths: Rows
    counts: Rows


def _over_horizons(
    scores: xr.Dataset, values: Array, resamples: int, block: int | None, seed: int
) -> _Found:
    """Bootstrap the mean of values ``(origin, horizon)``, weighted by the individuals counted."""
    number = scores["number"].to_numpy().astype(np.float64)
    trials, frames = scores["trial"].to_numpy(), scores["frame"].to_numpy()
    generator = np.random.default_rng(seed)
    horizons = scores["horizon"].to_numpy()
    size = len(horizons)
    ends, errors = np.full((size, len(QUANTILES)), np.nan), np.full(size, np.nan)
    lengths, counts = np.zeros(size, np.int64), np.zeros(size, np.int64)
    for place, horizon in enumerate(horizons):
        use = number[:, place] > 0
        each, weight = values[use, place], number[use, place]
        if not use.any() or np.isnan(each).any():
            continue
        length = block or block_length(trials[use], frames[use], int(horizon))
        lengths[place], counts[place] = length, _blocks(trials[use], length)
        ends[place, 1] = np.average(each, weights=weight)
        if counts[place] < LEAST_BLOCKS:
            continue
        rows = moving_blocks(trials[use], length, resamples, generator)
        means = (each[rows] * weight[rows]).sum(-1) / weight[rows].sum(-1)
        ends[place, [0, 2]], errors[place] = _interval(means, ends[place, 1], counts[place])
    return _Found(ends, errors, lengths, counts)


def _interval(means: Array, middle: float, blocks: int) -> tuple[Array, float]:
    """Return ends of the interval and standard error; of few blocks, widened as Student's t is."""
    ends = (QUANTILES[0], QUANTILES[-1])
    if not np.isfinite(means).all():
        return np.quantile(means, ends, method="inverted_cdf"), math.inf
    wider = math.sqrt(blocks / (blocks - 1))
    heavier = scipy.stats.t.ppf(ends[1], blocks - 1) / scipy.stats.norm.ppf(ends[1])
    apart = np.quantile(means, ends) - middle
    return middle + wider * heavier * apart, wider * float(means.std())


def block_length(trials: npt.NDArray[np.str_], frames: Rows, horizon: int) -> int:
    """Return how many origins stand in a block.

    Forecasts that reach into the same frames are not independent: a block spans at least the
    horizon. At least the cube root of the number of origins, as is usual where nothing else is
    known of how long they remember.

    Parameters
    ----------
    trials, frames
        ``(origin,)``.
    horizon
        Steps.
    """
    same = trials[1:] == trials[:-1]
    gaps = np.diff(frames)[same]
    gap = float(np.median(gaps)) if gaps.size else math.inf
    return max(1, math.ceil(horizon / gap), math.ceil(math.cbrt(len(frames))))


def moving_blocks(
    trials: npt.NDArray[np.str_], length: int, resamples: int, generator: np.random.Generator
) -> Rows:
    """Return places of origins drawn in blocks of consecutive ones, none across two trials.

    Each origin of any trial may begin a block; what reaches beyond the trial's end goes on at its
    beginning, so that all origins are drawn alike, and whole trials where these are shorter.

    Parameters
    ----------
    trials
        ``(origin,)``, those of a trial together.
    length
        Origins in a block.
    resamples
        How many.
    generator
        Of the draws.

    Returns
    -------
    ``(resample, origin)``.

    References
    ----------
    D. N. Politis and J. P. Romano (1992), A circular block-resampling procedure for stationary
    data, in: Exploring the Limits of Bootstrap.
    """
    count = len(trials)
    _, first, own, size = np.unique(
        trials, return_index=True, return_inverse=True, return_counts=True
    )
    starts = generator.integers(0, count, (resamples, math.ceil(count / length)))
    begins, sizes = first[own[starts]][..., None], size[own[starts]][..., None]
    places = begins + (starts[..., None] - begins + np.arange(length)) % sizes
    return places.reshape(resamples, -1)[:, :count]


def _blocks(trials: npt.NDArray[np.str_], length: int) -> int:
    """Return how many blocks the origins hold."""
    _, counts = np.unique(trials, return_counts=True)
    whole: list[int] = counts.tolist()
    return sum(max(1, count // length) for count in whole)
