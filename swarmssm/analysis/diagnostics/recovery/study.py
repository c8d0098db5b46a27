"""Recovery study: fits of simulated data with known parameters, over several designs."""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyro
import torch
import xarray as xr
from scipy import stats

from swarmssm import inference
from swarmssm.analysis.diagnostics.recovery.designs import (
    FACTORS,
    Design,
    designs_of,
    titles_of,
    varied_values,
)
from swarmssm.analysis.diagnostics.recovery.table import Recovery
from swarmssm.analysis.diagnostics.sbc.simulated import (
    UNIFORM_SIDE,
    FixedModel,
    standard_scales,
)
from swarmssm.analysis.diagnostics.studies import check_whole, failures, name_of, run_study
from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import GraphRule
from swarmssm.inference.guides.parameters import GlobalGuide
from swarmssm.inference.parameter_labels import label_draws, label_numbers
from swarmssm.jobs import Progress, Row
from swarmssm.models import ObservedEdges, Scales, StateSpaceModel, find_model
from swarmssm.models.parameters import priors_of
from swarmssm.models.registry import options_of
from swarmssm.tracks import MAX_COORDINATE, Array, make_tracks

__all__ = ["recovery"]

#: Truths of parameters of these names where neither scales nor values say what is typical.
TYPICAL = {"cohesion_gain": 0.6, "separation_gain": 0.15, "alignment_gain": 0.8}
#: Half the angle within which the first headings of a group lie, in radians.
HEADINGS = 0.8
NOISE = "emission.noise"


