r"""The forces that a fitted model says act on each individual, and how surely.

The expected acceleration :math:`(E[v'] - v) / dt` is split into terms: ``cohesion``,
``separation`` and ``alignment``; ``self``, which is walls and speed regulation, and in the
velocity form of boids the :math:`-v / dt` by which the old velocity is forgotten; and ``other``,
which is what is left, such as limits of speed. They add up to it exactly.

A model without named terms is asked for its accelerations alone. These are projected, by least
squares over all frames of a draw, on the terms (3.16)-(3.18) of the thesis on the model's own graph
and on what an individual could do by itself; what these do not explain is ``other``.
"""

from typing import NamedTuple

import numpy as np
import torch
import xarray as xr

from swarmssm import forces as boids_terms
from swarmssm.analysis.frames import (
    QUANTILES,
    Frames,
    frames_of,
    labels_of,
    seen_graph,
    unit_of,
)
from swarmssm.analysis.motion import Motion, PosteriorPaths, motion_of, posterior_paths
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.simulate import law_of
from swarmssm.tracks import Array, states_of, validate_tracks, with_trials

__all__ = [
    "TERMS",
    "force_agreement",
    "force_summary",
    "posterior_forces",
    "sentence",
    "true_forces",
]

#: Into what every acceleration is split.
TERMS = ("cohesion", "separation", "alignment", "self", "other")
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
    "velocity": ("self", "1/s"),
    "heading": ("self", "{}/s^2"),
    "offset": ("self", "1/s^2"),
    "wall": ("self", "1/s^2"),
}
#: The wall of the projection stands at this share of half the extent of the training tracks.
WALL_AT = 0.85
#: Columns that are so nearly combinations of others count as such.
COLLINEAR = 1e-10

FORCE_DIMS = ("trial", "time", "individual", "space", "term")


def posterior_forces(
    fit: Fit, tracks: xr.Dataset, draws: int = 20, seed: int | torch.Generator = 0
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

    Returns
    -------
    Dataset with

    ``force (draw, trial, time, individual, space, term)``
        In length unit per second squared, single precision; NaN where an individual is absent. The
        terms, :data:`TERMS`, add up to the model's expected acceleration.
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
    motion = motion_of(fit)
    paths = posterior_paths(fit, tracks, draws, seed)
    trials, times, individuals = paths.present.shape
    frames = (trials * times, individuals, motion.space)
    force = np.empty((draws, *frames, len(TERMS)), np.float32)
    explained = np.empty(draws)
    coefficients = np.full((draws, len(COLUMNS)), np.nan)
    with torch.no_grad():
        for draw in range(draws):
            if motion.terms:
                _name(fit, motion, paths, draw, force[draw])
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
            "force": (("draw", *FORCE_DIMS), force.reshape(*shape, len(TERMS)), rate),
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
            "term": list(TERMS),
            **labels_of(paths.tracks, "trial", "time", "individual", "space"),
        },
        {
            "source": "model" if motion.terms else "projection",
            "model": fit.settings.model,
            "unit": unit,
        },
    )
    if motion.terms:
        return result
    units = [text.format(unit) for _, text in COLUMNS.values()]
    return result.assign_coords(
        column=list(COLUMNS), column_units=("column", units)
    ).assign(
        coefficient=(
            ("draw", "column"),
            coefficients,
            {"units": "see column_units", "long_name": "coefficient of the projection"},
        )
    )


def _name(
    fit: Fit, motion: Motion, paths: PosteriorPaths, draw: int, out: np.ndarray
) -> None:
    """Write the named terms of a draw ``(frame, individual, space, term)``."""
    forgets = getattr(fit.model.transition, "form", "acceleration") == "velocity"
    for frames in frames_of(paths, draw):
        given = (frames.states, frames.adjacency, frames.present, frames.values)
        whole = motion.acceleration(*given)
        named = whole.new_zeros(*whole.shape, len(TERMS))
        for name, term in zip(motion.terms, motion.forces(*given).unbind(-3), strict=True):
            place = PLACES.get(name, "other")
            if place != "other":
                named[..., TERMS.index(place)] += term
        if forgets:
            own = frames.velocities / motion.dt
            named[..., TERMS.index("self")] -= own * frames.present.unsqueeze(-1)
        named[..., -1] = whole - named.sum(-1)
        out[frames.rows] = named.numpy()


