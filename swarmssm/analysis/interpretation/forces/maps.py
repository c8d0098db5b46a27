"""Force maps: how one turns and speeds up, by where a neighbour is.

Each pair of a focal individual and another counts once a frame: the focal one's acceleration, along
its heading and to its right, goes to the bin in which the other stands as seen from it. The map is
the mean of a bin (Katz et al., PNAS 2011; Heras et al., PLoS Comput Biol 2019). It is a description
and no law: what stands in a bin also holds what the others, walls and habits did meanwhile.
"""

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import torch
import xarray as xr

from swarmssm.analysis.interpretation.forces.frames import (
    check_plane,
    frames_of,
    seen_graph,
    unit_of,
)
from swarmssm.analysis.interpretation.forces.map_bins import BINS, MAPS, Portion, binned, labelled
from swarmssm.analysis.interpretation.forces.parabolas import (
    checked_window,
    parabola,
    shortest_window,
)
from swarmssm.analysis.posterior.accelerations import (
    PosteriorPaths,
    acceleration_model,
    posterior_paths,
)
from swarmssm.errors import InputError
from swarmssm.graphs import nearest_distances
from swarmssm.inference import Fit
from swarmssm.tracks import Array, spatial_attributes, states_of, validate_tracks, with_trials

__all__ = [
    "default_extent",
    "force_map",
    "force_map_agreement",
    "force_maps",
    "raw_force_map",
]

Neighbors = Literal["all", "seen"]
NEIGHBORS = ("all", "seen")
#: The map reaches so many distances to the nearest neighbour, unless told.
EXTENT = 4.0
#: Pairs that a bin must hold, and blocks that must have some, for its mean to be compared.
ENOUGH_PAIRS = 30
ENOUGH_BLOCKS = 3


def force_maps(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    draws: int = 10,
    bins: int = 15,
    extent: float | None = None,
    symmetric: bool = True,
    neighbors: Neighbors = "all",
    window: int | None = None,
    seed: int | torch.Generator = 0,
    paths: PosteriorPaths | None = None,
) -> xr.Dataset:
    """Return the maps of a model and of the raw data on the same bins, and how they agree.

    Parameters
    ----------
    fit, tracks, draws, bins, extent, symmetric, neighbors, window, seed, paths
        As in :func:`force_map` and :func:`raw_force_map`.

    Returns
    -------
    The two datasets along ``source``, ``"model"`` and ``"raw"``, with the variables of
    :func:`force_map_agreement`.

    Raises
    ------
    InputError
        As these.
    """
    shared: dict[str, Any] = {
        "bins": bins,
        "extent": default_extent(tracks) if extent is None else extent,
        "symmetric": symmetric,
        "neighbors": neighbors,
    }
    if neighbors == "seen":
        # Both on the graph that the fit made of the tracks.
        tracks = fit.prepare(tracks).tracks
    model = force_map(fit, tracks, draws=draws, seed=seed, paths=paths, **shared)
    raw = raw_force_map(tracks, window=window, **shared)
    both = xr.concat([model, raw], "source", combine_attrs="drop_conflicts")
    both = both.assign_coords(source=["model", "raw"])
    return both.merge(force_map_agreement(model, raw)).assign_attrs(model=fit.settings.model)


