"""Simulation-based calibration: fits of data sets drawn from the model itself."""

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
from swarmssm.analysis.diagnostics.sbc.ranks import Calibration, calibration_of_ranks
from swarmssm.analysis.diagnostics.sbc.simulated import (
    FixedModel,
    SimulatedData,
    standard_scales,
)
from swarmssm.analysis.diagnostics.studies import check_whole, failures, name_of, run_study
from swarmssm.analysis.posterior.accelerations import posterior_paths
from swarmssm.errors import InputError, WorkError
from swarmssm.inference.parameter_labels import label_draws, label_numbers
from swarmssm.jobs import Progress, Row
from swarmssm.models import Scales
from swarmssm.models.parameters import priors_of

__all__ = ["STATE_QUANTITIES", "sbc"]

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

    data: SimulatedData
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
        true = label_numbers({name: value.to(torch.float32) for name, value in truth.items()})
        for own, values in label_draws({name: drawn[name] for name in truth}).items():
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


def sbc(
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
) -> Calibration:
    r"""Calibrate a model and guide by simulation (Talts et al. 2018, arXiv:1804.06788).

    Parameters are drawn from their priors, then initial states, paths and observations given them;
    each data set is fitted. If posteriors are exact, the rank of the true value among posterior
    draws is uniform over data sets, whatever the priors. An overconfident posterior puts the truth
    among the lowest and highest draws too often, a biased one on one side.

    Everything is drawn from the joint distribution of the model, so that an exact posterior passes.
    The prior is the same for all data sets: the model is built once, from given scales.

    Parameters
    ----------
    model, guide
        As in :func:`swarmssm.inference.fit`. A state-space model of which all parameters have
        priors.
    datasets
        Number of data sets.
    draws
        Independent draws from each posterior; ranks are 0 to ``draws``. With 199 the coverage at
        all levels can be exact.
    frames, individuals, trials
        Size of a data set; all its trials have the same parameters.
    scales
        From which the model takes its default priors, for instance those of a recording
        (:func:`swarmssm.models.scales_of`). Absent,
        :func:`~swarmssm.analysis.diagnostics.sbc.simulated.standard_scales`.
    spread
        Upper limit of the width of the model's own ``LogNormal`` priors, for simulation and fit;
        ``None``: no limit. See
        :class:`~swarmssm.analysis.diagnostics.sbc.simulated.FixedModel`.
    graph
        Neighbourhood rule, see ``SimulatedData``.
    path_draws
        Draws of the states, for ranks of ``quantities``; 0 for none. Each takes a smoother.
    quantities
        Name -> function of the states ``(trial, time, individual, state)``; absent,
        :data:`STATE_QUANTITIES`.
    seed
        Seed; data set k does not depend on their number.
    processes
        Data sets at once.
    out
        File of JSON lines, one for each data set as it is finished.
    resume
        Continue ``out``; ``datasets`` may have grown.
    progress
        Called at the start and after each data set.
    **settings
        Of :func:`swarmssm.inference.fit`; ``model_options`` and ``priors`` hold for the simulation
        too. With a linearized guide no frames are ``given`` unless ``guide_options`` say so:
        initial states of simulated groups follow the model.

    Returns
    -------
    Its ``data`` are those of
    :func:`~swarmssm.analysis.diagnostics.sbc.calibration_of_ranks`, with the truth and the
    posterior of each data set besides. A data set whose simulation or fit fails is counted in
    ``attrs["failed"]``, with the reasons, and has no rank: a posterior is calibrated only if few
    fail.

    Raises
    ------
    InputError
        If an argument is invalid, the model has a weight without a prior, or ``out`` has other
        settings.
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
        check_whole(name, value, 1)
    check_whole("path_draws", path_draws, 0)
    check_whole("seed", seed, 0)
    options = dict(settings.pop("model_options", {}))
    priors = dict(settings.pop("priors", {}))
    own = standard_scales(individuals) if scales is None else scales
    fixed = FixedModel(model, own, options, priors, spread)
    if not priors_of(fixed()):
        raise InputError(f"model: {fixed.name} has no parameter with a prior to rank.")
    if guide == "auto":
        guide = fixed.default_guide()
    if guide == "linearized":
        settings["guide_options"] = {"given": 0, **settings.get("guide_options", {})}
    chosen = STATE_QUANTITIES if quantities is None else dict(quantities)
    data = SimulatedData(fixed, frames, individuals, trials, graph)
    work = _Calibrate(data, guide, settings, draws, path_draws, chosen, seed)
    metadata = {
        "study": "sbc",
        "model": fixed.name,
        "guide": name_of(guide),
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
    rows = run_study(
        work,
        datasets,
        metadata,
        out=out,
        resume=resume,
        processes=processes,
        progress=progress,
    )
    return Calibration(_labelled(rows, draws, metadata))


def _labelled(rows: Sequence[Row], draws: int, metadata: Mapping[str, Any]) -> xr.Dataset:
    """Return the calibration of the rows that did not fail, with truths and posteriors."""
    good = [row for row in rows if "failed" not in row]
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
    found.attrs |= {**failures(rows), "settings": json.dumps(metadata, default=str)}
    return found
