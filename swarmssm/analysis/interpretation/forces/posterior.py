r"""The forces that a fitted model says act on each individual, and how surely.

The expected acceleration :math:`(E[v'] - v) / dt` is split into terms: ``cohesion``,
``separation`` and ``alignment``; ``self``, which is walls and speed regulation, and in the
velocity form of boids the :math:`-v / dt` by which the old velocity is forgotten; and ``other``,
which is what is left, such as limits of speed. They add up to it exactly.

A model without named terms is asked for its accelerations alone. These are projected, by least
squares over all frames of a draw, on the terms (3.16)-(3.18) of the thesis on the model's own graph
and on what an individual could do by itself; what these do not explain is ``other``.
"""

from typing import Any

import numpy as np
import torch
import xarray as xr

from swarmssm import forces as boids_terms
from swarmssm.analysis.interpretation.forces.frames import (
    OWN_COLUMNS,
    Frames,
    frames_of,
    labels_of,
    own_columns,
    seen_graph,
    unit_of,
)
from swarmssm.analysis.posterior.accelerations import (
    AccelerationModel,
    PosteriorPaths,
    acceleration_model,
    posterior_paths,
)
from swarmssm.analysis.posterior.intervals import QUANTILES, known_mean, quantiles
from swarmssm.inference import Fit
from swarmssm.models import StateSpaceModel
from swarmssm.models.transitions.protocols import PairKernels
from swarmssm.tracks import Array, spatial_attributes

__all__ = [
    "TERMS",
    "force_summary",
    "posterior_forces",
]

#: Into what every acceleration is split.
TERMS = ("cohesion", "separation", "alignment", "self", "other")
#: Those by which neighbours act, in any model.
NEIGHBOR_TERMS = ("cohesion", "separation", "alignment")
#: Order of the dimensions of a force, behind draws.
FORCE_DIMS = ("trial", "time", "individual", "space", "term")
#: Where the terms of a transition, or of a simulator, belong; any other is ``other``.
PLACES = {
    "cohesion": "cohesion",
    "attraction": "cohesion",
    "separation": "separation",
    "repulsion": "separation",
    "alignment": "alignment",
    "wall": "self",
    "speed_regulation": "self",
}
#: On what accelerations are projected, and in which unit the coefficients are.
COLUMNS = {
    "cohesion": ("cohesion", "1/s^2"),
    "separation": ("separation", "{}^2/s^2"),
    "alignment": ("alignment", "1/s"),
    **{name: ("self", unit) for name, unit in OWN_COLUMNS.items()},
}
#: Columns that are so nearly combinations of others count as such.
COLLINEAR = 1e-10


def posterior_forces(
    fit: Fit,
    tracks: xr.Dataset,
    draws: int = 20,
    seed: int | torch.Generator = 0,
    *,
    paths: PosteriorPaths | None = None,
) -> xr.Dataset:
    """Draw from the posterior what each force contributed to each individual's acceleration.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or others.
    draws
        Draws of paths, each with its own parameters.
    seed
        Seed or generator.
    paths
        Draws of ``posterior_paths`` for these tracks, if they are
        there already; ``draws`` and ``seed`` then mean nothing for paths.

    Returns
    -------
    Dataset with

    ``force (draw, trial, time, individual, space, term)``
        In length unit per second squared, single precision; NaN where an individual is absent. The
        terms, :data:`TERMS` and forces of the model that have other names, add up to the model's
        expected acceleration.
    ``position``, ``velocity (draw, trial, time, individual, space)``
        The states that they act on.
    ``explained (draw)``
        Share of the mean square of the acceleration that is not ``other``: 1 minus the ratio of the
        two mean squares.
    ``coefficient (draw, column)``
        Of a projection only: what :data:`COLUMNS` were multiplied with.

    ``attrs["source"]`` is ``"model"``, or ``"projection"`` where the model has no named terms.

    Raises
    ------
    InputError
        If ``draws`` is not positive, the tracks do not fit the model, or it has no law of motion.
    """
    motion = acceleration_model(fit)
    if paths is None:
        paths = posterior_paths(fit, tracks, draws, seed)
    draws = paths.draws
    trials, times, individuals = paths.present.shape
    frames = (trials * times, individuals, motion.space)
    terms = terms_of(motion)
    force = np.empty((draws, *frames, len(terms)), np.float32)
    explained = np.empty(draws)
    coefficients = np.full((draws, len(COLUMNS)), np.nan)
    with torch.no_grad():
        for draw in range(draws):
            if motion.terms:
                _name(motion, paths, draw, force[draw])
            else:
                coefficients[draw] = _project(fit, motion, paths, draw, force[draw])
            whole = np.square(force[draw].sum(-1, dtype=np.float64)).sum()
            left = np.square(force[draw, ..., -1].astype(np.float64)).sum()
            explained[draw] = 1.0 - left / whole if whole > 0 else np.nan
    absent = ~paths.present.flatten(0, 1).numpy()
    force[:, absent] = np.nan
    shape = (draws, *paths.present.shape, motion.space)
    states = paths.states.to(torch.float32).masked_fill(~paths.present.unsqueeze(-1), torch.nan)
    unit = unit_of(paths.tracks)
    rate = {"units": f"{unit}/s^2", "long_name": "contribution to the acceleration"}
    over = ("draw", *FORCE_DIMS[:-1])
    space = motion.space
    result = xr.Dataset(
        {
            "force": (("draw", *FORCE_DIMS), force.reshape(*shape, len(terms)), rate),
            "position": (
                over,
                states[..., :space].numpy(),
                {"units": unit, "long_name": "position"},
            ),
            "velocity": (
                over,
                states[..., space:].numpy(),
                {"units": f"{unit}/s", "long_name": "velocity"},
            ),
            "explained": (
                "draw",
                explained,
                {"units": "1", "long_name": "share of the acceleration that is not other"},
            ),
        },
        {
            "draw": np.arange(draws),
            "term": list(terms),
            **labels_of(paths.tracks, "trial", "time", "individual", "space"),
        },
        {
            "source": "model" if motion.terms else "projection",
            "model": fit.settings.model,
            **spatial_attributes(paths.tracks),
            "neighbor_terms": [*NEIGHBOR_TERMS, *_pair_forces(fit, terms)],
        },
    )
    if motion.terms:
        return result
    units = [text.format(unit) for _, text in COLUMNS.values()]
    return result.assign_coords(column=list(COLUMNS), column_units=("column", units)).assign(
        coefficient=(
            ("draw", "column"),
            coefficients,
            {"units": "see column_units", "long_name": "coefficient of the projection"},
        )
    )


