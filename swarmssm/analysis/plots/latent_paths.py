"""Latents of chosen individuals over time, and how surely they are known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import norm

from swarmssm.analysis.plots.style import individual_colours, new_grid
from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["plot_latent_paths"]

#: Individuals and latents that are drawn by default.
FEW, MOST = 3, 6


def plot_latent_paths(
    posterior: xr.Dataset,
    axes: npt.NDArray[Any] | None = None,
    *,
    trial: str | None = None,
    individuals: Sequence[str] | None = None,
    latents: Sequence[int] | None = None,
    level: float = 0.9,
    names: Sequence[str] | None = None,
) -> tuple[Figure, npt.NDArray[Any]]:
    """Draw the posterior of latents over time: the mean, and a band.

    Parameters
    ----------
    posterior
        What :meth:`swarmssm.inference.Fit.posterior` returned.
    axes
        One a latent; new ones if absent.
    trial
        Label; default the first.
    individuals
        Labels; default the first three of whom anything is known.
    latents
        Numbers of those to draw; default the six whose means vary most beside their standard
        deviation, in their own order.
    level
        Share of the posterior that a band holds: quantiles of the draws, if there are, else
        those of a Gaussian with the same mean and standard deviation.
    names
        Of all latents, where they have any, such as ``["x", "y", "vx", "vy"]``.

    Returns
    -------
    Figure and axes ``(latent,)``: a line and a band in each individual's colour, with gaps where
    it was not observed.

    Raises
    ------
    InputError
        If a label or latent is unknown, ``level`` is not between 0 and 1, there are not as many
        names as latents, or nothing is known of anybody.
    """
    if not 0.0 < level < 1.0:
        raise InputError(f"level: it must lie between 0 and 1, and it is {level:g}.")
    total = posterior.sizes["latent"]
    if names is not None and len(names) != total:
        raise InputError(f"names: {total} are needed, one a latent, and {len(names)} are given.")
    labels = [str(label) for label in posterior["trial"].values]
    if trial is not None and str(trial) not in labels:
        raise InputError(f"trial: there is no {str(trial)!r}; there are {', '.join(labels[:8])}.")
    part = posterior.isel(trial=0 if trial is None else labels.index(str(trial)))
    who = _individuals(part, individuals)
    part = part.isel(individual=who)
    middle = part["mean"].transpose("time", "individual", "latent").to_numpy()
    chosen = _latents(part, middle, latents)
    low, high = _band(part, middle, level)
    count = len(chosen)
    figure, grid = new_grid(axes, count, 1, (7.2, 1.25 * count + 0.9), sharex=True)
    seconds = part["time"].to_numpy()
    members = [str(name) for name in part["individual"].values]
    colours = individual_colours(posterior.sizes["individual"])
    for ax, latent in zip(grid[:, 0], chosen, strict=True):
        for place, member in enumerate(who):
            band = (low[:, place, latent], high[:, place, latent])
            ax.fill_between(seconds, *band, color=colours[member], alpha=0.22, linewidth=0)
            ax.plot(seconds, middle[:, place, latent], color=colours[member], linewidth=1.1)
        ax.set_ylabel(f"latent {latent}" if names is None else names[latent], parse_math=False)
    grid[-1, 0].set_xlabel("time (s)")
    if axes is None:
        figure.align_ylabels(grid[:, 0])
        handles = [
            Line2D([], [], color=colours[member], label=name)
            for name, member in zip(members, who, strict=True)
        ]
        title = f"individual (band: {100 * level:.0f} %)"
        figure.legend(
            handles=handles, title=title, loc="outside lower center", ncols=8, frameon=False
        )
    return figure, grid[:, 0]


def _individuals(part: xr.Dataset, wanted: Sequence[str] | None) -> list[int]:
    """Return the places of the individuals to draw."""
    everyone = [str(name) for name in part["individual"].values]
    if wanted is None:
        known = part["mean"].notnull().any(("time", "latent")).to_numpy()
        places = [int(place) for place in np.flatnonzero(known)[:FEW]]
        if not places:
            raise InputError(f"posterior: in trial {part['trial'].item()} nobody is observed.")
        return places
    names = [str(name) for name in wanted]
    unknown = [name for name in names if name not in everyone]
    if unknown or not names:
        said = f"there is no {unknown[0]!r}" if unknown else "none is named"
        raise InputError(f"individuals: {said}; there are {', '.join(everyone[:10])}.")
    return [everyone.index(name) for name in names]


def _latents(part: xr.Dataset, middle: Array, wanted: Sequence[int] | None) -> list[int]:
    """Return the latents to draw."""
    total = middle.shape[-1]
    if wanted is not None:
        unknown = [latent for latent in wanted if not 0 <= latent < total]
        if unknown or not len(wanted):
            said = f"there is no {unknown[0]}" if unknown else "none is named"
            raise InputError(f"latents: {said}; there are 0 to {total - 1}.")
        return [int(latent) for latent in wanted]
    spread = part["sd"].transpose("time", "individual", "latent").to_numpy()
    flat = middle.reshape(-1, total)
    sure = np.nanmean(np.square(spread.reshape(-1, total)), axis=0)
    told = np.nanvar(flat, axis=0) / np.maximum(sure, 1e-30)
    return sorted(int(latent) for latent in np.argsort(-told, kind="stable")[:MOST])


def _band(part: xr.Dataset, middle: Array, level: float) -> tuple[Array, Array]:
    """Return the ends of the central interval ``(time, individual, latent)``."""
    sides = ((1 - level) / 2, (1 + level) / 2)
    if "states" in part:
        draws = part["states"].transpose("draw", "time", "individual", "latent").to_numpy()
        low, high = np.quantile(draws, sides, axis=0)
        return low, high
    sd = part["sd"].transpose("time", "individual", "latent").to_numpy()
    away = float(norm.ppf(sides[1]))
    return middle - away * sd, middle + away * sd
