"""Posterior predictive checks: whether the fitted model makes swarms like the one seen."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.diagnostics.checks.arenas import arena_of
from swarmssm.analysis.diagnostics.checks.observables import Axis
from swarmssm.analysis.diagnostics.checks.p_values import Judged, adjusted_p_values, judge
from swarmssm.analysis.diagnostics.checks.replicates import COPIES, Runs, replicates, runs_of
from swarmssm.analysis.diagnostics.checks.statistics import Statistic, chosen_statistics
from swarmssm.analysis.diagnostics.checks.swarm import Scales, Swarm
from swarmssm.analysis.diagnostics.checks.verdicts import LEVEL, verdicts
from swarmssm.analysis.posterior.intervals import QUANTILES, quantiles
from swarmssm.analysis.posterior.subject import Subject, subject_of
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.jobs import Progress
from swarmssm.metrics.arena import Arena
from swarmssm.tracks import Array, validate_tracks

__all__ = ["check"]

Chosen = Iterable[str | Statistic] | Mapping[str, Callable[[Swarm], Any] | Statistic]
#: With fewer draws no p-value is below a tenth.
LEAST_DRAWS = 10
#: Order parameters that are kept over time: name -> units.
SERIES = {"polarization": "1", "rotation": "1", "amd": "{length}", "avd": "{length}/s"}
#: Beyond this share of sightings of individuals that came after the start, a note says so.
MANY_LATER = 0.02


def check(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    draws: int = 100,
    statistics: Chosen | None = None,
    steps: int | None = None,
    part: str | None = None,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
    walls: Arena | str | None = None,
    every: int = 1,
    copies: int = COPIES,
) -> xr.Dataset:
    r"""Simulate whole swarms from the posterior, and compare them with the recording.

    The scored part is cut into runs. From the first frame of each the model runs freely, with
    everything drawn: the parameters and the first state from their posterior given the past alone
    (filtered, not smoothed), the motion, and the noise of tracking. A replicate is then seen as
    the recording was: by positions, not at all where the recording has a gap, its velocities
    differences of seen positions. Each statistic of the recording is compared with that of the
    replicates as :mod:`swarmssm.analysis.diagnostics.checks.p_values` says.

    *What is conditioned on*: the observed past of each run. If the model and its parameters are
    right, recording and replicates are exchangeable given that, and p-values are uniform: exactly
    with one run in a trial, nearly with several, since a later run starts from what the
    recording - not the replicate - did before. Parameters that were learned from the scored
    frames themselves draw p-values towards 1/2. Gaps are taken to be where they are whatever
    the individuals do.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or others.
    draws
        Number of replicates, at least 10. No p-value is below ``1 / (draws + 1)``, and of a number
        below twice that.
    statistics
        Names of :data:`~swarmssm.analysis.diagnostics.checks.STATISTICS`, own
        ``Statistic``, or ``{name: function}`` with functions of a
        ``Swarm`` that return a number or an array; absent, all
        ready-made ones that can be had of these tracks.
    steps
        Length of a run; absent, a whole trial of the part if that has at most 200 frames, else
        equal runs of at most that.
    part
        See :func:`swarmssm.analysis.posterior.subject.subject_of`. Absent: the test part.
    seed
        Of all draws.
    progress
        Called as replicates are finished.
    walls
        See ``arena_of``. A hull of the recording itself never
        leaves the recording outside, so that p-values of walls lean towards 0 with it.
    every
        Look at every so many frames alone: where tracking noise is large against a step, speeds
        and turns of single frames tell nothing else.
    copies
        Replicates that have a draw of the parameters in common (first states and noise are each
        one's own), which takes a fraction of the time. With 1 each has its own, as the p-values
        ask for where the parameters are so unsure that replicates differ by them as much as by
        chance.

    Returns
    -------
    Dataset with, for each statistic ``s`` that could be had, ``s_observed (...)`` and
    ``s_replicated (draw, ...)``, NaN for replicates that flew off, and along ``statistic``:

    ``p_value``, ``p_adjusted``
        The latter allows for their number, see :func:`adjusted_p_values`.
    ``verdict``, ``words``
        ``"alike"``; ``"doubtful"``: p below 0.05, but not when their number is allowed for;
        ``"unlike"``: below 0.05 also then; and the same in a sentence.
    ``place``, ``place_replicated (draw, statistic)``
        Standardised distances; of a number with a sign.
    ``hellinger``, ``hellinger_among``
        Of a histogram: from the observed to the mean of the replicates; from one of these to the
        mean of the others.
    ``diverged (draw)``
        1 for a replicate that flew off: it counts against the fit in every statistic, and the
        statistic ``bounds`` is there if there are any.
    ``series_observed (series, run, step)``, ``series_replicated (series, quantile, run, step)``
        Order parameters over time.

    Raises
    ------
    InputError
        If an argument is out of range, a statistic fails or cannot be had of these tracks, or the
        tracks do not fit the model.

    References
    ----------
    A. Gelman, X.-L. Meng and H. Stern (1996), Posterior predictive assessment of model fitness via
    realized discrepancies, Statistica Sinica 6.
    """
    least_of = (("draws", draws, LEAST_DRAWS), ("every", every, 1), ("copies", copies, 1))
    for name, count, least in least_of:
        if count < least:
            raise InputError(f"{name}: it must be at least {least}, and it is {count}.")
    if steps is not None and steps < 2 * every + 1:
        raise InputError(f"steps: a run needs at least {2 * every + 1}, and it is {steps}.")
    if seed < 0:
        raise InputError(f"seed: it must not be negative, and it is {seed}.")
    wanted = chosen_statistics(statistics)
    tracks = validate_tracks(tracks)
    arena = arena_of(fit, tracks, walls)
    subject = subject_of(fit, tracks, part)
    predictor = subject.fit.predictor()
    runs = runs_of(subject, predictor, steps)
    notes = [note for note in subject.notes if not note.startswith("Scores are in units")]
    observed = _swarm(subject, runs.seen, arena, None, every)
    observed = _swarm(subject, runs.seen, arena, Scales.of(observed), every)
    kept = []
    for one in wanted:
        reason = one.missing(observed)
        if reason and statistics is not None:
            raise InputError(
                f"statistics: {one.name} cannot be had of these tracks: {reason}."
                + (" Pass walls=, or give the tracks an attribute arena." if one.walls else "")
            )
        if reason:
            notes.append(f"No {one.title}: {reason}.")
        else:
            kept.append(one)
    if not kept:
        raise InputError("statistics: none can be had of these tracks: " + " ".join(notes))
    own = {one.name: one.of(observed) for one in kept}
    replicated: dict[str, list[Array]] = {one.name: [] for one in kept}
    series: list[Array] = []
    diverged = []
    for positions in replicates(subject, predictor, runs, draws, seed, progress, copies):
        diverged.append(positions is None)
        swarm = None
        if positions is not None:
            swarm = _swarm(subject, positions, arena, observed.scales, every)
            series.append(_series(swarm))
        for one in kept:
            nothing = np.full(own[one.name].shape, np.nan)
            value: Array = nothing if swarm is None else one.of(swarm)
            if value.shape != nothing.shape:
                raise InputError(
                    f"statistics: {one.name} has the shape {nothing.shape} for the recording and "
                    f"{value.shape} for a replicate. It must return the same for every swarm."
                )
            replicated[one.name].append(value)
    notes += _notes(runs, diverged, arena, observed, kept)
    stacked = {name: np.stack(values) for name, values in replicated.items()}
    data = _values(kept, observed, own, stacked)
    judged = [judge(_kind(one, own), own[one.name], stacked[one.name]) for one in kept]
    data |= _series_data(observed, series)
    about = {
        "model": fit.settings.model,
        "part": subject.part,
        "draws": draws,
        "steps": runs.steps,
        "every": every,
        "copies": copies,
        "runs": len(runs),
        "seed": seed,
        "unit": observed.unit,
        "walls": "" if arena is None else arena.source,
        "level": LEVEL,
        "notes": "\n".join(notes),
    }
    result = xr.Dataset(data, _coordinates(subject, runs, every, draws), about)
    result["diverged"] = (
        "draw",
        np.array(diverged, dtype=np.uint8),
        {"units": "1", "long_name": "whether the replicate flew off"},
    )
    return xr.merge([result, _judgements(kept, own, stacked, judged, np.array(diverged), observed)],
                    combine_attrs="override")  # fmt: skip


def _swarm(
    subject: Subject, seen: Array, arena: Arena | None, scales: Scales | None, every: int
) -> Swarm:
    """Return a swarm as seen, without the frame that all have in common."""
    fps = subject.fps / every
    thinned = seen[:, ::every]
    unit = str(subject.tracks.attrs.get("unit", ""))
    velocity = np.diff(thinned, axis=1) * fps
    return Swarm(thinned[:, 1:], velocity, fps, unit, arena, scales)


def _kind(one: Statistic, own: Mapping[str, Array]) -> str:
    """Return how a statistic is compared."""
    if one.kind != "auto":
        return one.kind
    return "curve" if own[one.name].ndim else "number"


def _values(
    kept: list[Statistic],
    observed: Swarm,
    own: Mapping[str, Array],
    replicated: Mapping[str, Array],
) -> dict[str, Any]:
    """Label the values of statistics, and their axes."""
    data: dict[str, Any] = {}
    for one in kept:
        value = own[one.name]
        kind = _kind(one, own)
        if kind == "number" and value.ndim:
            raise InputError(
                f"statistics: {one.name} is said to be a number, and has the shape {value.shape}."
            )
        axes = one.axes(observed) if one.axes is not None else _numbered(value)
        if tuple(len(axis.values) for axis in axes) != value.shape:
            raise InputError(
                f"statistics: the axes of {one.name} do not go with its shape {value.shape}."
            )
        dims = tuple(f"{one.name}_{axis.name}" for axis in axes)
        attrs = {
            "units": one.units.format(length=observed.unit or "length units"),
            "long_name": one.title,
            "kind": kind,
        }
        data[f"{one.name}_observed"] = (dims, value, attrs)
        data[f"{one.name}_replicated"] = (("draw", *dims), replicated[one.name], attrs)
        for dim, axis in zip(dims, axes, strict=True):
            data[dim] = (dim, axis.values, {"units": axis.units, "long_name": axis.long_name})
    return data


def _numbered(value: Array) -> tuple[Axis, ...]:
    """Return numbered axes."""
    names = ("point",) if value.ndim == 1 else tuple(f"point_{i}" for i in range(value.ndim))
    return tuple(
        Axis(name, np.arange(size, dtype=np.float64), "1", "number of the point")
        for name, size in zip(names, value.shape, strict=True)
    )


def _series(swarm: Swarm) -> Array:
    """Return the order parameters over time, ``(series, run, step)``."""
    turning = np.full(swarm.position.shape[:2], np.nan)
    if swarm.num_space > 1:
        turning = metrics.rotation(swarm.position, swarm.velocity)
    return np.stack(
        [
            metrics.polarization(swarm.velocity),
            turning,
            metrics.amd(swarm.position),
            metrics.avd(swarm.velocity),
        ]
    )


def _series_data(observed: Swarm, replicated: list[Array]) -> dict[str, Any]:
    """Label order parameters over time."""
    own = _series(observed)
    shape = (len(QUANTILES), *own.shape)
    bands = quantiles(np.stack(replicated)) if replicated else np.full(shape, np.nan)
    dims = ("series", "run", "step")
    length = observed.unit or "length units"
    attrs = {"long_name": "order parameters", "units": "see series_units"}
    return {
        "series_observed": (dims, own, attrs),
        "series_replicated": (("series", "quantile", "run", "step"), bands.swapaxes(0, 1), attrs),
        "series": list(SERIES),
        "series_units": ("series", [unit.format(length=length) for unit in SERIES.values()]),
    }


def _coordinates(subject: Subject, runs: Runs, every: int, draws: int) -> dict[str, Any]:
    """Return where the runs are, and how far ahead their steps."""
    stamps = subject.tracks["time"].to_numpy()
    names = [str(name) for name in subject.tracks["trial"].values]
    count = runs.steps // every
    return {
        "draw": np.arange(draws),
        "quantile": list(QUANTILES),
        "run": np.arange(len(runs)),
        "trial": ("run", [names[trial] for trial in runs.trials]),
        "start": (
            "run",
            stamps[runs.rows].astype(np.float64),
            {"units": "s", "long_name": "time of the first frame"},
        ),
        "step": np.arange(1, count + 1) * every,
        "ahead": (
            "step",
            np.arange(1, count + 1) * every / subject.fps,
            {"units": "s", "long_name": "time since the start of a run"},
        ),
    }


def _judgements(
    kept: list[Statistic],
    own: Mapping[str, Array],
    replicated: Mapping[str, Array],
    judged: list[Judged],
    diverged: npt.NDArray[np.bool_],
    observed: Swarm,
) -> xr.Dataset:
    """Return p-values and verdicts along ``statistic``; ``bounds`` among them if need be."""
    names, titles = [one.name for one in kept], [one.title for one in kept]
    adjusted = adjusted_p_values(judged)
    extra: dict[str, Any] = {}
    if diverged.any():
        draws = len(diverged)
        p_value = (1 + int((~diverged).sum())) / (draws + 1)
        away = np.where(diverged, np.nan, 0.0)
        judged = [*judged, Judged(p_value, 0.0, away)]
        adjusted = np.append(adjusted, p_value)
        names.append("bounds")
        titles.append("flying off")
        attrs = {"units": "1", "long_name": "flying off", "kind": "number"}
        extra["bounds_observed"] = ((), 0.0, attrs)
        extra["bounds_replicated"] = ("draw", diverged.astype(np.float64), attrs)
    length = observed.unit or "length units"
    units = [one.units.format(length=length) for one in kept]
    kinds = [_kind(one, own) for one in kept]
    said = verdicts(names, titles, kinds, units, own, replicated, judged, adjusted, diverged)
    along = "statistic"
    return xr.Dataset(
        {
            **extra,
            "p_value": (
                along,
                [one.p_value for one in judged],
                {"units": "1", "long_name": "Bayesian p-value"},
            ),
            "p_adjusted": (
                along,
                adjusted,
                {"units": "1", "long_name": "p-value that allows for the number of statistics"},
            ),
            "verdict": (along, [verdict for verdict, _ in said]),
            "words": (along, [words for _, words in said]),
            "place": (
                along,
                [one.place for one in judged],
                {"units": "1", "long_name": "standardised distance of the observed"},
            ),
            "place_replicated": (
                ("draw", along),
                np.stack([one.places for one in judged], -1),
                {"units": "1", "long_name": "standardised distance of the replicates"},
            ),
            "hellinger": (
                along,
                [one.hellinger for one in judged],
                {"units": "1", "long_name": "Hellinger distance to the replicates"},
            ),
            "hellinger_among": (
                along,
                [one.hellinger_among for one in judged],
                {"units": "1", "long_name": "median Hellinger distance among replicates"},
            ),
        },
        {along: names, "title": (along, titles)},
    )


def _notes(
    runs: Runs, diverged: list[bool], arena: Arena | None, observed: Swarm, kept: list[Statistic]
) -> list[str]:
    """Return what a reader has to know."""
    notes = []
    if runs.left_out > MANY_LATER:
        notes.append(
            f"{100 * runs.left_out:.0f} % of the sightings are of individuals that came after the "
            "start of a run; they are left out, of the replicates too, which therefore lack what "
            "these did to the others. Shorter runs (steps) leave fewer out."
        )
    if any(diverged):
        notes.append(
            f"{sum(diverged)} of {len(diverged)} replicates flew off; each counts against the fit "
            "in every statistic."
        )
    if arena is not None and any(one.walls for one in kept):
        notes.append(f"The walls are {arena.source}.")
        if "hull" in arena.source:
            notes.append(
                "The recording is never outside of its own hull and replicates may be, so that "
                "p-values of distance and angle to the wall lean towards 0."
            )
    return notes
