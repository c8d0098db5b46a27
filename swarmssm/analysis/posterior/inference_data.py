"""A fit and its data as one labelled object, on which ArviZ's own functions work unchanged."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import xarray as xr

import swarmssm
from swarmssm.analysis.posterior.container import container_of
from swarmssm.analysis.posterior.foresight import draw_parameters, predict_one_step
from swarmssm.analysis.posterior.layout import Layout
from swarmssm.analysis.posterior.log_likelihood import rows_of, segments_of
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.data import Prepared
from swarmssm.inference.parameter_labels import labelled_parameters
from swarmssm.inference.prediction import seeded
from swarmssm.models import StateSpaceModel
from swarmssm.models.parameters import priors_of
from swarmssm.models.pyro_modules import own_parameters
from swarmssm.tracks import MAX_COORDINATE, Array

__all__ = ["to_inference_data"]

Mask = npt.NDArray[np.bool_]
Variable = tuple[tuple[str, ...], Any, dict[str, str]]

#: Frames of the swarms that are simulated from the prior, at most.
PRIOR_FRAMES = 100
#: Frames of which latent states are kept where they are all that is drawn, at most.
STATE_FRAMES = 50
REPLICATED = (
    "one step ahead: each frame is drawn from what the observed frames before it foresee, all "
    "individuals of a frame together; not a free run"
)


def to_inference_data(
    fit: Fit,
    tracks: xr.Dataset,
    draws: int = 200,
    *,
    part: str | None = None,
    predictions: int = 0,
    prior_draws: int = 20,
    states: int | None = None,
    given: int = 2,
    seed: int = 0,
) -> Any:
    r"""Return posterior, replicates, log-likelihood, prior and data as ArviZ has them.

    ======================  ====================================================================
    ``posterior``           parameters with a prior, by name, ``(chain, draw, ...)``; and, if asked
                            for, latent ``states`` (``(…, trial, time, individual, latent)``)
    ``posterior_predictive``  ``position``: each frame drawn from what the frames before it foresee
    ``predictions``         ``position`` after the last frame, if asked for: ``fit.forecast``
    ``log_likelihood``      ``position``: :math:`\log p(x_{t,i} \mid x_{1:t-1}, \theta)`, see
                            :func:`swarmssm.analysis.posterior.pointwise_log_likelihood`
    ``prior``               the same parameters from their priors
    ``prior_predictive``    ``position`` of as many swarms of at most 100 frames
    ``observed_data``       ``position``
    ``constant_data``       ``adjacency (trial, time, individual, neighbor)`` and ``present``
    ``sample_stats``        ``log_density (chain, draw)`` of all that is scored; ``loss`` over
                            ``step``, the course of training, with steps and seed in its attributes
    ======================  ====================================================================

    Positions have the dimensions ``trial, time, individual, space`` if all of them were observed
    and foreseen. As soon as one is missing, ArviZ's functions would meet NaN: then those that are
    there stand in one dimension ``observation``, with coordinates ``trial``, ``time`` and
    ``individual`` along it (``attrs["stacked"]`` is 1, and the group's dataset can be filtered by
    them). ``present`` and ``adjacency`` in ``constant_data`` are always whole. Rows of
    ``posterior`` states that are not known stay NaN.

    Draws of a group belong together, and those of parameters, replicates and log-likelihood with
    each other. A model without priors has points for weights: ``log_likelihood`` is then the same
    for all draws, and ``posterior`` has latent states alone. Only models of the kind
    :class:`swarmssm.models.StateSpaceModel` have a prior of whole swarms.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those it was fitted on, or others.
    draws
        Of the posterior.
    part
        ``"train"``, ``"validation"``, ``"test"``: only these frames are scored, all before them
        being history. Absent, all of them.
    predictions
        Steps to forecast after the end; 0, none.
    prior_draws
        Of the prior and of swarms from it; 0, none.
    states
        Latent states of every so many frames are kept, drawn with the parameters; 0, none. Absent:
        none if there are parameters, else of up to 50 frames. Drawing whole paths takes longer than
        all the rest.
    given
        Frames at the beginning of each trial that are not scored. Two say where a body is and
        where it goes: from there on all models know as much, and may be compared.
    seed
        Seed of all draws.

    Returns
    -------
    ``arviz.InferenceData`` with ArviZ before 1.0, else ``xarray.DataTree``. Both have
    ``to_netcdf``.

    Raises
    ------
    InputError
        If a number is out of range, the part is empty or unknown, or nothing can be scored.

    Examples
    --------
    >>> idata = to_inference_data(fit, tracks)  # doctest: +SKIP
    >>> az.plot_ppc(idata); az.loo(idata); idata.to_netcdf("fit.nc")  # doctest: +SKIP
    """
    for name, value, least in (
        ("draws", draws, 1),
        ("predictions", predictions, 0),
        ("prior_draws", prior_draws, 0),
        ("given", given, 0),
        ("states", 0 if states is None else states, 0),
    ):
        if value < least:
            raise InputError(f"{name}: it must be at least {least}, and it is {value}.")
    segments = None if part is None else segments_of(fit, tracks, part)
    posterior, parameters = _posterior(fit, tracks, draws, states, seed)
    found = predict_one_step(fit, tracks, draws, seed, replicates=True, parameters=parameters)
    scored: Mask = np.logical_and.reduce(~np.isnan(found.density), axis=0)
    labels = [str(name) for name in found.prepared.tracks["trial"].values]
    scored &= rows_of(labels, scored.shape[1], segments)[..., None]
    scored &= _after_given(found.prepared, given)[..., None]
    if not scored.any():
        raise InputError(
            "tracks: no position is left to be scored; take fewer given frames or another part."
        )
    layout = Layout(found.prepared.tracks, scored)
    density = np.broadcast_to(found.density, (draws, *scored.shape))
    observed = found.prepared.tracks["position"].transpose("trial", "time", "individual", "space")
    groups = {
        "posterior": posterior,
        "posterior_predictive": layout.dataset(
            "position", found.replicates, True, "replicate of a position", what=REPLICATED
        ),
        "log_likelihood": layout.dataset(
            "position", density, False, "log-density of a position", units="nat", what=found.how
        ),
        "observed_data": layout.dataset(
            "position", observed.to_numpy(), True, "observed position", drawn=False
        ),
        "constant_data": _constant(found.prepared),
        "sample_stats": _statistics(fit, density, scored),
    }
    if predictions:
        groups["predictions"] = _predictions(fit, tracks, predictions, draws, seed)
    if prior_draws and isinstance(fit.model, StateSpaceModel):
        groups |= _prior(fit, found.prepared, prior_draws, seed)
    notes = _notes(fit, parameters, groups)
    return container_of(
        groups,
        {
            "creation_library": "swarmssm",
            "creation_library_version": swarmssm.__version__,
            "model": fit.settings.model,
            "guide": fit.settings.guide,
            "part": part or "all",
            "given": given,
            "seed": seed,
            "stacked": int(layout.stacked),
            "unit": str(found.prepared.tracks.attrs.get("unit", "")),
            "fps": float(found.prepared.tracks.attrs["fps"]),
            "notes": " ".join(notes),
        },
    )


def _notes(fit: Fit, parameters: Mapping[str, Any], groups: Mapping[str, Any]) -> list[str]:
    """Return what a reader of the groups has to know."""
    notes = [
        "The posterior is variational: its draws are independent, so that r_hat and the effective "
        "sample size of ArviZ say nothing of how good it is.",
        "Log-likelihoods are margins of individuals: their sum is not the joint density of a "
        "frame.",
    ]
    if not parameters:
        notes.append(
            "The weights are points, not drawn: the posterior holds latent states alone, and "
            "az.loo cannot take out what a position told the weights."
        )
    if not isinstance(fit.model, StateSpaceModel):
        notes.append(
            "There is no prior group: the model says what comes after an observed frame, not how a "
            "swarm begins."
        )
    if "predictions" in groups:
        notes.append("Predictions have draws of their own, apart from those of the posterior.")
    return notes


def _posterior(
    fit: Fit, tracks: xr.Dataset, draws: int, states: int | None, seed: int
) -> tuple[xr.Dataset, dict[str, torch.Tensor]]:
    """Return the group of parameters and latent states, and the parameters as tensors."""
    prepared = fit.prepare(tracks)
    source = prepared.tracks
    parameters = draw_parameters(fit, draws, seed)
    frames = source.sizes["time"]
    if states is None:
        states = 0 if parameters else max(1, -(-frames // STATE_FRAMES))
    data: dict[str, Variable] = {}
    dims = ("chain", "draw", "trial", "time", "individual", "latent")
    attrs = {"long_name": "latent state", "units": ""}
    rows = slice(None, None, states) if states else slice(0)
    if states and parameters:
        # A path goes with the parameters that it was drawn with.
        with seeded(seed):
            drawn, values = fit.predictor().paths(prepared, draws)
        if values and values[0]:
            parameters = {name: torch.stack([v[name] for v in values]) for name in values[0]}
        own = fit.preparation.scaler.inverse(drawn[:, :, rows].numpy().astype(np.float64))
        length = str(source.attrs.get("unit", ""))
        attrs |= {"units": f"positions {length}, velocities {length}/s".replace("  ", " ")}
        data["states"] = (dims, own[None], attrs)
    elif states:
        latent = fit.posterior(tracks, draws, seed)["states"]
        order = ("draw", "trial", "time", "individual", "latent")
        data["states"] = (dims, latent.transpose(*order).to_numpy()[None, :, :, rows], attrs)
    group = xr.Dataset()
    if parameters and isinstance(fit.model, StateSpaceModel):
        group = _labelled(fit, {n: v.numpy() for n, v in parameters.items()}, source)
    if data:
        coords: dict[str, Any] = {
            "chain": [0],
            "draw": np.arange(draws),
            "time": ("time", source["time"].to_numpy()[rows], {"units": "s"}),
            "latent": np.arange(data["states"][1].shape[-1]),
        }
        coords |= {name: source[name].to_numpy() for name in ("trial", "individual")}
        group = group.merge(xr.Dataset(data, coords))
    return group, parameters


def _labelled(fit: Fit, values: Mapping[str, Array], source: xr.Dataset) -> xr.Dataset:
    """Return draws of parameters with the labels of the tracks."""
    if not isinstance(fit.model, StateSpaceModel):
        return xr.Dataset()
    return labelled_parameters(
        fit.model,
        values,
        [str(name) for name in source["individual"].values],
        [str(name) for name in source["space"].values],
        str(source.attrs.get("unit", "")),
    )


def _after_given(prepared: Prepared, given: int) -> Mask:
    """Return the frames after the first ones with anybody in them, ``(trial, time)``."""
    come = np.asarray(prepared.mask.any(-1)).cumsum(1) > 0
    after: Mask = come.cumsum(1) > given
    return after


def _constant(prepared: Prepared) -> xr.Dataset:
    """Return what a model is told and does not foresee: graph and presence, on the whole grid."""
    source = prepared.tracks
    frames = ("trial", "time", "individual")
    group = xr.Dataset(
        {
            "adjacency": (
                (*frames, "neighbor"),
                prepared.adjacency.numpy().astype(np.uint8),
                {"long_name": "individual sees neighbor", "units": "1"},
            ),
            "present": (
                frames,
                prepared.mask.numpy().astype(np.uint8),
                {"long_name": "individual was observed", "units": "1"},
            ),
        },
        {name: source[name].to_numpy() for name in (*frames, "neighbor")},
    )
    group["time"].attrs["units"] = "s"
    return group


def _statistics(fit: Fit, density: Array, scored: Mask) -> xr.Dataset:
    """Return the log-density of all that is scored at each draw, and the course of training."""
    total = np.where(scored, density, 0.0).sum((1, 2, 3))
    history = fit.history
    data: dict[str, Variable] = {
        "log_density": (
            ("chain", "draw"),
            total[None],
            {"long_name": "sum of the log-likelihoods of the draw", "units": "nat"},
        )
    }
    coords: dict[str, Any] = {"chain": [0], "draw": np.arange(len(density))}
    if "loss" in history:
        data["loss"] = (
            ("step",),
            history["loss"].to_numpy(dtype=np.float64),
            {"long_name": "training loss", "units": "nat"},
        )
        coords["step"] = (
            "step",
            history["epoch"].to_numpy(dtype=np.float64),
            {"long_name": "epoch of training", "units": "1"},
        )
    epochs = int(history["epoch"].max()) if len(history) else 0
    attrs = {"training_steps": epochs, "training_seed": fit.settings.seed}
    return xr.Dataset(data, coords, attrs)


def _predictions(fit: Fit, tracks: xr.Dataset, steps: int, draws: int, seed: int) -> xr.Dataset:
    """Return positions after the end."""
    ahead = fit.forecast(tracks, steps, draws, seed)
    position = ahead["position"].transpose("draw", "trial", "time", "individual", "space")
    values = position.astype(np.float64).expand_dims(chain=[0])
    values.attrs = {
        "long_name": "position after the last frame",
        "units": str(ahead.attrs.get("unit", "")),
    }
    group = values.to_dataset(name="position").drop_vars("history_end", errors="ignore")
    return group.assign_coords(history_end=ahead["history_end"])


def _prior(fit: Fit, prepared: Prepared, draws: int, seed: int) -> dict[str, xr.Dataset]:
    """Return parameters from the prior, and swarms with them."""
    model, source = fit.model, prepared.tracks
    if not isinstance(model, StateSpaceModel):
        return {}
    batch = prepared.batch()
    frames = min(PRIOR_FRAMES, batch.num_times)
    rows = slice(0, frames)
    everybody = torch.ones_like(batch.mask[:, rows])
    graph: Any = batch.adjacency
    short = type(batch).of(batch.observations[:, rows], everybody, graph[:, rows])
    with own_parameters(model):
        drawn = model.sample_prior(short, draws, graph=fit.preparation.rule, seed=seed)
    groups = {}
    if priors_of(model):
        values = {name: value.numpy() for name, value in drawn.parameters.items()}
        groups["prior"] = _labelled(fit, values, source)
    space = source.sizes["space"]
    scaler = fit.preparation.scaler
    scale, offset = np.array(scaler.scale[:space]), np.array(scaler.offset[:space])
    positions = drawn.observations[..., :space].numpy().astype(np.float64) * scale + offset
    # A swarm that ran away is told of by its absence: one number without bounds spoils a picture.
    wild = ~(np.abs(positions) <= MAX_COORDINATE)
    kept = ~wild.any((1, 2, 3, 4))
    positions[~kept] = np.nan
    attrs = {
        "long_name": "position in a swarm drawn from the prior",
        "units": str(source.attrs.get("unit", "")),
        "runaways": int((~kept).sum()),
    }
    coords: dict[str, Any] = {"chain": [0], "draw": np.arange(draws)}
    coords |= {name: source[name].to_numpy() for name in ("trial", "individual", "space")}
    coords["time"] = ("time", source["time"].to_numpy()[rows], {"units": "s"})
    dims: Sequence[str] = ("chain", "draw", "trial", "time", "individual", "space")
    groups["prior_predictive"] = xr.Dataset({"position": (dims, positions[None], attrs)}, coords)
    return groups
