"""Rolling-origin backtest: all rivals forecast the same positions from the same frames."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.analysis.scoring.densities import SCORES, batches, mean_scores, position_scores
from swarmssm.analysis.scoring.forecasters import (
    BaselineForecaster,
    Forecaster,
    LawForecaster,
    ModelForecaster,
    law_forecaster,
)
from swarmssm.analysis.scoring.frames import ScoredFrames, common_frames, rolling_origins
from swarmssm.analysis.scoring.references import REFERENCES
from swarmssm.analysis.scoring.subject import Subject, subject_of
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.jobs import Progress
from swarmssm.tracks import Array, validate_tracks, with_trials

__all__ = ["HORIZONS", "LEVELS", "backtest"]

Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
HORIZONS = (1, 2, 5, 10, 20)
LEVELS = (0.5, 0.8, 0.9)
#: With fewer sampled futures their covariance and the ends of their intervals say little.
LEAST_DRAWS = 10
NOISE_FLOOR = "noise-floor"
LONG_NAMES = {
    "log_score": "log score of an individual's position, per coordinate",
    "crps": "continuous ranked probability score of a coordinate",
    "energy_score": "energy score of an individual's position",
    "mse": "squared error of the forecast's mean, per coordinate",
    "coverage": "share of coordinates inside the central interval",
    "width": "width of the central interval of a coordinate",
}


def backtest(
    fits: Mapping[str, Fit],
    tracks: xr.Dataset,
    *,
    horizons: Sequence[int] = HORIZONS,
    origins: int = 40,
    draws: int = 100,
    part: str | None = None,
    seed: int = 0,
    levels: Sequence[float] = LEVELS,
    baselines: bool = True,
    progress: Callable[[Progress], None] | None = None,
) -> xr.Dataset:
    """Forecast from many held-out frames, and score what came by proper scores.

    All models go on from the same frames, knowing these and those before alone, and are scored on
    the same individuals: those that all of them forecast and whose position is then seen. The fits
    may differ in anything - model, guide, scaler, velocities, graph, split - since positions are
    forecast in the tracks' own unit. A forecast that breaks down is infinitely bad, and counts.

    What a model says is the density of an individual's position as it will be seen, tracking noise
    included. Of a fit these are ``draws`` sampled futures (parameters, states and steps drawn), of
    the true rule of simulated tracks too; a baseline's is a normal about what it expects, with the
    covariance of its own errors at that horizon in the training part.

    Parameters
    ----------
    fits
        Name -> fit. The first one's velocities are also the baselines'.
    tracks
        Those the models were fitted on, or others.
    horizons
        Rising numbers of frames ahead; those that the scored frames are too short for are left
        out, and a note says so.
    origins
        Number of frames of each trial to go on from, spread evenly.
    draws
        Sampled futures from each.
    part
        ``"test"``, ``"validation"``, ``"train"`` or ``"all"``. Absent: what each fit holds out (its
        test part, else its validation part) of its own tracks, and all of any others; of fits that
        were split in different ways, what they have in common.
    seed
        Of all draws.
    levels
        Of the central intervals, between 0 and 1.
    baselines
        Whether staying put and constant velocity are rivals.
    progress
        Called with a ``Progress`` of batches.

    Returns
    -------
    Dataset over ``model`` (the fits, ``stay-put``, ``constant-velocity`` and, for simulated tracks,
    ``noise-floor``), ``origin``, ``horizon`` and ``level``, each score a mean over the ``number
    (origin, horizon)`` of individuals counted:

    - ``log_score``, nats per coordinate, higher is better: see
      :func:`swarmssm.metrics.mixture_log_score` (other models: the normal with the draws' moments);
    - ``crps``, mean over coordinates, and ``energy_score`` of an individual's position, lower is
      better: the fair estimators, see :func:`swarmssm.metrics.ensemble_crps`;
    - ``mse`` of the forecast's mean, per coordinate;
    - ``coverage`` and ``width`` of the central interval of a coordinate.

    Coordinates ``trial``, ``frame`` (row of the tracks) and ``time`` say where the origins are,
    ``ahead`` how many seconds each horizon is; ``trained_on (model)`` is the number of scored
    frames that a model was trained on. ``attrs["notes"]`` is what a reader has to know.

    Raises
    ------
    InputError
        If there is no fit, a name is taken, an argument is out of range, the fits hold out no
        frames in common, or there is nothing to score.

    References
    ----------
    L. J. Tashman (2000), Out-of-sample tests of forecasting accuracy, Int. J. Forecasting 16.
    T. Gneiting and A. E. Raftery (2007), Strictly proper scoring rules, prediction, and
    estimation, JASA 102.
    """
    _check(fits, horizons, origins, draws, seed, levels)
    tracks = validate_tracks(tracks)
    frames = common_frames(fits, tracks, part)
    subjects = {n: subject_of(fit, tracks, segments=frames.segments) for n, fit in fits.items()}
    # The baselines learn the spread of their errors where somebody has a training part.
    first = next(iter(subjects.values()))
    training = next((s.training for s in subjects.values() if s.training is not None), None)
    notes = [*frames.notes]
    forecasters: dict[str, Forecaster] = {
        name: ModelForecaster(subject, "decoder") for name, subject in subjects.items()
    }
    if baselines:
        forecasters |= {
            name: BaselineForecaster(first, kind()) for name, kind in REFERENCES.items()
        }
        if training is None:
            notes.append(
                "The spread of the baselines' forecasts is that of their errors on the scored "
                "frames themselves: their scores flatter them."
            )
    seen = np.logical_and.reduce([subject.mask for subject in subjects.values()])
    startable = np.logical_and.reduce([_known_at(one) for one in subjects.values()]).any(-1)
    law = _law(subjects)
    if law is not None:
        if 2 * (startable & law.whole).sum() >= startable.sum():
            startable, forecasters[NOISE_FLOOR] = startable & law.whole, law
        else:
            notes.append(
                "The true rule is left out: in most frames it does not know all states to go on "
                "from."
            )
    trials, rows = rolling_origins(seen, origins, startable)
    ahead, more = _within(seen.any(-1), trials, rows, [int(k) for k in horizons])
    total = len(forecasters) * sum(1 for _ in batches(first, len(rows), max(ahead), draws))
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(Progress(done, total, 0))

    found: dict[str, dict[str, Array]] = {}
    for name, forecaster in forecasters.items():
        told = position_scores(
            subjects.get(name, first),
            forecaster,
            trials,
            rows,
            ahead,
            draws=draws,
            seed=seed,
            levels=levels,
            training=training,
            progress=count,
        )
        if told is not None:
            found[name] = told
    data = mean_scores(found, axes=(2,))
    if not data["number"].any():
        raise InputError(
            "tracks: nobody who is forecast is seen again at any of these horizons. Score more "
            "frames, or nearer horizons."
        )
    titles = {name: getattr(forecasters[name], "title", name) for name in found}
    titles |= {name: name for name in fits}
    dataset = _labelled(data, titles, tracks, frames, trials, rows, ahead, levels)
    dataset.attrs = {
        "part": frames.part,
        "draws": draws,
        "seed": seed,
        "fps": float(tracks.attrs["fps"]),
        "unit": str(tracks.attrs.get("unit", "")),
        "notes": [*notes, *more],
    }
    return dataset


def _known_at(subject: Subject) -> Mask:
    """Return who is known in each frame to who sees no later one, ``(trial, time, individual)``."""
    known: Mask = subject.mask & subject.inputs.mask.numpy() & subject.inputs.known.numpy()
    return known


def _law(subjects: Mapping[str, Subject]) -> LawForecaster | None:
    """Return the true rule, if the tracks of one of the fits know it."""
    found = (law_forecaster(subject)[0] for subject in subjects.values())
    return next((law for law in found if law is not None), None)


def _within(
    seen: Mask, trials: Rows, rows: Rows, horizons: list[int]
) -> tuple[list[int], list[str]]:
    """Return the horizons that there is room for, and a note of those that are left out."""
    last = np.where(seen, np.arange(seen.shape[1]), -1).max(-1)
    room = int((last[trials] - rows).max(initial=0))
    if room < horizons[0]:
        raise InputError(
            f"horizons: the scored frames have room for at most {room} steps ahead. Score "
            "more frames, or nearer horizons."
        )
    used = [k for k in horizons if k <= room]
    if len(used) == len(horizons):
        return used, []
    left = ", ".join(str(k) for k in horizons if k > room)
    return used, [
        f"The scored frames have room for at most {room} steps ahead: {left} steps are not scored."
    ]


def _labelled(
    data: Mapping[str, Any],
    titles: Mapping[str, str],
    tracks: xr.Dataset,
    frames: ScoredFrames,
    trials: Rows,
    rows: Rows,
    horizons: Sequence[int],
    levels: Sequence[float],
) -> xr.Dataset:
    """Give scores their labels and units."""
    tracks = with_trials(tracks)
    unit = str(tracks.attrs.get("unit", ""))
    starts = np.array([segment.start for segment in frames.segments])
    frame = starts[trials] + rows
    labels = [frames.segments[trial].trial for trial in trials]
    time = tracks["time"].to_numpy()[frame]
    if "start_time" in tracks.coords:
        places = [str(trial) for trial in tracks["trial"].values]
        began = np.broadcast_to(tracks["start_time"].to_numpy(), len(places))
        time = time - tracks["time"].to_numpy()[0] + began[[places.index(one) for one in labels]]
    over = ("model", "origin", "horizon")
    units = {"log_score": "nat", "mse": f"{unit}^2" if unit else "1", "coverage": "1"}
    variables: dict[str, Any] = {
        name: (
            (*over, "level") if name in ("coverage", "width") else over,
            data[name],
            {"units": units.get(name, unit or "1"), "long_name": LONG_NAMES[name]},
        )
        for name in SCORES
    }
    variables["number"] = (
        over[1:],
        data["number"],
        {"units": "1", "long_name": "individuals counted"},
    )
    trained = [frames.trained_on.get(name, 0) for name in titles]
    variables["trained_on"] = (
        ("model",),
        trained,
        {"units": "1", "long_name": "scored frames that the model was trained on"},
    )
    second = {"units": "s", "long_name": "time of the origin"}
    coords = {
        "model": list(titles),
        "title": ("model", list(titles.values())),
        "horizon": ("horizon", list(horizons), {"units": "1", "long_name": "frames ahead"}),
        "ahead": (
            "horizon",
            np.asarray(horizons) / float(tracks.attrs["fps"]),
            {"units": "s", "long_name": "time ahead"},
        ),
        "level": ("level", list(levels), {"units": "1", "long_name": "level of the interval"}),
        "trial": ("origin", labels),
        "frame": ("origin", frame, {"units": "1", "long_name": "row of the origin"}),
        "time": ("origin", time, second),
    }
    return xr.Dataset(variables, coords)


def _check(
    fits: Mapping[str, Fit],
    horizons: Sequence[int],
    origins: int,
    draws: int,
    seed: int,
    levels: Sequence[float],
) -> None:
    """Refuse arguments that are out of range."""
    if not fits:
        raise InputError("fits: at least one is needed.")
    taken = [name for name in fits if name in REFERENCES or name == NOISE_FLOOR]
    if taken:
        raise InputError(f"fits: {taken[0]} is the name of a rival. Call that fit otherwise.")
    whole = all(isinstance(k, int | np.integer) for k in horizons)
    rising = all(b > a for a, b in itertools.pairwise(horizons))
    if not whole or not rising or not len(horizons) or horizons[0] < 1:
        raise InputError(
            f"horizons: give rising whole numbers of steps from 1 upwards, not {list(horizons)}."
        )
    if not len(levels) or not all(0.0 < level < 1.0 for level in levels):
        raise InputError(f"levels: give probabilities between 0 and 1, not {list(levels)}.")
    if len(set(levels)) < len(levels):
        raise InputError(f"levels: one of {list(levels)} stands there twice.")
    if origins < 1:
        raise InputError(f"origins: it must be at least 1, and it is {origins}.")
    if draws < LEAST_DRAWS:
        raise InputError(f"draws: it must be at least {LEAST_DRAWS}, and it is {draws}.")
    if seed < 0:
        raise InputError(f"seed: it must not be negative, and it is {seed}.")
