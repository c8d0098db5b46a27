"""Bins around a focal individual: mean accelerations and their standard errors."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from swarmssm.analysis.posterior.intervals import known_mean
from swarmssm.tracks import Array

__all__ = ["BINS", "MAPS", "Portion", "Sums", "binned", "labelled"]

#: Blocks of time over all trials, from which standard errors are told.
BLOCKS = 20
MAPS = ("turning", "speeding")
BINS = ("front_back", "left_right")


def _off(count: int) -> Any:
    return ~np.eye(count, dtype=bool)


class Portion(NamedTuple):
    """Some frames: states and accelerations ``(frame, individual, ...)``, and which pairs count."""

    rows: slice
    states: Array
    acceleration: Array
    there: Any


class Sums(NamedTuple):
    """Sums over the pairs in each bin, by blocks of time.

    ``pairs (block, bin, bin)``, ``total (block, map, bin, bin)``; bins are front-back, left-right.
    """

    pairs: Array
    total: Array


def binned(
    portions: Iterator[Portion], frames: int, bins: int, extent: float, symmetric: bool
) -> Sums:
    """Sum the accelerations of focal individuals by where the others are."""
    blocks = max(1, min(BLOCKS, frames))
    cells = blocks * bins * bins
    count, total = np.zeros(cells), np.zeros((len(MAPS), cells))
    for portion in portions:
        velocity = portion.states[..., 2:]
        speed = np.linalg.norm(np.nan_to_num(velocity), axis=-1)
        there = portion.there & (speed > 0)[:, :, None] & _off(speed.shape[1])
        frame, mine, other = np.nonzero(there)
        heading = velocity[frame, mine] / speed[frame, mine, None]
        right = np.stack([heading[:, 1], -heading[:, 0]], -1)
        offset = portion.states[frame, other, :2] - portion.states[frame, mine, :2]
        ahead, aside = (offset * heading).sum(-1), (offset * right).sum(-1)
        own = portion.acceleration[frame, mine]
        turning, speeding = (own * right).sum(-1), (own * heading).sum(-1)
        block = (portion.rows.start + frame) * blocks // frames
        for side in (1.0, -1.0) if symmetric else (1.0,):
            row = np.floor((ahead + extent) / (2 * extent) * bins)
            column = np.floor((side * aside + extent) / (2 * extent) * bins)
            inside = (row >= 0) & (row < bins) & (column >= 0) & (column < bins)
            cell = ((block * bins + row) * bins + column)[inside].astype(np.int64)
            count += np.bincount(cell, minlength=cells)
            for index, value in enumerate((side * turning, speeding)):
                total[index] += np.bincount(cell, value[inside], cells)
    shape = (blocks, bins, bins)
    return Sums(count.reshape(shape), np.moveaxis(total.reshape(len(MAPS), *shape), 0, 1))


def labelled(
    sums: list[Sums],
    bins: int,
    extent: float,
    symmetric: bool,
    neighbors: str,
    unit: str,
    source: str,
) -> xr.Dataset:
    """Label means and standard errors."""
    count = np.stack([one.pairs for one in sums])
    total = np.stack([one.total for one in sums])
    number = count.sum(1)[:, None]
    means = np.divide(
        total.sum(1), number, out=np.full(total.sum(1).shape, np.nan), where=number > 0
    )
    mean = known_mean(means, 0)
    # Blocks are the same in all draws: their scatter is told from the mean over these.
    pairs, summed = count.mean(0)[:, None], total.mean(0)
    blocks = (pairs[:, 0] > 0).sum(0)
    rest = summed - np.where(pairs > 0, mean, 0.0) * pairs
    scatter = np.square(rest).sum(0) / np.square(np.where(blocks > 0, pairs.sum(0), 1.0))
    variance = scatter * blocks / np.maximum(blocks - 1, 1)
    if len(sums) > 1:
        variance = variance + known_mean(np.square(means - mean), 0) * len(sums) / (len(sums) - 1)
    error = np.where(blocks > 1, np.sqrt(variance), np.nan)
    edges = np.linspace(-extent, extent, bins + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    titles = {
        "turning": "acceleration to the right of the heading",
        "speeding": "acceleration along the heading",
    }
    data: dict[str, Any] = {}
    for index, name in enumerate(MAPS):
        attrs = {"units": f"{unit}/s^2", "long_name": titles[name]}
        data[name] = (BINS, mean[index], attrs)
        data[f"{name}_error"] = (
            BINS,
            error[index],
            {"units": f"{unit}/s^2", "long_name": f"standard error of {name}"},
        )
    data["count"] = (BINS, count.sum(1).mean(0), {"units": "1", "long_name": "pairs in the bin"})
    data["num_blocks"] = (BINS, blocks, {"units": "1", "long_name": "blocks of time with pairs"})
    places = {
        "front_back": "neighbour ahead (positive) or behind",
        "left_right": "neighbour to the right (positive) or to the left",
    }
    coords = {
        name: (name, middles, {"units": unit, "long_name": text}) for name, text in places.items()
    }
    about: dict[str, Any] = {
        "source": source,
        "unit": unit,
        "extent": float(extent),
        "symmetric": int(symmetric),
        "neighbors": neighbors,
    }
    return xr.Dataset(data, coords, about)
