"""Posterior predictive checks: whether swarms simulated from a fit match the recording."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.diagnostics.checks.arenas import arena_of, wall_name
from swarmssm.analysis.diagnostics.checks.observables import Axis
from swarmssm.analysis.diagnostics.checks.p_values import Judged, adjusted_p_values, judge
from swarmssm.analysis.diagnostics.checks.replicates import COPIES, Runs, replicates, runs_of
from swarmssm.analysis.diagnostics.checks.result import (
    LEVEL,
    PredictiveCheck,
    verdict_of,
    verdict_of_divergence,
)
from swarmssm.analysis.diagnostics.checks.statistics import Chosen, Statistic, chosen_statistics
from swarmssm.analysis.diagnostics.checks.swarm import BinScales, ObservedSwarm
from swarmssm.analysis.posterior.intervals import QUANTILES, quantiles
from swarmssm.analysis.posterior.subject import Subject, subject_of
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.jobs import Progress
from swarmssm.metrics.arena import Arena
from swarmssm.tracks import Array, validate_tracks

__all__ = ["check"]

#: With fewer draws no p-value is below a tenth.
LEAST_DRAWS = 10
#: Order parameters that are kept over time: name -> units.
SERIES = {
    "polarization": "1",
    "rotation": "1",
    "amd": "{length}",
    "displacement_difference": "{length}/s",
}
#: Share of observations of individuals that enter after the start from which a note says so.
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
) -> PredictiveCheck:
    r"""Simulate swarms from the posterior, and compare them with the recording.

    The scored part is cut into runs. The model is simulated from the first frame of each: the
    parameters and the initial state are drawn from their posterior given the past alone (filtered,
    not smoothed), then the motion and the tracking noise. A replicate is observed as the recording
    was: positions only, missing where the recording has a gap; velocities are differences of
    observed positions. Each statistic of the recording is compared with those of the replicates,
    see :mod:`swarmssm.analysis.diagnostics.checks.p_values`.

    Replicates are conditioned on the observed past of each run. If the model is right, recording
    and replicates are exchangeable given that, and p-values are uniform: exactly with one run in a
    trial, nearly with several, since a later run starts from the recording, not from the replicate.
    Parameters that were estimated from the scored frames themselves pull p-values towards 1/2.
    Gaps are assumed to be independent of the motion.

    Parameters
    ----------
    fit
        A fit.
    tracks
        The tracks of the fit, or others.
    draws
        Number of replicates, at least 10. No p-value is below ``1 / (draws + 1)``, and of a number
        below twice that.
    statistics
        Names of :data:`~swarmssm.analysis.diagnostics.checks.STATISTICS`, own
        ``Statistic``, or ``{name: function}`` with functions of an
        ``ObservedSwarm`` that return a number or an array; absent, all built-in ones that these
        tracks have.
    steps
        Length of a run in frames; absent, a whole trial of the part if it has at most 200 frames,
        else equal runs of at most that.
    part
        See :func:`swarmssm.analysis.posterior.subject.subject_of`. Absent: the test part.
    seed
        Seed of all draws.
    progress
        Called as replicates are finished.
    walls
        See ``arena_of``. The recording is never outside of its own hull, so that p-values of wall
        statistics are biased towards 0 with ``"hull"``.
    every
        Use every n-th frame: where tracking noise is large against a step, speeds and turns of
        single frames are mostly noise.
    copies
        Replicates that share a draw of the parameters (each has its own initial state and noise),
        which saves time. With 1 each has its own, which exact p-values need where the posterior of
        the parameters is wide.

    Returns
    -------
    Its ``data`` have, for each statistic ``s``, ``s_observed (...)`` and
    ``s_replicated (draw, ...)``, NaN for replicates that diverged, and along ``statistic``:

    ``p_value``, ``p_adjusted``
        The latter allows for the number of statistics, see :func:`adjusted_p_values`.
    ``verdict``
        ``consistent``, ``borderline``, ``mismatch`` or ``unknown``, see
        :func:`~swarmssm.analysis.diagnostics.checks.result.verdict_of`.
    ``place``, ``place_replicated (draw, statistic)``
        Standardised distances; with a sign for a number.
    ``hellinger``, ``hellinger_among``
        For a histogram: distance of the recording to the mean of the replicates, and median
        distance of a replicate to the mean of the others.
    ``diverged (draw)``
        1 for a replicate that diverged: it counts against the fit in every statistic, and adds the
        statistic ``divergence``.
    ``series_observed (series, run, step)``, ``series_replicated (series, quantile, run, step)``
        Order parameters over time.

    Raises
    ------
    InputError
        If an argument is out of range, a statistic fails or is not available for these tracks, or
        the tracks do not fit the model.

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
    wanted = [_with_wall(one, arena) for one in wanted]
    notes = [note for note in subject.notes if not note.startswith("Scores are in units")]
    observed = _swarm(subject, runs.seen, arena, None, every)
    observed = _swarm(subject, runs.seen, arena, BinScales.of(observed), every)
    kept = []
    for one in wanted:
        reason = one.missing(observed)
        if reason and statistics is not None:
            raise InputError(
                f"statistics: {one.name} is not available for these tracks: {reason}."
                + (" Pass walls=, or give the tracks an attribute arena." if one.walls else "")
            )
        if reason:
            notes.append(f"No {one.title}: {reason}.")
        else:
            kept.append(one)
    if not kept:
        raise InputError("statistics: none is available for these tracks: " + " ".join(notes))
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
    notes += _notes(runs, diverged, arena, kept)
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
        {"units": "1", "long_name": "whether the replicate diverged"},
    )
    return PredictiveCheck(
        xr.merge(
            [result, _judgements(kept, own, judged, np.array(diverged))], combine_attrs="override"
        )
    )


