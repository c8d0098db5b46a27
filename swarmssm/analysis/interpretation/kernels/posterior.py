r"""What a neighbour does at each distance: kernels of attraction, repulsion and alignment.

A model whose transition is made of pairs says it itself. Of any other the expected acceleration is
projected on

.. math::
    a_i = \frac{1}{|\mathcal{N}_i|} \sum_{j \in \mathcal{N}_i}
        \bigl[ f(r_{ij})\, u_{ij} + g(r_{ij})\, (v_j - v_i) \bigr] + \text{self}_i

where u is the unit vector to the neighbour, f and g are cubic splines of the distance, and the
self part is a linear function of one's velocity, heading and offset from the middle.
"""

from typing import Any

import numpy as np
import torch
import xarray as xr

from swarmssm.analysis.interpretation.forces.frames import unit_of
from swarmssm.analysis.interpretation.kernels.pair_distances import pair_distances
from swarmssm.analysis.interpretation.kernels.radial import project
from swarmssm.analysis.posterior.accelerations import (
    PosteriorPaths,
    acceleration_model,
    posterior_paths,
)
from swarmssm.analysis.posterior.intervals import QUANTILES, quantiles
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.inference.guides import PathGuide
from swarmssm.inference.prediction import seeded
from swarmssm.models import StateSpaceModel
from swarmssm.models.transitions import (
    AngularModulation,
    NamedForces,
    PairKernel,
    PairKernels,
    WeightedPairs,
)
from swarmssm.tracks import Array

__all__ = ["interaction_kernels"]

#: Draws of paths; each serves several draws of the parameters.
PATHS = 20
#: Distances that a kernel is given at, unless others are asked for.
DISTANCES = 100
ANGLES = 121
#: Within these quantiles of the distances of pairs a kernel is believed.
BELIEVED = (0.01, 0.98)
#: And where there are this share of as many neighbours as where most are.
BELIEVED_FROM = 0.02
#: Below this share of its largest value a kernel counts as ended.
ENDED = 0.1


