"""Ask a fitted model all that this folder can ask, of the same tracks."""

import contextlib
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

import swarmssm
from swarmssm.analysis.interpretation.extrapolation import beyond_training
from swarmssm.analysis.interpretation.forces.maps import force_maps
from swarmssm.analysis.interpretation.forces.posterior import TERMS, force_summary, posterior_forces
from swarmssm.analysis.interpretation.forces.truth import force_agreement, true_forces
from swarmssm.analysis.interpretation.inferred_edges import inferred_edges
from swarmssm.analysis.interpretation.influence.delays import leadership_delays
from swarmssm.analysis.interpretation.influence.leaders import find_isolated, find_leader
from swarmssm.analysis.interpretation.influence.posterior import influence
from swarmssm.analysis.interpretation.kernels.posterior import interaction_kernels
from swarmssm.analysis.interpretation.kernels.truth import kernel_agreement, true_kernels
from swarmssm.analysis.interpretation.latents.alignment import latent_force_alignment
from swarmssm.analysis.interpretation.result import ANALYSES, Analysis
from swarmssm.analysis.posterior.accelerations import PosteriorPaths, posterior_paths
from swarmssm.analysis.posterior.frames import default_part, same_tracks
from swarmssm.analysis.posterior.inferred_graph import has_inferred_edges
from swarmssm.analysis.scoring.rolling_origin import score
from swarmssm.errors import InputError, SwarmssmError
from swarmssm.inference import Fit
from swarmssm.tracks import validate_tracks, with_trials
from swarmssm.tracks.splits import PARTS

__all__ = ["LARGEST", "TITLES", "analyze"]

#: Rows of a parameter in the table of parameters, however many numbers it has.
ALL = 10**9

#: Bytes that the draws of forces may take; of longer recordings frames are left out.
LARGEST = 200_000_000
#: Draws of the parameters' kernels for each draw of a path.
KERNELS_A_PATH = 10
TITLES = {
    "paths": "states",
    "forces": "forces",
    "kernels": "kernels of distance",
    "force_maps": "force maps",
    "latents": "latents against forces",
    "influence": "influence",
    "delays": "delays of turning",
    "edges": "inferred edges",
    "scores": "forecast scores",
    "parameters": "parameters",
}
#: What answers each question.
FUNCTIONS: dict[str, Callable[..., xr.Dataset]] = {
    "forces": posterior_forces,
    "kernels": interaction_kernels,
    "force_maps": force_maps,
    "latents": latent_force_alignment,
    "influence": influence,
    "delays": leadership_delays,
    "scores": score,
}
#: Decided here for all of them; the draws of forecasts are others than those of paths.
SHARED = {"fit", "fits", "tracks", "draws", "seed", "paths", "progress"}
OWN = {"scores": {"draws"}}


