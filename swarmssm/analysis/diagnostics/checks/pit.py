"""Whether one-step forecasts are as sure as they should be: where in each the next sighting falls.

The probability integral transform (PIT) of a sighting is the probability that its forecast, made
from the past alone, gives to anything smaller. If forecasts are right these are uniform on
[0, 1] (Dawid 1984, J. R. Stat. Soc. A 147:278; Diebold et al. 1998). A hump says that
forecasts are too wide, a trough that they are too narrow, a slope that they lie to one side.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
import xarray as xr

from swarmssm.analysis.diagnostics.sbc.ranks import calibration_of_ranks
from swarmssm.analysis.posterior.subject import Subject, subject_of
from swarmssm.analysis.scoring.forecasters import FitForecaster
from swarmssm.analysis.scoring.table import format_number
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["mixture_pit", "one_step_pit", "pit_sentence", "ranks_of"]

#: Ranks that a PIT is sorted into.
RANKS = 99
#: Frames to forecast from at once, so that memory stays bounded.
AT_ONCE = 100
#: A coverage or a mean PIT is called wrong if it is farther than this from what it should be.
NEARLY = 0.03


def one_step_pit(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    draws: int = 50,
    origins: int = 100,
    part: str | None = None,
    seed: int = 0,
) -> xr.Dataset:
    """Return the PIT of sightings in their one-step forecasts, and whether they are uniform.

    A state-space model's forecast is the mixture over draws of parameters and states of what each
    expects, tracking noise included; that of any other model is told by its draws.

    Parameters
    ----------
    fit, tracks, part
        As in :func:`swarmssm.analysis.diagnostics.checks.check`.
    draws
        Draws of each forecast.
    origins
        Frames to forecast from in each trial at most, spread evenly.
    seed
        Of all draws.

    Returns
    -------
    That of ``calibration_of_ranks`` with a ``parameter``
    for each coordinate, ``dataset`` numbering the sightings; and ``pit (origin, individual,
    space)`` with ``trial`` and ``time (origin)`` of the frame that is forecast from. The band takes
    sightings as independent: of the same individual they are if the model is right, while those
    of neighbours in one frame may not be quite.

    Raises
    ------
    InputError
        If an argument is out of range, or nobody is seen in two consecutive frames.

    References
    ----------
    T. Gneiting, F. Balabdaoui and A. E. Raftery (2007), Probabilistic forecasts, calibration and
    sharpness, J. R. Stat. Soc. B 69.
    """
    for name, value, least in (("draws", draws, 10), ("origins", origins, 1)):
        if value < least:
            raise InputError(f"{name}: it must be at least {least}, and it is {value}.")
    subject = subject_of(fit, tracks, part)
    trials, rows = _origins(subject, origins)
    truth = subject.ahead(trials, rows, 1)[:, 0, :, : subject.num_space]
    forecaster = FitForecaster(subject, "decoder")
    pit = np.concatenate(
        [
            _pit(forecaster, truth[chosen], trials[chosen], rows[chosen], draws, seed)
            for chosen in np.array_split(np.arange(len(rows)), -(-len(rows) // AT_ONCE))
        ]
    )
    names = [str(name) for name in subject.tracks["space"].values]
    # Each coordinate has as many as the others: a sighting is one of all of them.
    ranks = {name: ranks_of(pit[..., axis]) for axis, name in enumerate(names)}
    found = calibration_of_ranks(ranks, RANKS)
    found["pit"] = (
        ("origin", "individual", "space"),
        pit,
        {"units": "1", "long_name": "probability that the forecast gave to less than what came"},
    )
    stamps = subject.tracks["time"].to_numpy()
    trial_names = np.array([str(name) for name in subject.tracks["trial"].values])
    found = found.assign_coords(
        space=names,
        individual=[str(name) for name in subject.tracks["individual"].values],
        trial=("origin", trial_names[trials]),
        time=("origin", stamps[rows], {"units": "s", "long_name": "time of the forecast's frame"}),
    )
    found.attrs |= {"model": fit.settings.model, "part": subject.part, "draws_of_forecast": draws}
    return found


def mixture_pit(truth: Array, location: Array, variance: Array, degrees: float = math.inf) -> Array:
    """Return the probability that a mixture gives to less than what came.

    Parameters
    ----------
    truth
        ``(...)``.
    location, variance
        ``(draw, ...)``, of each part, all of one weight. A part that is not finite puts half of its
        weight to either side.
    degrees
        Of freedom, if the parts are Student's t; else infinite.

    Returns
    -------
    ``(...)``, NaN where the truth is.
    """
    good = np.isfinite(location) & np.isfinite(variance) & (variance > 0)
    error = truth - np.where(good, location, 0.0)
    scale = np.sqrt(np.where(good, variance, 1.0))
    if math.isinf(degrees):
        below: Any = scipy.special.ndtr(error / scale)
    else:
        shrink = math.sqrt((degrees - 2.0) / degrees)
        below = scipy.special.stdtr(degrees, error / (scale * shrink))
    pit = np.where(good, below, 0.5).mean(0)
    return np.where(np.isnan(truth), np.nan, pit).astype(np.float64)


def _origins(subject: Subject, count: int) -> tuple[npt.NDArray[np.int64], ...]:
    """Return trial and row of frames to forecast from, spread evenly over each trial."""
    trials, rows = [], []
    for trial, there in enumerate(subject.mask):
        usable = np.flatnonzero((there[1:] & there[:-1]).any(-1))
        if usable.size:
            chosen = np.unique(np.linspace(0, usable.size - 1, min(count, usable.size)).round())
            rows.append(usable[chosen.astype(np.int64)])
            trials.append(np.full(rows[-1].size, trial))
    return np.concatenate(trials), np.concatenate(rows)


def _pit(
    forecaster: FitForecaster,
    truth: Array,
    trials: npt.NDArray[np.int64],
    rows: npt.NDArray[np.int64],
    draws: int,
    seed: int,
) -> Array:
    """Return ``(origin, individual, space)``."""
    density = forecaster.density(trials, rows, (1,), draws, seed)
    if density.mixture is not None:
        location, variance, degrees = density.mixture
        return mixture_pit(truth, location[:, :, 0], variance[:, :, 0], degrees)
    drawn = density.draws[:, :, 0]
    # Half of the gap between two draws to either side.
    below = (drawn < truth).sum(0) + 0.5 * np.isinf(drawn).sum(0) * np.isfinite(truth)
    pit: Array = (below + 0.5) / (draws + 1.0)
    known = np.isfinite(truth) & ~np.isnan(drawn).any(0)
    return np.where(known, pit, np.nan)


def ranks_of(pit: Array) -> npt.NDArray[np.int64]:
    """Return in which of equal bins each known PIT is."""
    known = pit[np.isfinite(pit)]
    bins: npt.NDArray[np.int64] = np.floor(known * (RANKS + 1)).astype(np.int64)
    return np.clip(bins, 0, RANKS)


def pit_sentence(pit: xr.Dataset) -> str:
    """Say in a sentence what :func:`one_step_pit` found, and how far it can be believed."""
    number = pit.sizes["dataset"]
    coverage = float(pit["coverage"].sel(level=0.9).mean())
    passes = bool(pit["passes"].all())
    spread = f"{100 * coverage:.0f} % of {number} sightings are within their central 90 %"
    if passes:
        return (
            f"One-step forecasts are as sure as they should be: {spread}, and where in their "
            "forecasts they fall is uniform within the 95 % band. This says nothing of runs of "
            "many steps."
        )
    least = float(pit["p_value"].min())
    wrong = []
    if abs(coverage - 0.9) > NEARLY:
        wrong.append("too narrow" if coverage < 0.9 else "too wide")
    middle = pit["pit"].mean([dim for dim in pit["pit"].dims if dim != "space"])
    for name in middle["space"].to_numpy():
        place = float(middle.sel(space=name))
        if abs(place - 0.5) > NEARLY:
            wrong.append(
                f"to one side along {name} (sightings are at {place:.2f} of them, not 0.5)"
            )
    what = " and ".join(wrong) if wrong else "of another shape than what comes"
    return (
        f"One-step forecasts are {what}: {spread}, and where in their forecasts they fall is "
        f"not uniform (p {'= ' + format_number(least, 2) if least > 1e-6 else 'below 1e-6'}). The "
        "p-value takes sightings as independent, which neighbours in one frame are not quite."
    )