def interaction_kernels(
    fit: Fit,
    tracks: xr.Dataset,
    draws: int = 200,
    distances: Any = None,
    seed: int | torch.Generator = 0,
    *,
    projected: bool = False,
    paths: PosteriorPaths | None = None,
) -> xr.Dataset:
    r"""Draw from the posterior what a neighbour does at each distance.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or others; they say at which distances neighbours are, and
        how many.
    draws
        Draws of the kernels.
    distances
        Where the kernels are wanted, positive and increasing; absent, 100 between
        the 0.1st and the 98th percentile of the distances of neighbours.
    seed
        Seed or generator.
    projected
        Project also a model that has kernels of its own.
    paths
        As in :func:`swarmssm.analysis.posterior_forces`.

    Returns
    -------
    Dataset, in the tracks' own units and positive towards the neighbour. Each kernel comes as
    ``(quantile, distance)`` and, with ``_draws`` behind its name, as ``(draw, distance)``:

    ``attraction``
        f, of which an individual feels the mean over its neighbours, or the sum where the model
        says so (``attrs["attraction_over_neighbors"]``, as for the other two).
    ``repulsion``
        Of which it feels the sum; only where the model has one.
    ``alignment``
        g, the factor of ``v_j - v_i``, of which it feels the mean.
    ``net``
        Attraction plus the mean number of neighbours times the repulsion (what is summed counts so
        many times): the force if all neighbours were in one place at that distance.
    ``density (distance)``
        Of the distances of neighbours; its integral is 1.
    ``modulation (quantile, angle)``
        Factor by the angle between the heading and the neighbour; only where the model has it.
    ``neighbors (quantile)``, ``neighbors_spread (quantile)``
        Mean number of neighbours with its posterior interval; and its quantiles over frames and
        individuals.
    ``preferred_distance (quantile)``
        Where net goes from repulsion to attraction, in those draws in which it does, which are the
        share ``has_preferred_distance``.
    ``interaction_range``, ``alignment_range (quantile)``
        Beyond which the size of net, and of g, stays below a tenth of its largest value. Both are
        looked for between the 1st and the 98th percentile of neighbours' distances, where there are
        at least a fiftieth as many as where most are; where it does not end there, the last of
        these stands for it, and ``interaction_range_open``,
        ``alignment_range_open`` is the share of such draws.

    With weights of individuals (influence, responsiveness), kernels are those of the average pair.
    ``attrs["source"]`` is ``"model"`` or ``"projection"``. Of a projection ``projection_r2
    (draw)`` is the R^2 of the whole, for blocks of time that were left out of it, and ``neighbor_r2
    (draw)`` what the kernels add to the R^2 of the self part alone: 0 where neighbours say nothing.
    These and the bands hold both the spread of paths and that over resampled blocks of time.

    Raises
    ------
    InputError
        If ``draws`` is not positive, distances are not positive and increasing, there are no
        neighbours, or the model has no law of motion.
    """
    if draws < 1:
        raise InputError(f"draws: there must be at least 1, not {draws}.")
    motion = acceleration_model(fit)
    if paths is None:
        paths = posterior_paths(fit, tracks, min(draws, PATHS), seed)
    pairs = pair_distances(fit, paths)
    if distances is None:
        last = pairs.quantile(BELIEVED[1])
        distances = np.linspace(max(pairs.quantile(0.001), last / DISTANCES), last, DISTANCES)
    distances = _checked(distances)
    model = fit.model
    source = model.transition if isinstance(model, StateSpaceModel) and not projected else None
    kinds: dict[str, PairKernel] = {}
    extra: dict[str, Any] = {}
    coords: dict[str, Any] = {}
    if isinstance(source, PairKernels):
        kinds = dict(source.kernel_kinds)
        drawn, angular = _own_kernels(fit, source, paths, distances, draws, seed)
        if angular is not None:
            modulation = {"units": "1", "long_name": "factor by the angle to the neighbour"}
            extra["modulation"] = (("quantile", "angle"), quantiles(angular), modulation)
            coords["angle"] = ("angle", np.linspace(-np.pi, np.pi, ANGLES), {"units": "rad"})
    else:
        knots = (pairs.quantile(0.001), pairs.quantile(0.995))
        found = project(fit, motion, paths, knots, distances, draws, seed)
        drawn = found.kernels
        whole = {"units": "1", "long_name": "R^2 of the projection on left-out blocks"}
        added = {"units": "1", "long_name": "R^2 that neighbours add on left-out blocks"}
        extra["projection_r2"] = ("draw", found.projection_r2, whole)
        extra["neighbor_r2"] = ("draw", found.neighbor_r2, added)
        kinds = {"attraction": PairKernel("offset"), "alignment": PairKernel("velocity")}
    number = pairs.neighbors[np.arange(draws) % paths.draws][:, None]
    drawn["net"] = np.zeros((draws, len(distances)))
    for name, kind in kinds.items():
        if kind.along == "offset":
            drawn["net"] += drawn[name] * (number if kind.over == "sum" else 1.0)
    unit = unit_of(paths.tracks)
    rate = {
        name: f"{unit}/s^2" if kind.along == "offset" else "1/s" for name, kind in kinds.items()
    } | {"net": f"{unit}/s^2"}
    titles = {name: f"{name}, {kind.over} over neighbours" for name, kind in kinds.items()}
    titles["net"] = "net force of neighbours at this distance"
    data: dict[str, Any] = dict(extra)
    for name, values in drawn.items():
        attrs = {"units": rate[name], "long_name": titles[name]}
        data[name] = (("quantile", "distance"), quantiles(values), attrs)
        data[f"{name}_draws"] = (("draw", "distance"), values, attrs)
    data["density"] = (
        "distance",
        pairs.density(distances),
        {"units": f"1/{unit}", "long_name": "density of the distances of neighbours"},
    )
    data |= _neighbors(pairs.neighbors, pairs.neighbors_spread)
    low, high = pairs.quantile(BELIEVED[0]), pairs.quantile(BELIEVED[1])
    density = data["density"][1]
    believed = (distances >= low) & (distances <= high) & (density > BELIEVED_FROM * density.max())
    data |= _ranges(drawn, distances, believed, unit)
    coords |= {
        "quantile": list(QUANTILES),
        "draw": np.arange(draws),
        "distance": ("distance", distances, {"units": unit, "long_name": "distance"}),
    }
    about: dict[str, Any] = {
        "source": "model" if isinstance(source, PairKernels) else "projection",
        "model": fit.settings.model,
        "unit": unit,
        **{f"{name}_over_neighbors": kind.over for name, kind in kinds.items()},
        **{f"{name}_along": kind.along for name, kind in kinds.items()},
        "believed_from": low,
        "believed_to": high,
    }
    return xr.Dataset(data, coords, about)


def _checked(distances: Any) -> Array:
    """Return distances, or raise."""
    values = np.asarray(distances, np.float64)
    good = values.ndim == 1 and values.size > 1 and np.isfinite(values).all()
    if not good or values[0] <= 0 or (np.diff(values) <= 0).any():
        raise InputError("distances: they must be at least two positive and increasing numbers.")
    return values