def force_map(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    draws: int = 10,
    bins: int = 15,
    extent: float | None = None,
    symmetric: bool = True,
    neighbors: Neighbors = "all",
    seed: int | torch.Generator = 0,
    paths: PosteriorPaths | None = None,
) -> xr.Dataset:
    """Return the map of the accelerations that a model expects along posterior paths.

    Parameters
    ----------
    fit
        A fit, in two dimensions.
    tracks
        Those the model was fitted on, or others.
    draws
        Draws of paths.
    bins
        Along each side of the square map, which is centred on the focal individual.
    extent
        Half its side, in the tracks' unit; absent, :func:`default_extent`.
    symmetric
        Whether left and right are taken to be mirror images: each pair counts a second time,
        mirrored.
    neighbors
        ``"all"``: all others who are there; ``"seen"``: those in the model's own graph.
    seed
        Seed or generator.
    paths
        As in :func:`swarmssm.analysis.posterior_forces`.

    Returns
    -------
    Dataset over ``front_back`` (positive ahead) and ``left_right`` (positive to the right of the
    animal, as the recording's ``y_axis`` has it), the middles of the bins:

    ``turning``
        Mean acceleration to the right of the heading, length unit per second squared.
    ``speeding``
        Mean acceleration along the heading.
    ``turning_error``, ``speeding_error``
        Standard errors: that of a ratio of sums over blocks of time, so that the similarity of
        consecutive frames counts, with the variance between draws added. NaN where
        fewer than two blocks have pairs.
    ``count``
        Pairs in the bin, mean over the draws.
    ``num_blocks``
        Blocks of time that have some.

    Raises
    ------
    InputError
        If tracks are in three dimensions, or a setting is out of range.
    """
    _check(bins, extent, neighbors)
    tracks = validate_tracks(tracks)
    check_plane(tracks, "a force map")
    if extent is None:
        extent = default_extent(tracks)
    motion = acceleration_model(fit)
    if paths is None:
        paths = posterior_paths(fit, tracks, draws, seed)
    mirror = _towards_up(tracks)
    total = paths.present.shape[0] * paths.present.shape[1]
    sums = []
    with torch.no_grad():
        for draw in range(paths.draws):

            def portions(draw: int = draw) -> Iterator[Portion]:
                for frames in frames_of(paths, draw):
                    acceleration = motion.acceleration(
                        frames.states, frames.adjacency, frames.present, frames.values
                    )
                    there: Any = (frames.present[:, :, None] & frames.present[:, None]).numpy()
                    if neighbors == "seen":
                        there &= seen_graph(fit, frames).numpy() > 0
                    states = frames.states.numpy() * mirror
                    own = acceleration.double().numpy() * mirror[:2]
                    yield Portion(frames.rows, states, own, there)

            sums.append(binned(portions(), total, bins, extent, symmetric))
    return labelled(sums, bins, extent, symmetric, neighbors, unit_of(paths.tracks), "model")


