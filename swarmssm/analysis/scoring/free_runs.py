"""Whether a group that runs freely holds together as the true one does."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm import metrics
from swarmssm.analysis.posterior.subject import ScoredTracks
from swarmssm.analysis.scoring.forecasters import Forecaster
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["collective_scores", "free_run_starts"]

Rows = npt.NDArray[np.int64]
#: Beyond this many spans of the recording a free run has left all bounds.
BOUNDS = 1e6


def free_run_starts(subject: ScoredTracks, steps: int, count: int) -> tuple[Rows, Rows]:
    """Return trial and row of the starts: spread over the frames that leave room for the run.

    Where a trial is too short for that there is one start, its first usable frame.
    """
    trials, rows = [], []
    for trial, there in enumerate(subject.mask):
        usable = np.flatnonzero(there.any(axis=-1))
        if usable.size < 2:
            continue
        roomy = usable[usable <= usable[-1] - steps]
        if not roomy.size:
            roomy = usable[:1]
        chosen = np.unique(np.linspace(0, roomy.size - 1, min(count, roomy.size)).round())
        rows.append(roomy[chosen.astype(np.int64)])
        trials.append(np.full(rows[-1].size, trial))
    return np.concatenate(trials), np.concatenate(rows)


def collective_scores(
    subject: ScoredTracks,
    forecasters: Sequence[Forecaster],
    *,
    steps: int,
    starts: int,
    draws: int,
    seed: int,
) -> tuple[xr.Dataset, list[str]]:
    """Return AMD and AVD of the truth and of free runs over time, their means, and notes."""
    trials, rows = free_run_starts(subject, steps, starts)
    truth = subject.ahead(trials, rows, steps)
    initial = subject.states[trials, rows][:, None]
    truth = np.concatenate([initial, truth], axis=1)
    # The same individuals are measured in all, as long as the truth says who they are; and only
    # those that run, so that one who joins later does not count on one side alone.
    there = known(truth) & known(initial)
    lasting = there.any(axis=-1)
    # Where the truth has nobody any more, those it had last go on being measured.
    last = np.maximum.accumulate(np.where(lasting, np.arange(steps + 1), 0), axis=1)
    measured = np.take_along_axis(there, last[..., None], axis=1)
    truth = np.where(there[..., None], truth, np.nan)
    series: dict[str, Array] = {"truth": truth[None]}
    titles, notes = ["truth"], []
    for forecaster in forecasters:
        runs = forecaster.simulate(trials, rows, steps, draws, seed)
        if runs is None:
            notes.append(
                f"Free runs of the {forecaster.title} are left out: it does not know all states "
                "they start from."
            )
            continue
        titles.append(forecaster.title)
        whole = np.concatenate(
            [np.broadcast_to(initial, (len(runs), *initial.shape)), runs], axis=2
        )
        series[forecaster.name] = np.where(measured[..., None], whole, np.nan)
    far = BOUNDS * max(1.0, float(np.nanmax(np.abs(subject.states))))
    values = {name: _amd_avd(whole, far) for name, whole in series.items()}
    data = _summary(values, values["truth"])
    overlap = int(lasting.sum(axis=1).max()) - 1
    if overlap < steps:
        notes.append(
            f"Free runs are compared with the truth over {overlap} steps: the scored part is no "
            "longer."
        )
    blown = [name for name, (amd, _) in values.items() if np.isinf(amd).any()]
    notes += [f"Free runs of {name} left all bounds." for name in blown]
    coords = {
        "series": list(series),
        "title": ("series", titles),
        "time": np.arange(steps + 1) / subject.fps,
    }
    return xr.Dataset(data, coords, {"scored_steps": overlap, "num_starts": len(rows)}), notes


def _amd_avd(runs: Array, far: float) -> tuple[Array, Array]:
    """Return AMD and AVD ``(draw, start, time)``, infinite once somebody left all bounds."""
    with np.errstate(invalid="ignore"):
        lost = np.logical_or.reduce(np.abs(runs) > far, axis=(-1, -2))
    inside = np.where(lost[..., None, None], np.nan, runs)
    position, velocity = np.split(inside, 2, axis=-1)
    amd, avd = metrics.amd(position), metrics.avd(velocity)
    amd[lost], avd[lost] = np.inf, np.inf
    return amd, avd


def _summary(
    values: dict[str, tuple[Array, Array]], truth: tuple[Array, Array]
) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Return curves with their bands, means over the scored time and errors, for all series."""
    data: dict[str, tuple[tuple[str, ...], Array]] = {}
    for index, name in enumerate(("amd", "avd")):
        true = truth[index]
        curves, low, high, means, errors = [], [], [], [], []
        for pair in values.values():
            run = pair[index]
            flat = run.reshape(-1, run.shape[-1])
            curves.append(_over_runs(flat, None))
            low.append(_over_runs(flat, 0.1))
            high.append(_over_runs(flat, 0.9))
            # Where not all draws are known at a time, none counts there.
            scored = np.broadcast_to(~np.isnan(true), run.shape) & ~np.isnan(run)
            difference = np.abs(np.where(scored, run, 0.0) - np.where(scored, true, 0.0))
            means.append(run[scored].mean() if scored.any() else np.nan)
            errors.append(difference[scored].mean() if scored.any() else np.nan)
        data[name] = (("series", "time"), np.stack(curves))
        data[f"{name}_low"] = (("series", "time"), np.stack(low))
        data[f"{name}_high"] = (("series", "time"), np.stack(high))
        data[f"{name}_mean"] = (("series",), np.array(means))
        data[f"{name}_error"] = (("series",), np.array(errors))
    return data


def _over_runs(flat: Array, share: float | None) -> Array:
    """Return mean or quantile over runs at each time; infinite if one is, NaN if none is known."""
    out = np.full(flat.shape[1], np.nan)
    lost = np.logical_or.reduce(np.isinf(flat), axis=0)
    some = np.logical_or.reduce(~np.isnan(flat), axis=0) & ~lost
    if some.any():
        part = flat[:, some]
        if share is None:
            out[some] = np.nanmean(part, axis=0)
        elif np.isnan(part).any():
            out[some] = np.nanquantile(part, share, axis=0)
        else:
            out[some] = np.quantile(part, share, axis=0)
    out[lost] = np.inf
    return out
