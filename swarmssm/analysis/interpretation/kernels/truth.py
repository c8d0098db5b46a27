"""The kernels behind simulated boids, and how near estimated ones come."""

from typing import Any

import numpy as np
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.simulate import dynamics_of

__all__ = ["kernel_agreement", "true_kernels"]

KERNELS = ("attraction", "repulsion", "alignment", "net")


def true_kernels(tracks: xr.Dataset, kernels: xr.Dataset) -> xr.Dataset:
    """Return the kernels behind simulated boids, at the distances of estimated ones.

    Parameters
    ----------
    tracks
        As :func:`swarmssm.simulate.simulate_boids` returned them.
    kernels
        What :func:`swarmssm.analysis.interaction_kernels` returned; its mean number of
        neighbours is taken for ``net``.

    Returns
    -------
    Dataset with ``attraction``, ``repulsion``, ``alignment`` and ``net (distance)``; 0 beyond the
    radius of sight.

    Raises
    ------
    InputError
        If the tracks do not say that they are simulated boids.
    """
    law: Any = dynamics_of(tracks)
    if law.name != "boids":
        raise InputError(f"tracks: they follow the law {law.name}, which has no kernels of boids.")
    distance = kernels["distance"].to_numpy()
    per = 1.0 / law.dt if law.form == "velocity" else 1.0
    radius = law.graph.radius
    seen = np.ones_like(distance) if radius is None else (distance <= radius).astype(np.float64)
    attraction = per * law.cohesion_gain * distance * seen
    repulsion = -per * law.separation_gain * distance**-law.exponent * seen
    alignment = per * law.alignment_gain * seen
    net = attraction + float(kernels["neighbors"].sel(quantile=0.5)) * repulsion
    values = {
        "attraction": attraction,
        "repulsion": repulsion,
        "alignment": alignment,
        "net": net,
    }
    return xr.Dataset(
        {
            name: ("distance", value, kernels[name].attrs if name in kernels else {})
            for name, value in values.items()
        },
        {"distance": kernels["distance"]},
    )


def kernel_agreement(kernels: xr.Dataset, truth: xr.Dataset) -> xr.Dataset:
    """Compare kernels with true ones, each distance counting by how many neighbours are there.

    Parameters
    ----------
    kernels
        What :func:`swarmssm.analysis.interaction_kernels` returned.
    truth
        What :func:`true_kernels` returned, or any ``net`` and ``alignment (distance)`` at the same
        distances.

    Returns
    -------
    Dataset over ``kernel``, those of the two datasets' kernels that are in both: ``error``, the
    root of the weighted mean square of the middle curve minus the true one, over that of the true
    one; ``coverage``, the weighted share of the true curve within the 90 % band.

    Raises
    ------
    InputError
        If the distances are not the same.
    """
    if not np.array_equal(kernels["distance"].to_numpy(), truth["distance"].to_numpy()):
        raise InputError("truth: its distances are not those of the kernels.")
    weight = (kernels["density"] * np.gradient(kernels["distance"].to_numpy())).to_numpy()
    weight = weight / weight.sum()
    names = [name for name in KERNELS if name in kernels and name in truth]
    error, coverage = [], []
    for name in names:
        low, middle, high = kernels[name].transpose("quantile", "distance").to_numpy()
        true = truth[name].to_numpy()
        size = (weight * true**2).sum()
        off = (weight * (middle - true) ** 2).sum()
        error.append(float(np.sqrt(off / size)) if size > 0 else np.nan)
        coverage.append(float((weight * ((true >= low) & (true <= high))).sum()))
    return xr.Dataset(
        {
            "error": ("kernel", error, {"units": "1", "long_name": "relative L2 error"}),
            "coverage": ("kernel", coverage, {"units": "1", "long_name": "coverage of the band"}),
        },
        {"kernel": names},
    )
