"""The forces behind simulated tracks, and how near posterior ones come."""

import numpy as np
import xarray as xr

from swarmssm.analysis.interpretation.forces.frames import labels_of, unit_of
from swarmssm.analysis.interpretation.forces.posterior import FORCE_DIMS, PLACES, TERMS
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.errors import InputError
from swarmssm.simulate import dynamics_of
from swarmssm.tracks import Array, spatial_attributes, states_of, validate_tracks, with_trials

__all__ = ["force_agreement", "true_forces"]


def true_forces(tracks: xr.Dataset) -> xr.Dataset:
    """Return the forces behind simulated tracks, with the labels of posterior ones.

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
        law = dynamics_of(tracks)
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
        {"source": "truth", **spatial_attributes(tracks)},
    )


def force_agreement(forces: xr.Dataset, truth: xr.Dataset) -> xr.Dataset:
    """Compare posterior forces with true ones.

    Parameters
    ----------
    forces
        What :func:`swarmssm.analysis.posterior_forces` returned.
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
    found: dict[str, list[float]] = {"r_squared": [], "slope": [], "coverage": []}
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


def _agreement(drawn: Array, true: Array) -> tuple[float, float, float]:
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