def analyze(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    draws: int = 20,
    part: str | None = None,
    seed: int = 0,
    only: Sequence[str] | None = None,
    against: Mapping[str, Fit] | None = None,
    scores: bool = True,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Analysis:
    """Say which forces act, by which rule, what the latents carry, and who moves whom.

    An analysis that is not available for this model or these tracks is left out, and a note says
    why.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those it was fitted on, or others.
    draws
        Draws of paths from the posterior, each with its own parameters; of kernels ten times as
        many.
    part
        ``"all"`` frames, or the ``"train"``, ``"validation"`` or ``"test"`` part of the tracks that
        the model was fitted on. Absent: the frames of these that were held out (the test part,
        else the validation part, else all, with a note), and all of any others.
    seed
        Of all draws.
    only
        Which analyses, of :data:`swarmssm.analysis.interpretation.result.ANALYSES`; absent, all.
    against
        Other fits, by name, whose forecasts are scored too.
    scores
        Whether forecasts of held-out frames are scored against simple baselines, see
        :func:`swarmssm.analysis.scoring.score`. Without, the forces are not tested.
    options
        Further arguments of each, such as ``{"force_maps": {"bins": 21}}``; those of the forecasts
        are ``"scores"``.
    progress
        Called before each analysis with its name, and before all with ``"paths"``, when the draws
        are made that they share.

    Raises
    ------
    InputError
        If an argument is out of range or unknown, the tracks do not fit the model, or no analysis
        is available.
    """
    chosen = _chosen(only)
    given = _options(options)
    if not scores and (against or "scores" in given):
        raise InputError("scores: it is off, but options or fits of the forecasts are given.")
    if draws < 1:
        raise InputError(f"draws: there must be at least 1, not {draws}.")
    if seed < 0:
        raise InputError(f"seed: it must not be negative, and it is {seed}.")
    fits = _named(fit, against or {})
    whole = validate_tracks(tracks)
    part, notes = _part(fit, whole, part)
    tracks = with_trials(whole) if part == "all" else fit.part(whole, part)
    fit.prepare(tracks)
    notes += [note for note in (beyond_training(fit, tracks).note,) if note]
    show = progress or (lambda name: None)
    paths = None
    if set(chosen) - {"latents", "delays"}:
        show("paths")
        # A model without paths is refused by each analysis that needs them.
        with contextlib.suppress(SwarmssmError):
            paths = posterior_paths(fit, tracks, draws, seed)
    found: dict[str, xr.Dataset] = {}
    refused: list[SwarmssmError] = []

    def ask(name: str) -> None:
        show(name)
        own = given.get(name, {})
        more: list[str] = []
        try:
            if name == "scores":
                found[name] = score(fits, whole, seed=seed, **own)
            else:
                found[name], more = _ask(name, fit, tracks, paths, draws, seed, own)
        except SwarmssmError as error:
            if str(error).partition(":")[0] in own:
                raise
            refused.append(error)
            more = [f"Left out: {TITLES[name]}. {error}"]
        notes.extend(more)

    for name in chosen:
        ask(name)
    if not found:
        raise refused[0]
    if has_inferred_edges(fit.model):
        show("edges")
        found["edges"] = inferred_edges(fit, tracks)
    if scores:
        ask("scores")
    table = fit.summary(seed=seed, entries=ALL)[["mean", "sd", "low", "high"]]
    if len(table):
        found["parameters"] = _labelled(table)
    settings = {
        "model": fit.settings.model,
        "guide": fit.settings.guide,
        "part": part,
        "draws": draws,
        "seed": seed,
        "options": {name: dict(values) for name, values in given.items()},
        "version": swarmssm.__version__,
    }
    return Analysis(**found, settings=settings, notes=tuple(notes))


def _named(fit: Fit, against: Mapping[str, Fit]) -> dict[str, Fit]:
    """Return all fits by name, the analysed one first."""
    name = fit.settings.model
    if name in against:
        raise InputError(f"against: {name!r} is the name of the fit itself. Use another name.")
    return {name: fit, **against}


def _chosen(only: Sequence[str] | None) -> tuple[str, ...]:
    """Return names of analyses in their order."""
    if only is None:
        return ANALYSES
    for name in only:
        if name not in ANALYSES:
            raise InputError(f"only: {name!r} is unknown; choose of {', '.join(ANALYSES)}.")
    if not only:
        raise InputError(f"only: name at least one of {', '.join(ANALYSES)}.")
    return tuple(name for name in ANALYSES if name in only)


def _options(options: Mapping[str, Mapping[str, Any]] | None) -> Mapping[str, Mapping[str, Any]]:
    """Refuse arguments that an analysis does not have."""
    options = options or {}
    for name, values in options.items():
        if name not in FUNCTIONS:
            raise InputError(f"options: {name!r} is unknown; choose of {', '.join(FUNCTIONS)}.")
        shared = SHARED - OWN.get(name, set())
        known = [key for key in inspect.signature(FUNCTIONS[name]).parameters if key not in shared]
        for key in values:
            if key not in known:
                has = f"it has {', '.join(known)}" if known else "it has none"
                raise InputError(f"options: {name} has no option {key!r}; {has}.")
    return options


def _part(fit: Fit, tracks: xr.Dataset, part: str | None) -> tuple[str, list[str]]:
    """Return the part to analyse, and what a reader has to know of it."""
    own = same_tracks(fit, tracks)
    if part is None:
        part = default_part(fit) if own else "all"
        if own and part != "test":
            left = "the validation part is analysed" if part == "validation" else "none are left"
            note = f"No test part was held out of these tracks: {left}."
            if part == "all":
                note += " All frames are analysed, those that the model was trained on among them."
            return part, [note]
        return part, []
    if part == "all":
        trained = "The frames include those that the model was trained on."
        return part, [trained] if own else []
    if part not in PARTS:
        raise InputError(f"part: {part!r} is unknown; choose one of {', '.join(PARTS)} or all.")
    if not own:
        raise InputError(
            f"part: these are not the tracks that the model was fitted on, and have no {part} "
            "part of its. Analyse all of them."
        )
    return part, ["The model was trained on these frames."] if part == "train" else []


def _ask(
    name: str,
    fit: Fit,
    tracks: xr.Dataset,
    paths: PosteriorPaths | None,
    draws: int,
    seed: int,
    options: Mapping[str, Any],
) -> tuple[xr.Dataset, list[str]]:
    """Return the answer to one question, with notes."""
    if name == "forces":
        return _forces(fit, tracks, paths or posterior_paths(fit, tracks, draws, seed))
    arguments: dict[str, Any] = {"seed": seed, **options}
    if name == "delays":
        return leadership_delays(tracks, **arguments), []
    if name != "latents":
        arguments["draws"] = KERNELS_A_PATH * draws if name == "kernels" else draws
        arguments["paths"] = paths
    found = FUNCTIONS[name](fit, tracks, **arguments)
    if name == "kernels":
        found = _with_true_kernels(found, tracks)
    elif name == "influence":
        found = _with_decisions(found, seed)
    return found, []


def _forces(fit: Fit, tracks: xr.Dataset, paths: PosteriorPaths) -> tuple[xr.Dataset, list[str]]:
    """Draw forces and summarise them; every n-th frame if all would take more than LARGEST."""
    draws, states = paths.draws, paths.states
    frames = states[0, ..., 0].numel()
    a_draw = frames * 4 * (states.shape[-1] // 2) * (len(TERMS) + 2)
    stride = math.ceil(draws * a_draw / LARGEST)
    notes = []
    if stride == 1:
        drawn = posterior_forces(fit, tracks, paths=paths)
    else:
        notes.append(
            f"Forces are kept for every {_ordinal(stride)} frame: those of all would take "
            f"{draws * a_draw / 1e6:.0f} MB. Fewer draws keep more frames."
        )
        at_once = max(1, LARGEST // a_draw)
        portions = []
        for first in range(0, draws, at_once):
            some = slice(first, first + at_once)
            own = replace(paths, states=states[some], parameters=paths.parameters[some])
            portion = posterior_forces(fit, tracks, paths=own)
            portions.append(portion.isel(time=slice(None, None, stride)))
        drawn = xr.concat(portions, "draw").assign_coords(draw=np.arange(draws))
    summary = force_summary(drawn).drop_vars("explained")
    summary = summary.assign({name: summary[name].astype(np.float32) for name in summary})
    whole = drawn.merge(summary, combine_attrs="override").assign_attrs(stride=stride)
    if "force" in tracks:
        with contextlib.suppress(InputError):
            agreement = force_agreement(drawn, true_forces(tracks))
            names = {name: f"truth_{name}" for name in agreement.data_vars}
            whole = whole.merge(agreement.rename(names))
    return whole, notes


def _with_true_kernels(found: xr.Dataset, tracks: xr.Dataset) -> xr.Dataset:
    """Add the kernels behind simulated tracks, if they are known."""
    if "simulation" not in tracks.attrs:
        return found
    with contextlib.suppress(InputError):
        truth = true_kernels(tracks, found)
        agreement = kernel_agreement(found, truth)
        agreement = agreement.rename(error="truth_error", coverage="truth_inside")
        truth = truth.rename({name: f"truth_{name}" for name in truth.data_vars})
        return found.merge(truth).merge(agreement)
    return found


def _with_decisions(found: xr.Dataset, seed: int) -> xr.Dataset:
    """Add whether somebody leads, and who is isolated."""
    leader = find_leader(found, seed=seed)
    isolated = find_isolated(found)
    found = found.assign(
        leader_alarm=leader["alarm"],
        leads=leader["leads"].astype(np.int8),
        isolated=isolated["isolated"].astype(np.int8),
    )
    flags = {"leads": "1 if declared the leader", "isolated": "1 if declared isolated"}
    for name, text in flags.items():
        found[name].attrs = {"units": "1", "long_name": text}
    return found.assign_attrs(
        leader=leader.attrs["leader"],
        leader_by=leader.attrs["by"],
        leader_rate=leader.attrs["rate"],
        isolated=isolated.attrs["isolated"],
        isolated_by=isolated.attrs["by"],
    )


def _labelled(table: Any) -> xr.Dataset:
    """Return the table of parameters as a dataset."""
    titles = {
        "mean": "posterior mean",
        "sd": "posterior standard deviation",
        "low": "5th percentile",
        "high": "95th percentile",
    }
    data = {
        name: (
            "parameter",
            table[name].to_numpy(),
            {"units": "of the parameter, in tracks' length unit and seconds", "long_name": text},
        )
        for name, text in titles.items()
    }
    return xr.Dataset(data, {"parameter": [str(name) for name in table.index]})


def _ordinal(number: int) -> str:
    """Return 2nd, 3rd, 4th ..."""
    last = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{'th' if number % 100 in (11, 12, 13) else last}"
