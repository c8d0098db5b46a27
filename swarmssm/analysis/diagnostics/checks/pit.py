"""Calibration of one-step forecasts by the probability integral transform.

The probability integral transform (PIT) of an observation is the probability that its forecast,
made from the past alone, gives to smaller values. If forecasts are calibrated, PITs are uniform on
[0, 1] (Dawid 1984, J. R. Stat. Soc. A 147:278; Diebold et al. 1998). A hump means that
forecasts are too wide, a trough that they are too narrow, a slope that they are biased.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import scipy
import xarray as xr

from swarmssm.analysis.diagnostics.sbc.ranks import Calibration, calibration_of_ranks
from swarmssm.analysis.posterior.subject import Subject, subject_of
from swarmssm.analysis.scoring.forecasters import FitForecaster
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["ForecastCalibration", "calibration_of_pit", "mixture_pit", "one_step_pit"]

#: Number of ranks less one into which PITs are sorted.
RANKS = 99
#: Origins of forecasts at once; bounds the memory.
AT_ONCE = 100
#: Deviation of a coverage or a mean PIT from which a verdict names it.
DEVIATION = 0.03


@dataclass(frozen=True)
class ForecastCalibration(Calibration):
    """Result of :func:`one_step_pit` and :func:`loo_pit`.

    Attributes
    ----------
    data
        Those of ``calibration_of_ranks`` with a ``parameter`` for each coordinate, and ``pit``.
    """

    def summary(self) -> pd.DataFrame:
        """Return a row for each coordinate: ``in_band``, ``p_value``, ``mean_pit``, coverage."""
        frame = super().summary().rename_axis("coordinate")
        other = [dim for dim in self.data["pit"].dims if dim != "space"]
        frame.insert(2, "mean_pit", self.data["pit"].mean(other).to_numpy())
        return frame

    def to_pandas(self) -> pd.DataFrame:
        """Return a row for each observed coordinate with its ``pit``."""
        return self.data["pit"].to_dataframe()[["pit"]].dropna().reset_index()

    def verdict(self) -> str:
        """Return in one line whether one-step forecasts are calibrated."""
        frame = self.summary()
        coverage = float(frame["coverage_90"].mean())
        wrong = []
        if abs(coverage - 0.9) > DEVIATION:
            wrong.append("too narrow" if coverage < 0.9 else "too wide")
        wrong += [
            f"biased along {name} (mean PIT {mean:.2f})"
            for name, mean in frame["mean_pit"].items()
            if abs(mean - 0.5) > DEVIATION
        ]
        tail = (
            f"90 % intervals hold {100 * coverage:.0f} % of {self.data.sizes['dataset']} "
            f"observations; smallest p {float(frame['p_value'].min()):.2g}, taking them as "
            "independent."
        )
        if bool(frame["in_band"].all()):
            return f"One-step forecasts are calibrated: {tail}"
        return f"One-step forecasts are {' and '.join(wrong) or 'of another shape'}: {tail}"


def calibration_of_pit(pit: Array, names: Sequence[str]) -> xr.Dataset:
    """Return the calibration of PITs ``(..., space)``, NaN left out.

    Parameters
    ----------
    pit
        From 0 to 1.
    names
        Of the coordinates.
    """
    ranks = {}
    for axis, name in enumerate(names):
        known = pit[..., axis][np.isfinite(pit[..., axis])]
        bins: npt.NDArray[np.int64] = np.floor(known * (RANKS + 1)).astype(np.int64)
        ranks[name] = np.clip(bins, 0, RANKS)
    return calibration_of_ranks(ranks, RANKS)


def one_step_pit(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    draws: int = 50,
    origins: int = 100,
    part: str | None = None,
    seed: int = 0,
) -> ForecastCalibration:
    """Return the PIT of observations in their one-step forecasts, and whether they are uniform.

    The forecast of a state-space model is a mixture over draws of parameters and states, tracking
    noise included; that of any other model is given by its draws.

    Parameters
    ----------
    fit, tracks, part
        As in :func:`swarmssm.analysis.diagnostics.checks.check`.
    draws
        Draws for each forecast.
    origins
        Largest number of frames to forecast from in each trial, spread evenly.
    seed
        Seed of all draws.

    Returns
    -------
    Its ``data`` are those of ``calibration_of_ranks`` with a ``parameter`` for each coordinate,
    ``dataset`` numbering the observations; and ``pit (origin, individual, space)`` with ``trial``
    and ``time (origin)`` of the frame that is forecast from. The band takes observations as
    independent: those of one individual are if the model is right, those of neighbours in one
    frame may not be.

    Raises
    ------
    InputError
        If an argument is out of range, or no individual is observed in two consecutive frames.

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
    found = calibration_of_pit(pit, names)
    found["pit"] = (
        ("origin", "individual", "space"),
        pit,
        {"units": "1", "long_name": "probability of smaller values in the forecast"},
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
    return ForecastCalibration(found)


def mixture_pit(truth: Array, location: Array, variance: Array, degrees: float = math.inf) -> Array:
    """Return the probability that a mixture gives to values below the observed.

    Parameters
    ----------
    truth
        ``(...)``.
    location, variance
        ``(draw, ...)``, of each component, all of equal weight. A component that is not finite has
        half of its weight on either side.
    degrees
        Degrees of freedom of Student's t components; infinite for normal ones.

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