def _with_wall(one: Statistic, arena: Arena | None) -> Statistic:
    """Return a statistic of walls under the name of the wall that is known."""
    if not one.walls:
        return one
    return replace(one, title=one.title.replace("the wall", wall_name(arena)))


def _swarm(
    subject: Subject, seen: Array, arena: Arena | None, scales: BinScales | None, every: int
) -> ObservedSwarm:
    """Return a swarm as observed, without the first frame, which all replicates share."""
    fps = subject.fps / every
    thinned = seen[:, ::every]
    unit = str(subject.tracks.attrs.get("unit", ""))
    velocity = np.diff(thinned, axis=1) * fps
    return ObservedSwarm(thinned[:, 1:], velocity, fps, unit, arena, scales)


def _kind(one: Statistic, own: Mapping[str, Array]) -> str:
    """Return how a statistic is compared."""
    if one.kind != "auto":
        return one.kind
    return "curve" if own[one.name].ndim else "number"


def _values(
    kept: list[Statistic],
    observed: ObservedSwarm,
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


def _series(swarm: ObservedSwarm) -> Array:
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


def _series_data(observed: ObservedSwarm, replicated: list[Array]) -> dict[str, Any]:
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
    judged: list[Judged],
    diverged: npt.NDArray[np.bool_],
) -> xr.Dataset:
    """Return p-values and verdicts along ``statistic``; ``divergence`` among them if need be."""
    names, titles = [one.name for one in kept], [one.title for one in kept]
    adjusted = adjusted_p_values(judged)
    extra: dict[str, Any] = {}
    draws = len(diverged)
    # A number has two sides.
    least = [(2.0 if _kind(one, own) == "number" else 1.0) / (draws + 1) for one in kept]
    verdicts = [
        verdict_of(one.p_value, p, lowest)
        for one, p, lowest in zip(judged, adjusted, least, strict=True)
    ]
    if diverged.any():
        p_value = (1 + int((~diverged).sum())) / (draws + 1)
        away = np.where(diverged, np.nan, 0.0)
        judged = [*judged, Judged(p_value, 0.0, away)]
        adjusted = np.append(adjusted, p_value)
        names.append("divergence")
        titles.append("divergence")
        verdicts.append(verdict_of_divergence(diverged))
        attrs = {"units": "1", "long_name": "divergence", "kind": "number"}
        extra["divergence_observed"] = ((), 0.0, attrs)
        extra["divergence_replicated"] = ("draw", diverged.astype(np.float64), attrs)
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
            "verdict": (along, verdicts),
            "place": (
                along,
                [one.place for one in judged],
                {"units": "1", "long_name": "standardised distance of the recording"},
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
    runs: Runs, diverged: list[bool], arena: Arena | None, kept: list[Statistic]
) -> list[str]:
    """Return warnings about this check."""
    notes = []
    if runs.left_out > MANY_LATER:
        notes.append(
            f"{100 * runs.left_out:.0f} % of the observations are of individuals that enter after "
            "the start of a run; they are left out, and replicates lack their effect on the "
            "others. Shorter runs (steps) leave fewer out."
        )
    if any(diverged):
        notes.append(
            f"{sum(diverged)} of {len(diverged)} replicates diverged; each counts against the fit "
            "in every statistic."
        )
    if arena is not None and any(one.walls for one in kept):
        notes.append(f"Walls: {arena.source}.")
        if "hull" in arena.source:
            notes.append(
                "The recording is never outside of its own hull and replicates may be: p-values of "
                "wall statistics are biased towards 0."
            )
    return notes
