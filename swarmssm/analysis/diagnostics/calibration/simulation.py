"""Simulation-based calibration: whether a posterior is as sure as it may be."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyro
import torch
import xarray as xr

from swarmssm import inference
from swarmssm.analysis.diagnostics.calibration.parameter_names import named_draws, named_numbers
from swarmssm.analysis.diagnostics.calibration.ranks import calibration_of_ranks
from swarmssm.analysis.diagnostics.calibration.synthetic import (
    FixedModel,
    SyntheticData,
    standard_scales,
)
from swarmssm.analysis.posterior.accelerations import posterior_paths
from swarmssm.errors import InputError, WorkError
from swarmssm.jobs import Progress, Row, parallel_map
from swarmssm.models import Scales
from swarmssm.models.parameters import priors_of

__all__ = ["STATE_QUANTITIES", "simulation_based_calibration"]

#: From states (trial, time, individual, state) to a number.
Quantity = Callable[[torch.Tensor], float]


def mean_speed(states: torch.Tensor) -> float:
    """Return the mean speed over individuals and frames."""
    space = states.shape[-1] // 2
    return float(states[..., space:].norm(dim=-1).mean())


def final_extent(states: torch.Tensor) -> float:
    """Return the root mean square distance to the middle of the group in the last frame."""
    last = states[:, -1, :, : states.shape[-1] // 2]
    return float((last - last.mean(-2, keepdim=True)).square().sum(-1).mean().sqrt())


def first_speed(states: torch.Tensor) -> float:
    """Return the mean speed in the first frame, which later frames alone can tell."""
    return mean_speed(states[:, :1])


#: What of the states is ranked besides the parameters, where paths are drawn.
STATE_QUANTITIES: dict[str, Quantity] = {
    "states.mean_speed": mean_speed,
    "states.first_speed": first_speed,
    "states.final_extent": final_extent,
}


@dataclass(frozen=True)
class _Calibrate:
    """Draw one data set, fit it, and rank the truth."""

    data: SyntheticData
    guide: str | Callable[..., Any]
    settings: Mapping[str, Any]
    draws: int
    path_draws: int
    quantities: Mapping[str, Quantity]
    seed: int

    def __call__(self, index: int) -> Row:
        """Return ranks, and mean and standard deviation of the posterior, of each number."""
        # In Pyro's global store one fit after the other would find the parameters of the first.
        with pyro.settings.context(module_local_params=True):
            return self._row(index)

    def _row(self, index: int) -> Row:
        """Draw, fit and rank."""
        first, second = np.random.SeedSequence([self.seed, index]).generate_state(2).tolist()
        try:
            tracks, truth, states = self.data.draw(first)
        except WorkError as error:
            return {"failed": f"simulation: {error}"}
        began = time.process_time()
        try:
            fitted = inference.fit(
                self.data.model,
                tracks,
                guide=self.guide,
                **{"seed": second, "fractions": (1.0, 0.0, 0.0), "window": None, **self.settings},
            )
        except WorkError as error:
            return {"failed": f"fit: {error}"}
        drawn = fitted.parameters(self.draws, second)
        rng = np.random.default_rng(second)
        row: Row = {name: {} for name in ("truth", "rank", "mean", "sd", "low", "high")}
        # As the posterior has them: a rank among numbers of single precision.
        true = named_numbers({name: value.to(torch.float32) for name, value in truth.items()})
        for name in truth:
            for own, values in named_draws(name, drawn[name].to_numpy()):
                _note(row, own, true[own], values, self.draws, rng)
        if self.path_draws:
            paths = posterior_paths(fitted, tracks, self.path_draws, second).states
            for name, quantity in self.quantities.items():
                values = np.array([quantity(path) for path in paths])
                _note(row, name, quantity(states), values, self.draws, rng)
        return {**row, "seconds": time.process_time() - began}


def _note(
    row: Row, name: str, truth: float, values: Any, draws: int, rng: np.random.Generator
) -> None:
    """Note where the truth stands among draws; among fewer than asked for, as if among these."""
    rank = int((values < truth).sum() + rng.integers(0, (values == truth).sum() + 1))
    if len(values) != draws:
        rank = int((rank + rng.random()) / (len(values) + 1) * (draws + 1))
    row["truth"][name] = truth
    row["rank"][name] = rank
    row["mean"][name], row["sd"][name] = float(values.mean()), float(values.std())
    low, high = np.quantile(values, [0.05, 0.95])
    row["low"][name], row["high"][name] = float(low), float(high)


def simulation_based_calibration(
    model: str | Callable[..., Any] = "boids",
    guide: str | Callable[..., Any] = "auto",
    *,
    datasets: int = 200,
    draws: int = 199,
    frames: int = 80,
    individuals: int = 8,
    trials: int = 2,
    scales: Scales | None = None,
    spread: float | None = 0.5,
    graph: str = "complete",
    path_draws: int = 0,
    quantities: Mapping[str, Quantity] | None = None,
    seed: int = 0,
    processes: int = 1,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    **settings: Any,
) -> xr.Dataset:
    r"""Calibrate a model and guide by simulation (Talts et al. 2018, arXiv:1804.06788).

    Parameters are drawn from their priors, first states, paths and sightings by them; the data set
    is fitted. Over many of them the truth is anywhere among draws from its posterior with the same
    probability, whatever the priors - if the posterior is right. A guide that is too sure puts it
    among the lowest and highest draws too often, a biased one on one side.

    Everything is drawn from the model's own joint distribution, so that an exact posterior passes.
    One prior must hold for all data sets, and does not depend on them: the model is built from
    given scales, once.

    Parameters
    ----------
    model, guide
        As in :func:`swarmssm.inference.fit`. A state-space model of which all parameters have
        priors.
    datasets
        Their number.
    draws
        From each posterior, independent; ranks are 0 to ``draws``. With 199 all levels of
        coverage are hit exactly.
    frames, individuals, trials
        Sizes of a data set, all trials with the same parameters.
    scales
        From which the model takes its default priors: of the tracks that are like those of
        interest (:func:`swarmssm.models.scales_of`). Absent,
        :func:`~swarmssm.analysis.diagnostics.calibration.synthetic.standard_scales`.
    spread
        ``LogNormal`` priors that the model comes with are made this wide where they are wider,
        for the simulation and the fit; ``None``: they are left as they are. See
        :class:`~swarmssm.analysis.diagnostics.calibration.synthetic.FixedModel`.
    graph
        Who sees whom, see ``SyntheticData``.
    path_draws
        Draws of the states, for ranks of ``quantities``; 0 for none. Each costs a smoother.
    quantities
        Name -> function of the states ``(trial, time, individual, state)``; absent,
        :data:`STATE_QUANTITIES`.
    seed
        Of everything; data set k is the same whatever their number.
    processes
        Data sets at once.
    out
        File of lines of JSON, one for each data set as it is finished.
    resume
        Go on with ``out``; also with more data sets than at first.
    progress
        Called at the beginning and after each data set.
    **settings
        Of :func:`swarmssm.inference.fit`; ``model_options`` and ``priors`` are those of the
        simulation too. With a linearized guide no frames are ``given`` unless
        ``guide_options`` say so: simulated groups begin as the model says.

    Returns
    -------
    See :func:`~swarmssm.analysis.diagnostics.calibration.calibration_of_ranks`, with the truth and
    the posterior of each data set besides. A data set whose simulation or fit fails is counted in
    ``attrs["failed"]``, with the reasons, and is not among the ranks: a posterior is calibrated
    only if hardly any do.

    Raises
    ------
    InputError
        If an argument is wrong, the model has a weight without a prior, or ``out`` does not fit.
    WorkError
        If all data sets fail, or nothing can be written.
    """
    for name, value in (
        ("datasets", datasets),
        ("draws", draws),
        ("frames", frames),
        ("individuals", individuals),
        ("trials", trials),
    ):
        _check_count(name, value, 1)
    _check_count("path_draws", path_draws, 0)
    _check_count("seed", seed, 0)
    options = dict(settings.pop("model_options", {}))
    priors = dict(settings.pop("priors", {}))
    own = standard_scales(individuals) if scales is None else scales
    fixed = FixedModel(model, own, options, priors, spread)
    if not priors_of(fixed()):
        raise InputError(f"model: {fixed.name} has no parameter with a prior to be ranked.")
    if guide == "auto":
        guide = fixed.default_guide()
    if guide == "linearized":
        settings["guide_options"] = {"given": 0, **settings.get("guide_options", {})}
    chosen = STATE_QUANTITIES if quantities is None else dict(quantities)
    data = SyntheticData(fixed, frames, individuals, trials, graph)
    work = _Calibrate(data, guide, settings, draws, path_draws, chosen, seed)
    told = {
        "study": "calibration",
        "model": fixed.name,
        "guide": guide if isinstance(guide, str) else getattr(guide, "__qualname__", repr(guide)),
        "draws": draws,
        "frames": frames,
        "individuals": individuals,
        "trials": trials,
        "graph": graph,
        "spread": spread,
        "scales": own.to_dict(),
        "model_options": options,
        "priors": priors,
        "path_draws": path_draws,
        "quantities": sorted(chosen) if path_draws else [],
        "seed": seed,
        "fit": settings,
    }
    rows = parallel_map(
        work,
        range(datasets),
        settings=told,
        out=out,
        resume=resume,
        processes=processes,
        progress=progress,
    )
    return _gather(rows, draws, told)


def _gather(rows: Sequence[Row], draws: int, told: Mapping[str, Any]) -> xr.Dataset:
    """Return the calibration of the rows that did not fail, with truths and posteriors."""
    failed = [str(row["failed"]) for row in rows if "failed" in row]
    good = [row for row in rows if "failed" not in row]
    if not good:
        raise WorkError(f"All {len(rows)} data sets failed, the first one so: {failed[0]}")
    names = list(good[0]["rank"])
    found = calibration_of_ranks(
        {name: [row["rank"][name] for row in good] for name in names}, draws
    )
    for name, title in (
        ("truth", "true value"),
        ("mean", "posterior mean"),
        ("sd", "posterior standard deviation"),
        ("low", "5 % quantile of the posterior"),
        ("high", "95 % quantile of the posterior"),
    ):
        values = np.array([[row[name][own] for row in good] for own in names])
        found[name] = (("parameter", "dataset"), values, {"long_name": title, "units": ""})
    found["seconds"] = (
        "dataset",
        np.array([row["seconds"] for row in good]),
        {"long_name": "time of a fit", "units": "s"},
    )
    found = found.assign_coords(dataset=[row["index"] for row in good])
    reasons = sorted({reason: failed.count(reason) for reason in failed}.items())
    found.attrs |= {
        "failed": len(failed),
        "failures": "; ".join(f"{count} x {reason}" for reason, count in reasons),
        "settings": json.dumps(told, default=str),
    }
    return found


def _check_count(name: str, value: Any, least: int) -> None:
    """Refuse what is no whole number, or too small a one."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(f"{name}: it must be a whole number from {least}, not {value!r}.")
