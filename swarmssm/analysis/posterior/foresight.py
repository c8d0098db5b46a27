"""Each frame of a recording as a fit foresees it from the frames before, at draws of its posterior.

What :mod:`swarmssm.analysis.posterior` hands on is made of this: log-likelihoods with the latent
states summed out, and replicates.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyro
import torch
import xarray as xr
from torch import Tensor

from swarmssm.analysis.posterior.draw_filter import Foreseen, filter_draws
from swarmssm.analysis.posterior.inferred_graph import has_inferred_edges
from swarmssm.analysis.posterior.subject import subject_of
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.data import Prepared
from swarmssm.inference.guides import LinearizedGuide, OneStepGuide
from swarmssm.inference.prediction import seeded
from swarmssm.metrics.log_score import mixture_log_score
from swarmssm.models import OneStepModel, StateSpaceModel
from swarmssm.models.parameters import priors_of
from swarmssm.models.pyro_modules import own_parameters
from swarmssm.tracks import Array

__all__ = ["LATENTS", "OneStepPredictive", "has_parameter_draws", "predict_one_step"]

#: Sampled latent states over which a model is averaged that no filter sums out.
LATENTS = 50
#: Elements of the largest tensor of one chunk of frames.
CHUNK = 20_000_000

FILTERED = (
    "extended Kalman filter at each draw of the parameters: the latent states are summed out, "
    "the model being linearised at the filtered mean (exact if it is linear and Gaussian)"
)
EXACT = (
    "states are observed exactly, nothing is latent: each step from the frame before, at each draw "
    "of the parameters, as a {law} with the mean and variance that the model gives it"
)
SAMPLED = (
    "mixture over {count} latent states sampled from the guide, which looks at the frames before "
    "alone; {parameters}"
)
POINTS = "the weights are points, so that all draws have the same value"
TOGETHER = "parameters are drawn with them, so that all draws have the same value"


@dataclass(frozen=True)
class OneStepPredictive:
    """Positions as foreseen from the frames before, in the tracks' own unit.

    Attributes
    ----------
    density
        ``(draw, trial, time, individual)``: log-density of each observed position, in nats; NaN
        where none was observed or foreseen.
    joint
        ``(draw, trial, time)``: of all of a frame together; 0 where none is.
    replicates
        ``(draw * replicates, trial, time, individual, space)``; NaN likewise.
    parameters
        ``(draw, ...)`` of each parameter with a prior, by full name; none if the draws are one.
    how
        How latent states were dealt with, in words.
    prepared
        The tracks as the model saw them.
    """

    density: Array
    joint: Array
    replicates: Array
    parameters: dict[str, Tensor]
    how: str
    prepared: Prepared


def has_parameter_draws(fit: Fit) -> bool:
    """Return whether each draw of the posterior has parameters of its own."""
    return bool(_drawn_by(fit)) and _is_filtered(fit)


def predict_one_step(
    fit: Fit,
    tracks: xr.Dataset,
    draws: int,
    seed: int,
    *,
    replicates: bool = False,
    parameters: Mapping[str, Tensor] | None = None,
) -> OneStepPredictive:
    """Foresee each frame of the tracks, the first ones from the law of first states.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Any tracks of as many spatial dimensions. Velocities that were smoothed over the whole
        recording are smoothed anew from the past alone.
    draws
        Draws of the parameters, and of the replicates.
    seed
        Seed of all of them.
    replicates
        Whether they are wanted.
    parameters
        ``(draw, ...)`` in place of fresh ones.

    Raises
    ------
    InputError
        If ``draws`` is not positive, or the tracks do not fit the model.
    """
    if draws < 1:
        raise InputError(f"draws: it must be at least 1, and it is {draws}.")
    prepared = _prepare(fit, tracks)
    if parameters is None:
        parameters = draw_parameters(fit, draws, seed)
    own = len(next(iter(parameters.values()))) if parameters else 1
    wanted = 0 if not replicates else (1 if own == draws else draws)
    with own_parameters(fit.model, fit.guide), seeded(seed):
        if _is_filtered(fit):
            how = FILTERED
            foreseen = filter_draws(fit.model, prepared, parameters, own, wanted)
        elif isinstance(fit.model, OneStepModel):
            how = SAMPLED.format(count=LATENTS, parameters=POINTS)
            foreseen = _of_one_step(fit, prepared, wanted)
        elif isinstance(fit.model, StateSpaceModel):
            how, foreseen = _of_kernels(fit, prepared, parameters, own, wanted)
        else:
            raise InputError(
                f"model: {fit.settings.model} is neither a StateSpaceModel nor a OneStepModel, so "
                "that nothing is known of what it foresees."
            )
    scaler, space = fit.preparation.scaler, prepared.tracks.sizes["space"]
    scale, offset = np.array(scaler.scale[:space]), np.array(scaler.offset[:space])
    density = foreseen.density.numpy().astype(np.float64) - np.log(scale).sum()
    joint = foreseen.joint.numpy().astype(np.float64)
    joint = joint - np.log(scale).sum() * np.isfinite(density).sum(-1)
    drawn = foreseen.replicates.numpy().astype(np.float64) * scale + offset
    return OneStepPredictive(density, joint, drawn, dict(parameters), how, prepared)


def draw_parameters(fit: Fit, draws: int, seed: int) -> dict[str, Tensor]:
    """Return draws ``(draw, ...)`` of the parameters with a prior, if each may have its own."""
    if not _drawn_by(fit):
        return {}
    drawn = fit.parameters(draws, seed)
    return {str(name): torch.from_numpy(drawn[name].to_numpy()) for name in drawn.data_vars}


def _drawn_by(fit: Fit) -> bool:
    """Return whether there are parameters with a prior, drawn apart from latent states."""
    model = fit.model
    if not isinstance(model, StateSpaceModel) or not priors_of(model):
        return False
    if has_inferred_edges(model):
        # Draws of edges come with the parameters under which they were drawn.
        return False
    return getattr(fit.guide, "parameters_guide", None) is not None and (
        model.emission.is_exact or _is_filtered(fit)
    )


def _is_filtered(fit: Fit) -> bool:
    """Return whether a Kalman filter sums out the latent states."""
    return (
        isinstance(fit.model, StateSpaceModel)
        and not fit.model.emission.is_exact
        and isinstance(fit.guide, LinearizedGuide)
        and not has_inferred_edges(fit.model)
    )


def _prepare(fit: Fit, tracks: xr.Dataset) -> Prepared:
    """Return the tracks as the model sees them, no frame knowing of a later one."""
    if fit.preparation.velocity == "kalman" and fit.preparation.observes != "positions":
        return subject_of(fit, tracks, "all").inputs
    return fit.prepare(tracks)


def _of_kernels(
    fit: Fit, prepared: Prepared, parameters: Mapping[str, Tensor], draws: int, replicates: int
) -> tuple[str, Foreseen]:
    """Average over sampled beginnings what the transition expects next."""
    model: Any = fit.model
    exact = model.emission.is_exact and not has_inferred_edges(model)
    predictor = fit.predictor()
    trials, times, individuals = prepared.mask.shape
    count = draws if exact else LATENTS
    at = torch.cartesian_prod(torch.arange(trials), torch.arange(times - 1)).reshape(-1, 2)
    size = max(1, CHUNK // (count * individuals * max(individuals, 16) * (1 if exact else 20)))
    locations, variances, degrees = [], [], math.inf
    for chosen in torch.split(at, size):
        if exact:
            start = predictor.begin(prepared, chosen[:, 0], chosen[:, 1], 0)
            expand = (count,)
            start = replace(
                start,
                states=start.states.expand(*expand, *start.states.shape),
                adjacency=start.adjacency.expand(*expand, *start.adjacency.shape),
                present=start.present.expand(*expand, *start.present.shape),
                unscaled=start.unscaled.expand(*expand, *start.unscaled.shape),
                parameters=tuple(
                    {name: value[draw] for name, value in parameters.items()}
                    for draw in range(count)
                ),
            )
        else:
            start = predictor.begin(prepared, chosen[:, 0], chosen[:, 1], count)
        kernels = predictor.kernels(start, 1)
        if kernels is None:
            raise InputError(f"model: {fit.settings.model} has no distribution of one step.")
        locations.append(kernels.location[:, :, 0])
        variances.append(kernels.variance[:, :, 0])
        degrees = min(degrees, kernels.degrees)
    location, variance = (
        _after_first(torch.unflatten(torch.cat(part, 1), 1, (trials, times - 1)))
        for part in (locations, variances)
    )
    if exact:
        law = "normal" if math.isinf(degrees) else f"Student's t of {degrees:.3g} degrees"
        how = EXACT.format(law=law)
        if not parameters:
            how += "; " + POINTS
        return how, _each_draw(prepared, location, variance, degrees, replicates)
    named = TOGETHER if priors_of(model) else POINTS
    how = SAMPLED.format(count=count, parameters=named)
    return how, _mixture(prepared, location, variance, degrees, replicates)


def _of_one_step(fit: Fit, prepared: Prepared, replicates: int) -> Foreseen:
    """Average over sampled codes of each frame what is decoded of the next."""
    model, guide = fit.model, fit.guide
    if not isinstance(model, OneStepModel) or not isinstance(guide, OneStepGuide):
        raise InputError(
            f"guide: {fit.settings.guide} does not encode frames; a OneStepGuide is needed."
        )
    space = prepared.tracks.sizes["space"]
    locations, variances = [], []
    with torch.no_grad(), pyro.validation_enabled(False):
        for time in range(prepared.mask.shape[1] - 1):
            graph = prepared.adjacency[:, time].to(torch.float32)
            code = guide.encode(prepared.observations[:, time], graph)
            following = model.decode(code.sample((LATENTS,))).states
            locations.append(following.mean[..., :space])
            variances.append(following.variance.expand(following.mean.shape)[..., :space])
    gone = ~prepared.mask[:, :-1].unsqueeze(-1)
    location = torch.stack(locations, 2).masked_fill(gone, torch.nan)
    variance = torch.stack(variances, 2)
    return _mixture(prepared, _after_first(location), _after_first(variance), math.inf, replicates)


def _after_first(values: Tensor) -> Tensor:
    """Give predictions ``(draw, trial, time - 1, ...)`` a first frame, of which nothing is said."""
    return torch.cat([torch.full_like(values[:, :, :1], torch.nan), values], 2)


def _mixture(
    prepared: Prepared, location: Tensor, variance: Tensor, degrees: float, replicates: int
) -> Foreseen:
    """Score a mixture, one draw in all, and draw from it."""
    truth = _truth(prepared)
    space = truth.shape[-1]
    each = mixture_log_score(
        truth.numpy().astype(np.float64),
        location.numpy().astype(np.float64),
        variance.numpy().astype(np.float64),
        degrees,
    )
    density = torch.from_numpy(each * space).unsqueeze(0)
    joint = density.nan_to_num(nan=0.0, neginf=-math.inf).sum(-1)
    component = torch.randint(len(location), (replicates,))
    drawn = location[component] + _noise(location[component], variance[component], degrees)
    return Foreseen(density, joint, drawn.masked_fill(truth.isnan(), torch.nan))


def _each_draw(
    prepared: Prepared, location: Tensor, variance: Tensor, degrees: float, replicates: int
) -> Foreseen:
    """Score each draw for itself."""
    truth = _truth(prepared)
    location, variance = location.double(), variance.double()
    if math.isinf(degrees):
        law: Any = torch.distributions.Normal(location, variance.sqrt(), validate_args=False)
        density = law.log_prob(truth.double()).sum(-1)
    else:
        space = truth.shape[-1]
        scale = variance * (degrees - 2.0) / degrees
        squared = ((truth - location).square() / scale).sum(-1)
        half = 0.5 * (degrees + space)
        constant = math.lgamma(half) - math.lgamma(0.5 * degrees)
        constant -= 0.5 * space * math.log(degrees * math.pi)
        density = constant - 0.5 * scale.log().sum(-1) - half * torch.log1p(squared / degrees)
    joint = density.nan_to_num(nan=0.0, neginf=-math.inf).sum(-1)
    shape = (len(location), replicates, *location.shape[1:])
    mean = location.unsqueeze(1).expand(shape).flatten(0, 1)
    spread = variance.unsqueeze(1).expand(shape).flatten(0, 1)
    drawn = mean + _noise(mean, spread, degrees)
    return Foreseen(density, joint, drawn.masked_fill(truth.isnan(), torch.nan))


def _noise(location: Tensor, variance: Tensor, degrees: float) -> Tensor:
    """Draw what comes to a location, of given variance, normal or Student's t of the vector."""
    noise = torch.randn(location.shape, dtype=location.dtype) * variance.sqrt()
    if math.isinf(degrees):
        return noise
    half = torch.full(location.shape[:-1], 0.5 * degrees, dtype=location.dtype)
    mixing = torch._standard_gamma(half) / half
    return noise * math.sqrt((degrees - 2.0) / degrees) * mixing.rsqrt().unsqueeze(-1)


def _truth(prepared: Prepared) -> Tensor:
    """Return observed positions, NaN where there are none, scaled."""
    space = prepared.tracks.sizes["space"]
    return prepared.observations[..., :space].masked_fill(~prepared.mask.unsqueeze(-1), torch.nan)
