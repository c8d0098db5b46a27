"""Rolling-origin scores: all methods forecast the same positions from the same frames."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.analysis.posterior.frames import ScoredFrames, common_frames, rolling_origins
from swarmssm.analysis.posterior.subject import ScoredTracks, Subject, subject_of
from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.analysis.scoring.forecasters import (
    CHUNK,
    FitForecaster,
    Forecaster,
    LawForecaster,
    baseline_forecaster,
    law_forecaster,
)
from swarmssm.analysis.scoring.references import REFERENCES
from swarmssm.analysis.scoring.scores import SCORES, mean_scores, score_density
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.jobs import Progress
from swarmssm.tracks import Array, validate_tracks, with_trials

__all__ = [
    "HORIZONS",
    "LEVELS",
    "RollingOrigins",
    "check_horizons",
    "rolling_forecasts",
    "score",
    "score_positions",
]

Rows = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
HORIZONS = (1, 2, 5, 10, 20)
LEVELS = (0.5, 0.8, 0.9)
#: With fewer sampled futures their covariance and the ends of their intervals say little.
LEAST_DRAWS = 10
#: Origins that are forecast at once, where their tensors are no larger than a few of CHUNK.
BATCH = 25
FLATTERED = (
    "The spread of the baselines' forecasts is that of their errors on the scored frames "
    "themselves: their scores are too good."
)


def score(
    methods: Mapping[str, Fit | Baseline],
    tracks: xr.Dataset,
    *,
    horizons: Sequence[int] = HORIZONS,
    origins: int = 40,
    draws: int = 100,
    part: str | None = None,
    seed: int = 0,
    levels: Sequence[float] = LEVELS,
    references: bool = True,
    progress: Callable[[Progress], None] | None = None,
) -> xr.Dataset:
    """Forecast from many held-out frames, and score observed positions by proper scores.

    All methods go on from the same frames, knowing these and those before alone, and are scored on
    the same individuals: those that all of them forecast and whose position is then observed. The
    fits may differ in anything - model, guide, scaler, velocities, graph, split - since positions
    are forecast in the tracks' own unit. A forecast that diverges is infinitely bad, and counts.

    A forecast is the density of an individual's position as it will be observed, tracking noise
    included. Of a fit it is taken from ``draws`` sampled futures (parameters, states and steps
    drawn), of the true rule of simulated tracks too; of a baseline it is a normal about what it
    expects, with the covariance of its own errors at that horizon in the training part.

    Parameters
    ----------
    methods
        Name -> fit or fitted baseline, at least one fit. The first fit's velocities are also the
        baselines'.
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
    references
        Whether staying put, constant velocity and, for simulated tracks, the true rule are scored
        too.
    progress
        Called with a ``Progress`` of batches.

    Returns
    -------
    Dataset over ``model`` (the methods, ``stay-put``, ``constant-velocity`` and, for simulated
    tracks, ``noise-floor``), ``origin``, ``horizon`` and ``level``: each of
    :data:`swarmssm.analysis.scoring.SCORES`, a mean over the ``number (origin, horizon)`` of
    individuals counted. By the names of their variables:

    - ``log_score``, nats per coordinate, higher is better: see
      :func:`swarmssm.metrics.mixture_log_score` (other models: the normal with the draws' moments);
    - ``crps``, mean over coordinates, and ``energy_score`` of an individual's position, lower is
      better: the fair estimators, see :func:`swarmssm.metrics.ensemble_crps`;
    - ``mse`` of the forecast's mean, per coordinate;
    - ``coverage`` and ``width`` of the central interval of a coordinate.

    Coordinates ``trial``, ``frame`` (row of the tracks) and ``time`` say where the origins are,
    ``ahead`` how many seconds each horizon is; ``trained_on (model)`` is the number of scored
    frames that a model was trained on, ``fitted (model)`` whether it is one of ``methods``.
    ``attrs["notes"]`` is what a reader has to know.

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
    return rolling_forecasts(
        methods, tracks, horizons, origins, part, levels, references=references
    ).scored(draws, seed, levels, progress)


@dataclass(frozen=True)
class RollingOrigins:
    """Forecasters, and the frames from which all of them go on.

    Attributes
    ----------
    forecasters
        Name -> forecaster, in the order of tables.
    subjects
        Name -> what a fit is scored on; the first stands for the baselines too.
    frames
        The scored frames.
    trials, rows
        ``(origin,)``.
    horizons
        Those that there is room for.
    tracks
        All.
    fitted
        Names of the methods that were asked for; the others are references.
    notes
        What a reader of the scores has to know.
    """

    forecasters: dict[str, Forecaster]
    subjects: dict[str, Subject]
    frames: ScoredFrames
    trials: Rows
    rows: Rows
    horizons: tuple[int, ...]
    tracks: xr.Dataset
    fitted: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def subject(self) -> Subject:
        """What the first fit is scored on."""
        return next(iter(self.subjects.values()))

    def scored(
        self,
        draws: int,
        seed: int,
        levels: Sequence[float],
        progress: Callable[[Progress], None] | None = None,
    ) -> xr.Dataset:
        """Score the forecasts, see :func:`score`."""
        if draws < LEAST_DRAWS:
            raise InputError(f"draws: it must be at least {LEAST_DRAWS}, and it is {draws}.")
        if seed < 0:
            raise InputError(f"seed: it must not be negative, and it is {seed}.")
        first, longest = self.subject, max(self.horizons)
        total = len(self.forecasters) * sum(
            1 for _ in _batches(first, len(self.rows), longest, draws)
        )
        done = 0

        def count() -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(Progress(done, total))

        found: dict[str, dict[str, Array]] = {}
        for name, forecaster in self.forecasters.items():
            scores = score_positions(
                self.subjects.get(name, first),
                forecaster,
                self.trials,
                self.rows,
                self.horizons,
                draws=draws,
                seed=seed,
                levels=levels,
                progress=count,
            )
            if scores is not None:
                found[name] = scores
        data = mean_scores(found)
        if not data["number"].any():
            raise InputError(
                "tracks: nobody who is forecast is observed again at any of these horizons. Score "
                "more frames, or nearer horizons."
            )
        dataset = self._labelled(data, list(found), levels)
        dataset.attrs = {
            "part": self.frames.part,
            "draws": draws,
            "seed": seed,
            "fps": float(self.tracks.attrs["fps"]),
            "unit": str(self.tracks.attrs.get("unit", "")),
            "notes": list(self.notes),
        }
        return dataset

    def _labelled(
        self, data: Mapping[str, Any], names: list[str], levels: Sequence[float]
    ) -> xr.Dataset:
        """Give scores their labels and units."""
        tracks, segments = self.tracks, self.frames.segments
        unit = str(tracks.attrs.get("unit", ""))
        starts = np.array([segment.start for segment in segments])
        frame = starts[self.trials] + self.rows
        labels = [segments[trial].trial for trial in self.trials]
        time = tracks["time"].to_numpy()[frame]
        if "start_time" in tracks.coords:
            places = [str(trial) for trial in tracks["trial"].values]
            began = np.broadcast_to(tracks["start_time"].to_numpy(), len(places))
            offset = began[[places.index(one) for one in labels]]
            time = time - tracks["time"].to_numpy()[0] + offset
        over = ("model", "origin", "horizon")
        variables: dict[str, Any] = {
            name: (
                (*over, "level") if one.by_level else over,
                data[name],
                {"units": _units(one.units, unit), "long_name": one.long_name},
            )
            for name, one in SCORES.items()
        }
        variables["number"] = (
            over[1:],
            data["number"],
            {"units": "1", "long_name": "individuals counted"},
        )
        variables["trained_on"] = (
            "model",
            [self.frames.trained_on.get(name, 0) for name in names],
            {"units": "1", "long_name": "scored frames that the model was trained on"},
        )
        titles = [n if n in self.fitted else self.forecasters[n].title for n in names]
        horizons = np.array(self.horizons)
        coords = {
            "model": names,
            "title": ("model", titles),
            "fitted": ("model", [name in self.fitted for name in names]),
            "horizon": ("horizon", horizons, {"units": "1", "long_name": "frames ahead"}),
            "ahead": (
                "horizon",
                horizons / float(tracks.attrs["fps"]),
                {"units": "s", "long_name": "time ahead"},
            ),
            "level": ("level", list(levels), {"units": "1", "long_name": "level of the interval"}),
            "trial": ("origin", labels),
            "frame": ("origin", frame, {"units": "1", "long_name": "row of the origin"}),
            "time": ("origin", time, {"units": "s", "long_name": "time of the origin"}),
        }
        return xr.Dataset(variables, coords)


def rolling_forecasts(
    methods: Mapping[str, Fit | Baseline],
    tracks: xr.Dataset,
    horizons: Sequence[int],
    origins: int,
    part: str | None,
    levels: Sequence[float],
    *,
    edges: str = "decoder",
    references: bool = True,
) -> RollingOrigins:
    """Choose frames that are fair to all methods, and make each a forecaster of them.

    Raises
    ------
    InputError
        As :func:`score`.
    """
    _check(methods, horizons, origins, levels)
    tracks = validate_tracks(tracks)
    fits = {name: one for name, one in methods.items() if isinstance(one, Fit)}
    baselines = {name: one for name, one in methods.items() if isinstance(one, Baseline)}
    frames = common_frames(fits, tracks, part)
    subjects = {n: subject_of(fit, tracks, frames=frames) for n, fit in fits.items()}
    first = next(iter(subjects.values()))
    # The baselines learn the spread of their errors where somebody has a training part.
    training = next((s for s in subjects.values() if s.training is not None), first)
    notes = [*frames.notes]
    forecasters: dict[str, Forecaster] = {
        name: FitForecaster(subject, edges, name) for name, subject in subjects.items()
    }
    if references:
        baselines |= {name: kind() for name, kind in REFERENCES.items()}
    for name, baseline in baselines.items():
        forecasters[name] = baseline_forecaster(baseline, first, training.training)
    if baselines and training.training is None:
        notes.append(FLATTERED)
    mask = np.logical_and.reduce([subject.mask for subject in subjects.values()])
    startable = np.logical_and.reduce([_known_at(one) for one in subjects.values()]).any(-1)
    law = _law(subjects) if references else None
    if law is not None:
        if 2 * (startable & law.whole).sum() >= startable.sum():
            startable, forecasters[law.name] = startable & law.whole, law
        else:
            notes.append(
                "The true rule is left out: in most frames it does not know all states to go on "
                "from."
            )
    trials, rows = rolling_origins(mask, origins, startable)
    used, more = _within(mask.any(-1), trials, rows, [int(k) for k in horizons])
    order = [*methods, *(name for name in forecasters if name not in methods)]
    return RollingOrigins(
        {name: forecasters[name] for name in order},
        subjects,
        frames,
        trials,
        rows,
        used,
        with_trials(tracks),
        tuple(methods),
        (*notes, *more),
    )


def score_positions(
    scored: ScoredTracks,
    forecaster: Forecaster,
    trials: Rows,
    rows: Rows,
    steps: Sequence[int],
    *,
    draws: int,
    seed: int,
    levels: Sequence[float] = (),
    names: Sequence[str] = tuple(SCORES),
    progress: Callable[[], None] | None = None,
) -> dict[str, Array] | None:
    """Score the positions that one method forecasts some steps ahead.

    Parameters
    ----------
    scored
        What is scored.
    forecaster
        Who is.
    trials, rows
        ``(origin,)``: the frames to go on from.
    steps
        Rising numbers of frames ahead.
    draws
        Sampled futures.
    seed
        Of all draws.
    levels
        Of the intervals.
    names
        Which of :data:`swarmssm.analysis.scoring.SCORES`.
    progress
        Called after each batch of origins.

    Returns
    -------
    Name -> ``(origin, step, individual)``, of intervals with levels behind. NaN where the truth is
    unknown or the individual is not forecast; infinitely bad where the forecast diverged. ``None``
    if the forecaster cannot go on from all of the frames.
    """
    chosen, longest = np.asarray(steps) - 1, max(steps)
    found: dict[str, list[Array]] = {name: [] for name in names}
    for number, batch in enumerate(_batches(scored, len(rows), longest, draws)):
        density = forecaster.density(trials[batch], rows[batch], steps, draws, seed, number)
        if density is None:
            return None
        truth = scored.ahead(trials[batch], rows[batch], longest)
        truth = truth[:, chosen, :, : scored.num_space]
        for name, values in score_density(density, truth, levels, names).items():
            found[name].append(values)
        if progress is not None:
            progress()
    return {name: np.concatenate(values) for name, values in found.items()}


def check_horizons(horizons: Sequence[int]) -> None:
    """Refuse what are no rising whole numbers from 1 upwards.

    Raises
    ------
    InputError
        If they are not.
    """
    whole = all(isinstance(k, int | np.integer) for k in horizons)
    rising = all(b > a for a, b in itertools.pairwise(horizons))
    if not whole or not rising or not len(horizons) or horizons[0] < 1:
        raise InputError(
            f"horizons: give rising whole numbers of steps from 1 upwards, not {list(horizons)}."
        )


def _batches(scored: ScoredTracks, origins: int, longest: int, draws: int) -> Iterator[Rows]:
    """Yield the origins that are forecast together, so that memory stays bounded."""
    each = draws * longest * scored.mask.shape[-1] ** 2
    size = max(1, min(BATCH, 5 * CHUNK // each))
    yield from np.array_split(np.arange(origins), max(1, origins // size))


def _known_at(subject: Subject) -> Mask:
    """Return who is known in each frame to who sees no later one, ``(trial, time, individual)``."""
    known: Mask = subject.mask & subject.inputs.mask.numpy() & subject.inputs.known.numpy()
    return known


def _law(subjects: Mapping[str, Subject]) -> LawForecaster | None:
    """Return the true rule, if the tracks of one of the fits know it."""
    found = (law_forecaster(subject)[0] for subject in subjects.values())
    return next((law for law in found if law is not None), None)


def _within(
    observed: Mask, trials: Rows, rows: Rows, horizons: list[int]
) -> tuple[tuple[int, ...], list[str]]:
    """Return the horizons that there is room for, and a note of those that are left out."""
    last = np.where(observed, np.arange(observed.shape[1]), -1).max(-1)
    room = int((last[trials] - rows).max(initial=0))
    if room < horizons[0]:
        raise InputError(
            f"horizons: the scored frames have room for at most {room} steps ahead. Score "
            "more frames, or nearer horizons."
        )
    used = tuple(k for k in horizons if k <= room)
    if len(used) == len(horizons):
        return used, []
    left = ", ".join(str(k) for k in horizons if k > room)
    return used, [
        f"The scored frames have room for at most {room} steps ahead: {left} steps are not scored."
    ]


def _units(template: str, unit: str) -> str:
    """Return the units of a score, ``1`` where the tracks have no unit."""
    if "{unit}" in template and not unit:
        return "1"
    return template.format(unit=unit)


def _check(
    methods: Mapping[str, Fit | Baseline],
    horizons: Sequence[int],
    origins: int,
    levels: Sequence[float],
) -> None:
    """Refuse arguments that are out of range."""
    for name, one in methods.items():
        if not isinstance(one, Fit | Baseline):
            raise InputError(f"methods: {name} is a {type(one).__name__}; give a Fit or Baseline.")
        if name in REFERENCES or name == LawForecaster.name:
            raise InputError(f"methods: {name} is the name of a reference. Give it another one.")
    if not any(isinstance(one, Fit) for one in methods.values()):
        raise InputError("methods: at least one fit is needed.")
    check_horizons(horizons)
    if not len(levels) or not all(0.0 < level < 1.0 for level in levels):
        raise InputError(f"levels: give probabilities between 0 and 1, not {list(levels)}.")
    if len(set(levels)) < len(levels):
        raise InputError(f"levels: one of {list(levels)} is given twice.")
    if origins < 1:
        raise InputError(f"origins: it must be at least 1, and it is {origins}.")