def terms_of(motion: AccelerationModel) -> tuple[str, ...]:
    """Return into what the accelerations of a model are split.

    :data:`TERMS`, and before the last two the model's own forces that none of them covers.
    """
    own = [name for name in motion.terms if name not in PLACES and name not in TERMS]
    return (*TERMS[:-2], *own, *TERMS[-2:])


def _pair_forces(fit: Fit, terms: tuple[str, ...]) -> list[str]:
    """Return the model's own forces that are functions of the distance to a neighbour."""
    transition = fit.model.transition if isinstance(fit.model, StateSpaceModel) else None
    kinds = transition.kernel_kinds if isinstance(transition, PairKernels) else {}
    return [name for name in terms if name in kinds and name not in TERMS]


def _name(motion: AccelerationModel, paths: PosteriorPaths, draw: int, out: Array) -> None:
    """Write the named terms of a draw ``(frame, individual, space, term)``."""
    terms = terms_of(motion)
    for frames in frames_of(paths, draw):
        given = (frames.states, frames.adjacency, frames.present, frames.values)
        whole = motion.acceleration(*given)
        named = whole.new_zeros(*whole.shape, len(terms))
        for name, term in zip(motion.terms, motion.forces(*given).unbind(-3), strict=True):
            named[..., terms.index(PLACES.get(name, name))] += term
        if motion.forgets_velocity:
            own = frames.velocities / motion.dt
            named[..., terms.index("self")] -= own * frames.present.unsqueeze(-1)
        named[..., -1] = whole - named.sum(-1)
        out[frames.rows] = named.numpy()


def _project(
    fit: Fit, motion: AccelerationModel, paths: PosteriorPaths, draw: int, out: Array
) -> Array:
    """Write the projected terms of a draw, and return the coefficients ``(column,)``."""
    size = len(COLUMNS)
    products, targets = torch.zeros(size, size, dtype=torch.float64), torch.zeros(size).double()
    for frames in frames_of(paths, draw):
        columns = _columns(fit, frames)
        whole = motion.acceleration(
            frames.states, frames.adjacency, frames.present, frames.values
        ).double()
        products += torch.einsum("fisk,fisl->kl", columns, columns)
        targets += torch.einsum("fisk,fis->k", columns, whole)
        out[frames.rows, ..., -1] = whole.numpy()
    coefficients = _solve(products, targets)
    for frames in frames_of(paths, draw):
        weighted = (_columns(fit, frames) * coefficients).numpy()
        part = out[frames.rows]
        part[..., :-1] = 0.0
        for index, (place, _) in enumerate(COLUMNS.values()):
            part[..., TERMS.index(place)] += weighted[..., index]
        part[..., -1] -= weighted.sum(-1)
    return coefficients.numpy()


def _columns(fit: Fit, frames: Frames) -> torch.Tensor:
    """Return :data:`COLUMNS` ``(frame, individual, space, column)``, 0 for who is absent."""
    graph = seen_graph(fit, frames)
    positions = frames.positions
    columns = [
        boids_terms.cohesion(positions, graph),
        # Nearer than the tracking noise, nobody knows how near.
        boids_terms.separation(positions, graph, softening=fit.scales.noise),
        boids_terms.alignment(frames.velocities, graph),
        *own_columns(fit, frames),
    ]
    stacked = torch.stack(columns, -1)
    return stacked * frames.present[..., None, None]