def _project(
    fit: Fit, motion: Motion, paths: PosteriorPaths, draw: int, out: np.ndarray
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
    positions, velocities = frames.positions, frames.velocities
    scales = fit.scales
    low, high = positions.new_tensor(scales.low), positions.new_tensor(scales.high)
    half_width = 0.5 * WALL_AT * (high - low)
    speed = velocities.norm(dim=-1, keepdim=True)
    columns = [
        boids_terms.cohesion(positions, graph),
        # Nearer than the tracking noise, nobody knows how near.
        boids_terms.separation(positions, graph, softening=scales.noise),
        boids_terms.alignment(velocities, graph, relative=True),
        velocities,
        velocities / torch.where(speed > 0, speed, 1.0),
        positions - positions.new_tensor(scales.centre),
        boids_terms.wall(positions, half_width, 0.5 * (low + high)),
    ]
    return torch.stack(columns, -1) * frames.present[..., None, None]


def _solve(products: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Solve normal equations; of columns that are combinations of others, the shortest solution."""
    scale = products.diagonal().sqrt()
    scale = torch.where(scale > 0, scale, 1.0)
    inverse = torch.linalg.pinv(products / scale / scale.unsqueeze(-1), COLLINEAR, hermitian=True)
    return inverse @ (targets / scale) / scale


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
    ``share (quantile, term)``
        Mean length of a term over the sum of the mean lengths of all.
    ``angle``, ``angle_to_heading (quantile, trial, time, individual, term)``
        In two dimensions: direction in the world, from the x axis towards the y axis, and
        from the heading, positive to where y is from x; radians, the middle from -pi to pi and the
        ends of the interval about it. In three dimensions only ``angle_to_heading``, from 0 to pi.
    """
    force = forces["force"].transpose("draw", *FORCE_DIMS).to_numpy()
    velocity = forces["velocity"].transpose("draw", *FORCE_DIMS[:-1]).to_numpy()
    length = np.linalg.norm(force, axis=-2)
    over_group = _mean(length, (3,))
    over_time = _mean(length, (1, 2))
    overall = _mean(length, (1, 2, 3))
    total = overall.sum(-1, keepdims=True)
    share = np.divide(overall, total, out=np.full_like(overall, np.nan), where=total > 0)
    unit = forces["force"].attrs["units"]
    at = ("quantile", "trial", "time", "individual", "term")

    def size(what: str) -> dict[str, str]:
        return {"units": unit, "long_name": what}

    data = {
        "magnitude": (at, quantiles(length), size("magnitude of the force")),
        "mean_force": (FORCE_DIMS, _mean(force, (0,)), size("posterior mean of the force")),
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
    }
    for name, (angle, what) in _angles(force, velocity).items():
        data[name] = (at, angle, {"units": "rad", "long_name": what})
    coords = {"quantile": list(QUANTILES)}
    coords |= {name: forces[name].to_numpy() for name in FORCE_DIMS}
    return xr.Dataset(data, coords, dict(forces.attrs)).assign(explained=forces["explained"])


def _angles(force: np.ndarray, velocity: np.ndarray) -> dict[str, tuple[np.ndarray, str]]:
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


def _circular_quantiles(angle: np.ndarray) -> np.ndarray:
    """Return quantiles over the first dimension, of deviations from the mean direction."""
    middle = np.arctan2(_mean(np.sin(angle), (0,)), _mean(np.cos(angle), (0,)))
    found = middle + quantiles(_wrapped(angle - middle))
    return np.asarray(found + (_wrapped(found[1]) - found[1]))


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def quantiles(values: np.ndarray) -> np.ndarray:
    """Return :data:`QUANTILES` over the first dimension, NaN left out.

    Of n draws, the interval between ranks 0.05 (n + 1) and 0.95 (n + 1), which holds another draw
    with probability 0.9.
    """
    known = np.isfinite(values).any(0)
    out = np.full((len(QUANTILES), *values.shape[1:]), np.nan)
    some = values[:, known]
    if not some.size:
        return out
    if np.isfinite(some).all():
        out[:, known] = np.quantile(some, QUANTILES, axis=0, method="weibull")
    else:
        out[:, known] = np.nanquantile(some, QUANTILES, axis=0, method="weibull")
    return out


def _mean(values: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Return the mean over what is known, NaN where nothing is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axes, dtype=np.float64)
    count = known.sum(axes)
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def true_forces(tracks: xr.Dataset) -> xr.Dataset:
    """Return the forces behind simulated tracks, with the labels of :func:`posterior_forces`.

    Parameters
    ----------
    tracks
        With ``force (trial, time, term, space, individual)`` as
        :func:`swarmssm.simulate.simulate_boids` writes it. Those of the velocity form are divided
        by the time step, and ``self`` then holds ``-v / dt``. Tracks that do not say how they were
        simulated are taken to hold accelerations.

    Returns
    -------
    Dataset with ``force (trial, time, individual, space, term)``. ``other`` is what the limits of
    speed did, where the tracks hold ``next_velocity``, else unknown (NaN).

    Raises
    ------
    InputError
        If the tracks have no forces, or those of a law that they do not add up to accelerations in.
    """
    tracks = with_trials(validate_tracks(tracks))
    if "force" not in tracks or "term" not in tracks["force"].dims:
        raise InputError(
            "tracks: they hold no true forces. Only simulated tracks do, in the variable force "
            "(trial, time, term, space, individual)."
        )
    per, forgets = 1.0, False
    if "simulation" in tracks.attrs:
        law = law_of(tracks)
        if law.name != "boids":
            raise InputError(
                f"tracks: they follow the law {law.name}, whose terms do not add up to an "
                "acceleration. Simulate boids."
            )
        forgets = getattr(law, "form", "acceleration") == "velocity"
        per = 1.0 / law.dt if forgets else 1.0
    fps = float(tracks.attrs["fps"])
    space = tracks.sizes["space"]
    velocity = states_of(tracks)[..., space:]
    if "true_velocity" in tracks:
        velocity = tracks["true_velocity"].transpose(*FORCE_DIMS[:-1]).to_numpy()
    given = tracks["force"].transpose(*FORCE_DIMS)
    out = np.zeros((*velocity.shape, len(TERMS)))
    for name in given["term"].to_numpy():
        place = TERMS.index(PLACES.get(str(name), "other"))
        out[..., place] += per * given.sel(term=name).to_numpy()
    if forgets:
        out[..., TERMS.index("self")] -= fps * velocity
    if "next_velocity" in tracks:
        following = tracks["next_velocity"].transpose(*FORCE_DIMS[:-1]).to_numpy()
        out[..., -1] = fps * (following - velocity) - out[..., :-1].sum(-1)
    else:
        out[..., -1] = np.nan
    attrs = {"units": f"{unit_of(tracks)}/s^2", "long_name": "true contribution"}
    return xr.Dataset(
        {"force": (FORCE_DIMS, out, attrs)},
        {"term": list(TERMS), **labels_of(tracks, *FORCE_DIMS[:-1])},
        {"source": "truth", "unit": unit_of(tracks)},
    )


def force_agreement(forces: xr.Dataset, truth: xr.Dataset) -> xr.Dataset:
    """Compare posterior forces with true ones.

    Parameters
    ----------
    forces
        What :func:`posterior_forces` returned.
    truth
        What :func:`true_forces` returned.

    Returns
    -------
    Dataset over ``term``: ``r_squared`` of the posterior mean, over all coordinates, individuals
    and frames, NaN where the true force never changes; ``slope`` of the true force on the posterior
    mean, 1 if this is neither too large nor too small; ``coverage``, the share of true coordinates
    within the 90 % interval of their draws.

    Raises
    ------
    InputError
        If the two have no trial, frame or individual in common.
    """
    mine, theirs = xr.align(forces["force"], truth["force"], join="inner")
    if not mine.size:
        raise InputError("truth: it has no trial, frame, individual or term of these forces.")
    mine, theirs = mine.transpose("draw", *FORCE_DIMS), theirs.transpose(*FORCE_DIMS)
    found = {"r_squared": [], "slope": [], "coverage": []}
    for term in mine["term"].to_numpy():
        drawn, true = mine.sel(term=term).to_numpy(), theirs.sel(term=term).to_numpy()
        known = np.isfinite(drawn).all(0) & np.isfinite(true)
        drawn, true = drawn[:, known].astype(np.float64), true[known]
        for name, value in zip(found, _agreement(drawn, true), strict=True):
            found[name].append(value)
    names = {
        "r_squared": "R^2 of the posterior mean",
        "slope": "slope of the true force on the posterior mean",
        "coverage": "coverage of 90 % intervals",
    }
    data = {
        name: ("term", found[name], {"units": "1", "long_name": text})
        for name, text in names.items()
    }
    return xr.Dataset(data, {"term": mine["term"].to_numpy()})


def _agreement(drawn: np.ndarray, true: np.ndarray) -> tuple[float, float, float]:
    """Return R^2, slope and coverage, NaN where they are not defined."""
    spread = np.square(true - true.mean()).sum() if true.size else 0.0
    if not spread > 0:
        return np.nan, np.nan, np.nan
    mean = drawn.mean(0)
    r_squared = 1.0 - np.square(mean - true).sum() / spread
    squared = np.square(mean).sum()
    slope = (mean * true).sum() / squared if squared > 0 else np.nan
    if len(drawn) == 1:
        return float(r_squared), float(slope), np.nan
    low, _, high = quantiles(drawn)
    return float(r_squared), float(slope), float(((true >= low) & (true <= high)).mean())


def sentence(forces: xr.Dataset) -> str:
    """Say in a sentence what :func:`posterior_forces` or :func:`force_summary` found."""
    summary = forces if "share" in forces else force_summary(forces)
    share = 100.0 * summary["share"].to_numpy()
    order = [i for i in np.argsort(-share[1]) if np.isfinite(share[1, i])]
    parts = [
        f"{TERMS[i]} {share[1, i]:.0f} % ({share[0, i]:.0f} to {share[2, i]:.0f})" for i in order
    ]
    low, middle, high = 100.0 * quantiles(summary["explained"].to_numpy())
    listed = ", ".join(parts)
    if summary.attrs["source"] == "projection":
        return (
            "The model has no named forces; the boids terms fitted to its accelerations by least "
            f"squares explain {middle:.0f} % of them ({low:.0f} to {high:.0f} over the posterior "
            f"draws), with shares of the mean magnitude: {listed}. What they leave over is other, "
            "and the intervals do not count how far the boids terms are the wrong ones."
        )
    return (
        f"Shares of the mean magnitude of the forces, with 90 % intervals: {listed}. Together the "
        f"named terms make up {middle:.1f} % of the mean square of the expected acceleration, and "
        "the intervals hold if the model's terms are the right ones."
    )