def raw_force_map(
    tracks: xr.Dataset,
    *,
    bins: int = 15,
    extent: float | None = None,
    symmetric: bool = True,
    neighbors: Neighbors = "all",
    window: int | None = None,
) -> xr.Dataset:
    """Return the map of the accelerations in the data, without any model of interactions.

    Parameters
    ----------
    tracks
        In two dimensions.
    bins, extent, symmetric
        As in :func:`force_map`.
    neighbors
        ``"all"``: all others who are there; ``"seen"``: those in the tracks' own ``adjacency``.
    window
        Frames, an odd number from 3 upwards. Position, velocity and acceleration of a frame are
        those of the parabola through the frames around it, known where all of them are, see
        :mod:`swarmssm.analysis.interpretation.forces.parabolas`. Absent, the shortest window, at
        most a second or 21 frames long, in which tracking noise
        (``estimate_noise``) is at most half of the acceleration seen.

    Returns
    -------
    As :func:`force_map`, with ``attrs["window"]``.

    Raises
    ------
    InputError
        If tracks are in three dimensions, a setting is out of range, or they have no adjacency
        where it is asked for.
    """
    _check(bins, extent, neighbors)
    tracks = with_trials(validate_tracks(tracks))
    check_plane(tracks, "a force map")
    if neighbors == "seen" and "adjacency" not in tracks:
        raise InputError(
            "neighbors: the tracks carry no adjacency, so nobody knows whom one sees. Choose all, "
            "or add a graph (swarmssm.graphs.add_adjacency)."
        )
    if extent is None:
        extent = default_extent(tracks)
    mirror = _towards_up(tracks)
    fps = float(tracks.attrs["fps"])
    position = states_of(tracks)[..., :2]
    window = shortest_window(position, fps) if window is None else checked_window(window)
    states, acceleration = parabola(position, fps, window)
    trials, times = states.shape[:2]
    states, acceleration = (x.reshape(trials * times, *x.shape[2:]) for x in (states, acceleration))
    seen = None
    if neighbors == "seen":
        order = ("trial", "time", "individual", "neighbor")
        graph = tracks["adjacency"].transpose(*order).to_numpy() != 0
        seen = graph.reshape(trials * times, *graph.shape[2:])
    step = max(1, 2**18 // max(states.shape[1], 1) ** 2)

    def portions() -> Iterator[Portion]:
        for first in range(0, len(states), step):
            rows = slice(first, min(first + step, len(states)))
            known: Any = np.isfinite(states[rows]).all(-1)
            moves = known & np.isfinite(acceleration[rows]).all(-1)
            there = moves[:, :, None] & known[:, None]
            if seen is not None:
                there &= seen[rows]
            yield Portion(rows, states[rows] * mirror, acceleration[rows] * mirror[:2], there)

    sums = [binned(portions(), len(states), bins, extent, symmetric)]
    found = labelled(sums, bins, extent, symmetric, neighbors, unit_of(tracks), "raw")
    return found.assign_attrs(window=window)


def _towards_up(tracks: xr.Dataset) -> Array:
    """Return factors of ``[x, y, vx, vy]`` after which y grows upwards, and right is right."""
    sign = -1.0 if spatial_attributes(tracks).get("y_axis") == "down" else 1.0
    return np.array([1.0, sign, 1.0, sign])


def default_extent(tracks: xr.Dataset) -> float:
    """Return four times the median distance to the nearest neighbour.

    Raises
    ------
    InputError
        If there are never two individuals in a frame.
    """
    tracks = with_trials(validate_tracks(tracks))
    position = states_of(tracks)[..., : tracks.sizes["space"]]
    position = position.reshape(-1, *position.shape[2:])
    # A few thousand frames are enough to tell a median.
    position = position[:: max(1, len(position) * position.shape[1] ** 2 // 2**21)]
    distance = nearest_distances(torch.from_numpy(np.ascontiguousarray(position))).numpy()
    distance = distance[np.isfinite(distance)]
    if not distance.size or not np.median(distance) > 0:
        raise InputError("tracks: there are never two individuals in a frame; no map can be drawn.")
    return EXTENT * float(np.median(distance))


def _check(bins: int, extent: float | None, neighbors: str) -> None:
    """Refuse settings that are out of range."""
    if isinstance(bins, bool) or not isinstance(bins, int | np.integer) or bins < 2:
        raise InputError(f"bins: it must be a whole number from 2 upwards, not {bins!r}.")
    if extent is not None and not 0 < extent < np.inf:
        raise InputError(f"extent: it must be a positive number, not {extent}.")
    if neighbors not in NEIGHBORS:
        raise InputError(f"neighbors: it must be one of {', '.join(NEIGHBORS)}, not {neighbors!r}.")


def force_map_agreement(model: xr.Dataset, raw: xr.Dataset) -> xr.Dataset:
    """Say how far the map of a model is that of the data, where both hold enough pairs.

    Parameters
    ----------
    model, raw
        What :func:`force_map` and :func:`raw_force_map` returned, on the same bins.

    Returns
    -------
    Dataset over ``map``, ``"turning"`` and ``"speeding"``, over the bins with at least 30 pairs in
    at least three blocks of time, weighted by the pairs in the data:

    ``correlation``
        Of the two maps.
    ``slope``
        Of the raw map on the model's, by least squares: 1 if the model's forces are neither too
        strong nor too weak.
    ``reliability``
        Share of the variance of the raw map that is not its sampling error, 0 to 1: by about this
        much the maps of two equally long recordings would correlate. A model's map on the same
        recording may do better, since it sees the same happenings.
    ``num_bins``
        How many bins.

    Raises
    ------
    InputError
        If the bins are not the same.
    """
    for name in BINS:
        if not np.array_equal(model[name].to_numpy(), raw[name].to_numpy()):
            raise InputError(
                "raw: its bins are not those of the model's map; give both one extent."
            )
    enough = (raw["count"] >= ENOUGH_PAIRS) & (raw["num_blocks"] >= ENOUGH_BLOCKS)
    enough &= (model["count"] >= ENOUGH_PAIRS) & (model["num_blocks"] >= ENOUGH_BLOCKS)
    chosen = enough.transpose(*BINS).to_numpy()
    found: dict[str, list[float]] = {"correlation": [], "slope": [], "reliability": []}
    for name in MAPS:
        expected, seen, error, weight = (
            data.transpose(*BINS).to_numpy()[chosen]
            for data in (model[name], raw[name], raw[f"{name}_error"], raw["count"])
        )
        for key, value in zip(found, _compare(expected, seen, error, weight), strict=True):
            found[key].append(value)
    titles = {
        "correlation": "correlation of the model's map with the raw one",
        "slope": "slope of the raw map on the model's",
        "reliability": "share of the raw map's variance that is no sampling error",
    }
    data = {n: ("map", v, {"units": "1", "long_name": titles[n]}) for n, v in found.items()}
    return xr.Dataset(data, {"map": list(MAPS)}).assign(
        num_bins=((), int(chosen.sum()), {"units": "1", "long_name": "bins compared"})
    )


def _compare(expected: Array, seen: Array, error: Array, weight: Array) -> tuple[float, ...]:
    """Return correlation, slope and reliability, NaN where they are not defined."""
    if len(seen) < 3:
        return (np.nan,) * 3
    weight = weight / weight.sum()
    mine, theirs = expected - weight @ expected, seen - weight @ seen
    own, other, both = weight @ mine**2, weight @ theirs**2, weight @ (mine * theirs)
    if not (own > 0 and other > 0):
        return (np.nan,) * 3
    reliability = 1.0 - (weight @ error**2) / other
    return (
        float(both / np.sqrt(own * other)),
        float(both / own),
        float(np.clip(reliability, 0.0, 1.0)),
    )