def _own_kernels(
    fit: Fit,
    transition: PairKernels,
    paths: PosteriorPaths,
    distances: Array,
    draws: int,
    seed: int | torch.Generator,
) -> tuple[dict[str, Array], Array | None]:
    """Return draws ``(draw, distance)`` of the transition's own kernels, and of modulation."""
    scaler = fit.preparation.scaler
    space = len(scaler.scale) // 2
    length, speed = scaler.scale[0], scaler.scale[space]
    expected = [length] * space + [speed] * space
    if not np.allclose(scaler.scale, expected):
        raise InputError(
            "scaler: it stretches the axes differently, so that no kernel depends on distance "
            "alone. Fit with the scaler isotropic or none."
        )
    kinds = transition.kernel_kinds
    is_velocity = isinstance(transition, NamedForces) and transition.form == "velocity"
    per = 1.0 / fit.scales.dt if is_velocity else 1.0
    tensors = (*fit.model.parameters(), *fit.model.buffers())
    dtype = next((t.dtype for t in tensors if t.is_floating_point()), torch.get_default_dtype())
    at = torch.as_tensor(distances / length, dtype=dtype)
    angle = torch.linspace(-torch.pi, torch.pi, ANGLES, dtype=dtype)
    kernels: dict[str, list[Array]] = {}
    angular = []
    with torch.no_grad():
        for values in _parameters(fit, paths, draws, seed):
            with fit.with_parameters(values):
                weight = _average_weight(transition, paths.states.shape[-2])
                for name, value in transition.kernels(at).items():
                    factor = per * speed if kinds[name].along == "offset" else per
                    mean = value.double().reshape(-1, len(at)).mean(0)
                    kernels.setdefault(name, []).append(factor * weight * mean.numpy())
                if isinstance(transition, AngularModulation):
                    angular.append(transition.angular(angle).double().expand(ANGLES).numpy())
    stacked = {name: np.stack(values) for name, values in kernels.items()}
    return stacked, np.stack(angular) if angular else None


def _parameters(
    fit: Fit, paths: PosteriorPaths, draws: int, seed: int | torch.Generator
) -> list[Any]:
    """Return draws of the parameters that have a prior."""
    if not isinstance(fit.guide, PathGuide):
        return [paths.parameters[draw % paths.draws] for draw in range(draws)]
    with seeded(seed):
        drawn = fit.guide.parameters_guide.draw(draws)
    return [{name: value[draw] for name, value in drawn.items()} for draw in range(draws)]


def _average_weight(transition: PairKernels, individuals: int) -> float:
    """Return the mean over pairs of the weights of receiver and sender."""
    if individuals < 2 or not isinstance(transition, WeightedPairs):
        return 1.0
    influence, responsiveness = transition.pair_weights()
    pairs = torch.ones(individuals, individuals, dtype=torch.float64)
    if influence is not None:
        pairs = pairs * influence.double()
    if responsiveness is not None:
        pairs = pairs * responsiveness.double().unsqueeze(-1)
    off = ~torch.eye(individuals, dtype=torch.bool)
    return float(pairs[off].mean())


def _neighbors(means: Array, spread: Array) -> dict[str, Any]:
    """Label numbers of neighbours."""
    return {
        "neighbors": (
            "quantile",
            quantiles(means),
            {"units": "1", "long_name": "mean number of neighbours"},
        ),
        "neighbors_spread": (
            "quantile",
            spread,
            {"units": "1", "long_name": "number of neighbours over individuals and frames"},
        ),
    }


def _ranges(drawn: dict[str, Array], distances: Array, inside: Any, unit: str) -> dict[str, Any]:
    """Return where kernels end and where net changes its sign."""
    if inside.sum() < 2:
        inside = np.ones_like(inside)
    at = distances[inside]
    data: dict[str, Any] = {}
    for name, kernel in (("interaction_range", "net"), ("alignment_range", "alignment")):
        if kernel not in drawn:
            continue
        size = np.abs(drawn[kernel][:, inside])
        strong = size >= ENDED * size.max(1, keepdims=True)
        last = strong.shape[1] - 1 - strong[:, ::-1].argmax(1)
        is_open = last == strong.shape[1] - 1
        attrs = {"units": unit, "long_name": f"range of {kernel}"}
        data[name] = ("quantile", quantiles(at[last]), attrs)
        data[f"{name}_open"] = (
            (),
            float(is_open.mean()),
            {"units": "1", "long_name": "share of draws in which it does not end within the data"},
        )
    # Across a stretch without data nobody knows where the sign changes.
    joined = np.diff(np.flatnonzero(inside)) == 1
    preferred = np.array([_crossing(at, net, joined) for net in drawn["net"][:, inside]])
    data["preferred_distance"] = (
        "quantile",
        quantiles(preferred),
        {"units": unit, "long_name": "distance at which repulsion becomes attraction"},
    )
    data["has_preferred_distance"] = (
        (),
        float(np.isfinite(preferred).mean()),
        {"units": "1", "long_name": "share of draws with a preferred distance"},
    )
    return data


def _crossing(distances: Array, values: Array, joined: Any) -> float:
    """Return where values first go from below 0 to above, NaN if they do not."""
    rising = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0) & joined)
    if not rising.size:
        return float("nan")
    first = rising[0]
    share = -values[first] / (values[first + 1] - values[first])
    return float(distances[first] + share * (distances[first + 1] - distances[first]))