@dataclass(frozen=True)
class _Recover:
    """Simulate one data set of a design, and fit it as a user would."""

    model: str | Callable[..., Any]
    guide: str | Callable[..., Any]
    designs: tuple[Design, ...]
    repeats: int
    scales: Scales | None
    values: Mapping[str, float]
    graph: str | None
    fit: Mapping[str, Any]
    seed: int

    def __call__(self, index: int) -> Row:
        """Return true values, estimates and intervals."""
        # In Pyro's global store one fit after the other would find the parameters of the first.
        with pyro.settings.context(module_local_params=True):
            return self._row(index)

    def _row(self, index: int) -> Row:
        """Simulate and fit."""
        design = self.designs[index // self.repeats]
        entropy = [self.seed, *design.digits, index % self.repeats]
        first, second = np.random.SeedSequence(entropy).generate_state(2).tolist()
        try:
            tracks, truth = self.simulate(design, first)
        except WorkError as error:
            return {"failed": f"simulation: {error}"}
        began = time.process_time()
        options, graph = self.edges(design)
        own = {**self.fit, "model_options": options}
        if graph is not None:
            own["graph"] = graph
        try:
            fitted = inference.fit(
                self.model,
                tracks,
                guide=self.guide,
                **{"seed": second, "fractions": (1.0, 0.0, 0.0), **own},
            )
        except WorkError as error:
            return {"failed": f"fit: {error}"}
        drawn = fitted.parameters(2000, second)
        row: Row = {"truth": {}, "median": {}, "sd": {}, "low": {}, "high": {}}
        numbers = label_numbers(truth)
        for label, column in label_draws({name: drawn[name] for name in truth}).items():
            low, middle, high = np.quantile(column, [0.05, 0.5, 0.95])
            row["truth"][label] = numbers[label]
            row["median"][label], row["sd"][label] = float(middle), float(column.std())
            row["low"][label], row["high"][label] = float(low), float(high)
        return {**row, "seconds": time.process_time() - began}

    def edges(self, design: Design) -> tuple[dict[str, Any], str | None]:
        """Return the model's options and the graph of the data, which say who sees whom."""
        options = dict(self.fit.get("model_options", {}))
        rule = self.graph if design.radius is None else f"radius:{design.radius!r}"
        if rule is None or "edges" in options:
            return options, None
        # The graph of the hidden states where the model can have it: that of noisy sightings is
        # another one.
        if "edges" in _arguments(self.model):
            return {**options, "edges": rule}, None
        return options, rule

    def truth(self, design: Design) -> tuple[StateSpaceModel, dict[str, torch.Tensor], Scales]:
        """Return the model, the values of all parameters with a prior, and the scales."""
        options, _ = self.edges(design)
        scales = _scales(design, self.scales)
        model = FixedModel(self.model, scales, options, self.fit.get("priors", {}))().double()
        names = priors_of(model)
        given = {**({} if self.scales else _known(TYPICAL, names)), **_full(self.values, names)}
        if NOISE in names:
            given[NOISE] = design.noise
        # What no one says is typical: as the prior has it.
        middle = _medians(model)
        values = {
            name: torch.as_tensor(given[name], dtype=torch.float64).expand(middle[name].shape)
            if name in given
            else middle[name]
            for name in names
        }
        return model, values, scales

    def simulate(self, design: Design, seed: int) -> tuple[xr.Dataset, dict[str, torch.Tensor]]:
        """Return tracks of positions with noise, and the true values."""
        model, values, scales = self.truth(design)
        _, graph = self.edges(design)
        space = scales.space
        if model.state_dim != 2 * space:
            raise InputError(
                f"model: its states have {model.state_dim} features, and to be started at a "
                f"given density they must be positions and velocities, {2 * space} of them."
            )
        drawn = model.simulate(
            design.frames,
            design.individuals,
            num_windows=design.trials,
            values=values,
            graph=(graph or "complete") if isinstance(model.edges, ObservedEdges) else None,
            first=_first(design, scales, seed),
            seed=seed,
        )
        seen = drawn.observations.numpy()[..., :space]
        if not (np.abs(seen) <= MAX_COORDINATE).all():
            raise WorkError("The group flew apart.")
        return make_tracks(seen, fps=1.0 / scales.dt, source_software="swarmssm"), values


def recovery(
    model: str | Callable[..., Any] = "boids",
    guide: str | Callable[..., Any] = "auto",
    *,
    factors: Mapping[str, Sequence[float]] | Sequence[str] | None = None,
    base: Design | None = None,
    grid: bool = False,
    datasets: int = 5,
    values: Mapping[str, float] | None = None,
    scales: Scales | None = None,
    graph: str | None = None,
    tolerance: float = 0.1,
    seed: int = 0,
    processes: int = 1,
    out: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    **settings: Any,
) -> Recovery:
    """Estimate known parameters from simulated data sets of several designs.

    One factor after the other is varied around a base design (or all of them, in a grid). For each
    design some data sets are simulated from the model and fitted as a user would, who knows
    positions with noise and the neighbourhood rule, with the default priors of these positions.

    Parameters
    ----------
    model, guide
        As in :func:`swarmssm.inference.fit`; a state-space model without weights to be learned.
    factors
        Name -> values, or names alone for multiples of the base. Names are ``individuals``,
        ``density``, ``radius``, ``noise``, ``frames`` and ``trials``; absent, all but trials.
    base
        The design around which they are varied.
    grid
        Every combination of the values, instead of one factor at a time.
    datasets
        Data sets of each design.
    values
        True values by name, with or without ``transition.``; others are the medians of the model's
        default priors at the scales. Without scales, cohesion, separation and alignment are 0.6,
        0.15 and 0.8.
    scales
        For instance those of a recording; absent,
        :func:`~swarmssm.analysis.diagnostics.sbc.simulated.standard_scales`. The number of
        individuals, the noise and, where it is varied, the density of the design replace theirs.
    graph
        Neighbourhood rule of a base without radius.
    tolerance
        Relative error that is aimed at.
    seed, processes, out, resume, progress
        As in :func:`~swarmssm.analysis.sbc`.
    **settings
        Of :func:`swarmssm.inference.fit`.

    Returns
    -------
    Its ``data`` have the dimensions ``design``, ``parameter`` and ``dataset``:

    ``truth``, ``median``, ``sd``, ``low``, ``high``
        Of each data set; the last ones the ends of the central 90 % interval. NaN where it failed.
    ``error (design, parameter)``, ``bias``
        Median over data sets of the relative error's size, and mean of the deviation from the
        truth relative to the truth's size (of the middle of a box, to half its width).
    ``width (design, parameter)``
        Median of half the 90 % interval, relative to the truth.
    ``coverage``, ``coverage_low``, ``coverage_high``
        Share of intervals that hold the truth, and its exact binomial 95 % interval.
    ``frames_needed (design, parameter)``
        Frames of each trial at which the posterior's standard deviation would fall to the
        tolerance, if it falls with the square root of their number.
    ``factor (design)``, ``value (design)``
        What is varied, and its value (``base`` and NaN for the base itself); the whole design is in
        coordinates named after the factors.

    Raises
    ------
    InputError
        If an argument is invalid, or ``out`` has other settings.
    WorkError
        If all data sets fail, or nothing can be written.
    """
    check_whole("datasets", datasets, 1)
    check_whole("seed", seed, 0)
    if not 0.0 < tolerance < math.inf:
        raise InputError(f"tolerance: it must be above 0, and it is {tolerance!r}.")
    if graph is not None:
        GraphRule.parse(graph)
    base = Design() if base is None else base
    if base.radius is None and graph is None and "edges" not in settings.get("model_options", {}):
        raise InputError("graph: it must be given where the base has no radius.")
    varied = varied_values(factors, base)
    labels, chosen = designs_of(varied, base, grid)
    work = _Recover(
        model, guide, tuple(chosen), datasets, scales, dict(values or {}), graph, settings, seed
    )
    for own in chosen:
        _check_truth(work, own)
    metadata = {
        "study": "recovery",
        "model": name_of(model),
        "guide": name_of(guide),
        "designs": [asdict(own) for own in chosen],
        "datasets": datasets,
        "values": dict(values or {}),
        "scales": None if scales is None else scales.to_dict(),
        "graph": graph,
        "seed": seed,
        "fit": settings,
    }
    rows = run_study(
        work,
        len(chosen) * datasets,
        metadata,
        out=out,
        resume=resume,
        processes=processes,
        progress=progress,
    )
    return Recovery(_labelled(rows, labels, chosen, datasets, tolerance, metadata))


def _scales(design: Design, scales: Scales | None) -> Scales:
    """Return the scales of a design: of its size, its noise and its density."""
    space = 2 if scales is None else scales.space
    side = (design.individuals / design.density) ** (1.0 / space)
    if scales is None:
        standard = standard_scales(design.individuals, noise=design.noise)
        # The box leaves the room that a group takes that spreads a little.
        half = side
        return replace(
            standard,
            low=(-half,) * space,
            high=(half,) * space,
            length=2.0 * half / UNIFORM_SIDE,
            spacing=0.5 * design.density ** (-1.0 / space),
        )
    return replace(scales, individuals=design.individuals, noise=design.noise)


def _first(design: Design, scales: Scales, seed: int) -> torch.Tensor:
    """Draw first states: uniform at the density, headings about a common one for each trial."""
    rng = np.random.default_rng([seed, 1])
    space = scales.space
    side = (design.individuals / design.density) ** (1.0 / space)
    shape = (design.trials, design.individuals)
    position = np.array(scales.centre) + side * (rng.random((*shape, space)) - 0.5)
    common = rng.standard_normal((design.trials, 1, space))
    common /= np.linalg.norm(common, axis=-1, keepdims=True)
    spread = math.tan(HEADINGS / 2.0) * rng.standard_normal((*shape, space))
    heading = common + spread
    heading /= np.linalg.norm(heading, axis=-1, keepdims=True)
    added = 2.0 * space * (scales.noise / scales.dt) ** 2
    speed = math.sqrt(max(scales.speed**2 - added, 0.25 * scales.speed**2))
    return torch.from_numpy(np.concatenate([position, speed * heading], -1))


def _medians(model: StateSpaceModel) -> dict[str, torch.Tensor]:
    """Return the middle of the prior of each parameter."""
    return {name: value.double() for name, value in GlobalGuide(model, "normal").median().items()}


def _check_truth(work: _Recover, design: Design) -> None:
    """Check names and values of parameters before any work is done."""
    model, values, _ = work.truth(design)
    if not values:
        raise InputError("model: it has no parameter with a prior to estimate.")
    model._given(values)


def _full(values: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
    """Return values by full name."""
    found = {}
    for name, value in values.items():
        mine = [full for full in names if full == name or full.endswith(f".{name}")]
        if len(mine) != 1:
            listed = ", ".join(mine or names)
            raise InputError(
                f"values: {name} is the name of {'no' if not mine else 'more than one'} parameter "
                f"with a prior. Choose one of {listed}."
            )
        found[mine[0]] = value
    return found


def _known(values: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
    """Return those values whose parameters are there."""
    return {
        full: value
        for name, value in values.items()
        for full in names
        if full == f"transition.{name}"
    }


def _arguments(model: str | Callable[..., Any]) -> set[str]:
    """Return the names of the options of a model's constructor."""
    return set(options_of(find_model(model)))


def _labelled(
    rows: Sequence[Row],
    labels: Sequence[tuple[str, float]],
    designs: Sequence[Design],
    datasets: int,
    tolerance: float,
    metadata: Mapping[str, Any],
) -> xr.Dataset:
    """Return the labelled study."""
    names = list(next(row for row in rows if "failed" not in row)["truth"])
    shape = (len(designs), len(names), datasets)
    table = {part: np.full(shape, np.nan) for part in ("truth", "median", "sd", "low", "high")}
    for index, row in enumerate(rows):
        if "failed" not in row:
            for part, numbers in table.items():
                numbers[index // datasets, :, index % datasets] = [row[part][n] for n in names]
    there = np.isfinite(table["truth"])
    number = there.sum(-1)
    size = _sizes(names, table["truth"])
    relative = (table["median"] - table["truth"]) / size
    hits = ((table["low"] <= table["truth"]) & (table["truth"] <= table["high"])).sum(-1)
    frames = np.array([own.frames for own in designs])[:, None]
    data = {
        "error": (_median(np.abs(relative)), "median of the relative error's size"),
        "bias": (_mean(relative), "mean deviation from the truth, relative to its size"),
        "width": (
            _median(0.5 * (table["high"] - table["low"]) / size),
            "half the 90 % interval, relative to the truth",
        ),
        "coverage": (hits / np.maximum(number, 1), "share of 90 % intervals with the truth"),
        "coverage_low": (
            np.where(hits > 0, stats.beta.ppf(0.025, hits, number - hits + 1), 0.0),
            "lower end of its interval",
        ),
        "coverage_high": (
            np.where(hits < number, stats.beta.isf(0.025, hits + 1, number - hits), 1.0),
            "upper end of its interval",
        ),
        "frames_needed": (
            np.ceil(frames * (_median(table["sd"] / size) / tolerance) ** 2),
            "frames a trial for a standard deviation of the tolerance",
        ),
    }
    dims = ("design", "parameter")
    found = xr.Dataset(
        {
            **{n: (dims, v, {"long_name": title, "units": "1"}) for n, (v, title) in data.items()},
            **{n: ((*dims, "dataset"), v, {"long_name": n, "units": ""}) for n, v in table.items()},
        },
        {
            "parameter": names,
            "dataset": np.arange(datasets),
            "factor": ("design", [name for name, _ in labels]),
            "value": ("design", [value for _, value in labels]),
            "label": ("design", titles_of(labels, designs)),
            "fitted": ("design", number.max(-1)),
            **{
                name: (
                    "design",
                    [math.nan if (v := getattr(s, name)) is None else v for s in designs],
                )
                for name in FACTORS
            },
        },
    )
    found.attrs = {
        "tolerance": tolerance,
        **failures(rows),
        "settings": json.dumps(metadata, default=str),
    }
    return found


def _median(values: Any) -> Any:
    """Return the median over data sets, NaN where all failed."""
    empty = ~np.isfinite(values).any(-1)
    return np.where(empty, np.nan, np.nanmedian(np.where(empty[..., None], 0.0, values), -1))


def _mean(values: Any) -> Any:
    """Return the mean over data sets, NaN where all failed."""
    empty = ~np.isfinite(values).any(-1)
    return np.where(empty, np.nan, np.nanmean(np.where(empty[..., None], 0.0, values), -1))


def _sizes(names: list[str], truth: Array) -> Array:
    """Return what errors are relative to, ``(design, parameter, dataset)``.

    That is the truth, of which 0 has no relative error; of the middle of a box, whose own numbers
    depend on where the origin is, half the box's width.
    """
    sizes = np.where(truth == 0.0, np.nan, np.abs(truth))
    for index, name in enumerate(names):
        partner = name.replace("center", "half_width")
        if partner != name and partner in names:
            sizes[:, index] = np.abs(truth[:, names.index(partner)])
    return sizes