def _solve(products: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Solve normal equations; of columns that are combinations of others, the shortest solution."""
    scale = products.diagonal().sqrt()
    scale = torch.where(scale > 0, scale, 1.0)
    inverse = torch.linalg.pinv(products / scale / scale.unsqueeze(-1), COLLINEAR, hermitian=True)
    solution: torch.Tensor = inverse @ (targets / scale) / scale
    return solution


def force_summary(forces: xr.Dataset) -> xr.Dataset:
    """Summarise forces by magnitude and angle, with 90 % intervals over the draws.

    Parameters
    ----------
    forces
        What :func:`posterior_forces` returned.

    Returns
    -------
    Dataset with a dimension ``quantile`` of 0.05, 0.5, 0.95:

    ``magnitude (quantile, trial, time, individual, term)``
        Length of the force.
    ``mean_force (trial, time, individual, space, term)``
        Posterior mean.
    ``group_magnitude (quantile, trial, time, term)``
        Length, mean over the individuals.
    ``individual_magnitude (quantile, individual, term)``, ``mean_magnitude (quantile, term)``
        Length, mean over all frames, and over all frames and individuals.
    ``share (quantile, term)``, ``neighbor_share (quantile)``
        Mean length of a term over the sum of the mean lengths of all; and of those together by
        which neighbours act, ``attrs["neighbor_terms"]`` of the forces.
    ``angle``, ``angle_to_heading (quantile, trial, time, individual, term)``
        In two dimensions: direction in the world, from the x axis towards the y axis, and
        from the heading, positive to where y is from x; radians, the middle from -pi to pi and the
        ends of the interval about it. In three dimensions only ``angle_to_heading``, from 0 to pi.
    """
    force = forces["force"].transpose("draw", *FORCE_DIMS).to_numpy()
    velocity = forces["velocity"].transpose("draw", *FORCE_DIMS[:-1]).to_numpy()
    length = np.linalg.norm(force, axis=-2)
    over_group = known_mean(length, (3,))
    over_time = known_mean(length, (1, 2))
    overall = known_mean(length, (1, 2, 3))
    total = overall.sum(-1, keepdims=True)
    share = np.divide(overall, total, out=np.full_like(overall, np.nan), where=total > 0)
    unit = forces["force"].attrs["units"]
    at = ("quantile", "trial", "time", "individual", "term")

    def size(what: str) -> dict[str, str]:
        return {"units": unit, "long_name": what}

    data = {
        "magnitude": (at, quantiles(length), size("magnitude of the force")),
        "mean_force": (FORCE_DIMS, known_mean(force, (0,)), size("posterior mean of the force")),
        "group_magnitude": (
            ("quantile", "trial", "time", "term"),
            quantiles(over_group),
            size("magnitude, mean over individuals"),
        ),
        "individual_magnitude": (
            ("quantile", "individual", "term"),
            quantiles(over_time),
            size("magnitude, mean over time"),
        ),
        "mean_magnitude": (("quantile", "term"), quantiles(overall), size("mean magnitude")),
        "share": (
            ("quantile", "term"),
            quantiles(share),
            {"units": "1", "long_name": "share of the sum of mean magnitudes"},
        ),
        "neighbor_share": (
            "quantile",
            quantiles(share[:, _is_social(forces)].sum(-1)),
            {"units": "1", "long_name": "share of the forces of neighbours"},
        ),
    }
    for name, (angle, what) in _angles(force, velocity).items():
        data[name] = (at, angle, {"units": "rad", "long_name": what})
    coords: dict[str, Any] = {"quantile": list(QUANTILES)}
    coords |= {name: forces[name].to_numpy() for name in FORCE_DIMS}
    return xr.Dataset(data, coords, dict(forces.attrs)).assign(explained=forces["explained"])


def _is_social(forces: xr.Dataset) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Return by which terms neighbours act."""
    names = forces.attrs.get("neighbor_terms", NEIGHBOR_TERMS)
    return np.isin(forces["term"].to_numpy().astype(str), names)


def _angles(force: Array, velocity: Array) -> dict[str, tuple[Array, str]]:
    """Return quantiles of angles in the world and to the heading, with what they are."""
    if force.shape[-2] == 3:
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        product = np.linalg.norm(force, axis=-2) * speed
        along = (force * velocity[..., None]).sum(-2)
        cosine = np.divide(along, product, out=np.full_like(along, np.nan), where=product > 0)
        between = np.arccos(cosine.clip(-1.0, 1.0))
        return {"angle_to_heading": (quantiles(between), "angle between force and heading")}
    angle = np.arctan2(force[..., 1, :], force[..., 0, :])
    angle[(force == 0).all(-2)] = np.nan
    heading = np.arctan2(velocity[..., 1], velocity[..., 0])
    heading[(velocity == 0).all(-1)] = np.nan
    return {
        "angle": (_circular_quantiles(angle), "direction of the force"),
        "angle_to_heading": (
            _circular_quantiles(angle - heading[..., None]),
            "direction of the force from the heading",
        ),
    }


def _circular_quantiles(angle: Array) -> Array:
    """Return quantiles over the first dimension, of deviations from the mean direction."""
    middle = np.arctan2(known_mean(np.sin(angle), (0,)), known_mean(np.cos(angle), (0,)))
    found = middle + quantiles(_wrapped(angle - middle))
    return np.asarray(found + (_wrapped(found[1]) - found[1]))


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
