"""Recorded tracks that come with the package."""

from importlib import resources

import numpy as np
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks import Array, make_tracks

__all__ = ["load_sunbleak", "load_sunbleak_groups"]

TEXTS = ("scale", "species", "source", "license", "attribution", "changes")


def load_sunbleak(individuals: int | None = 10) -> xr.Dataset:
    """Return five seconds of a milling shoal of about a thousand sunbleak, or a group in it.

    *Leucaspius delineatus* in a square tank 3 m wide, tracked with TRex: 200 frames at 40 frames
    per second of the 389 fish that were tracked in at least 90 % of them. About a thousand swam
    there, so that some true neighbours of each fish are missing.

    The fish stand in an order, made once from the recording, such that the first N are a well
    tracked group that stays together. The bond of two fish is the number of frames in which one is
    among the six nearest of the other, out of *all* fish seen in that frame. The first 30 have the
    largest sum of bonds found among the fish that never come within 25 cm of a wall; in them, fish
    stand the later the weaker their bonds to those before are, and so do all others after them:

    ===  =======  ======  =======  ==============  ==================
    N    tracked  radius  nearest  nearest inside  nearest six inside
    ===  =======  ======  =======  ==============  ==================
    10   98.9 %   6.1     2.6      70 %            54 %
    20   98.6 %   10.4    2.9      65 %            55 %
    30   98.4 %   11.6    3.2      60 %            57 %
    ===  =======  ======  =======  ==============  ==================

    (radius: root mean square distance from the centroid; nearest: median distance to the nearest
    member, where it is 1.9 in the whole shoal; the last two: share of a member's true nearest
    neighbour, or nearest six, that belong to the group.)

    Parameters
    ----------
    individuals
        How many fish, from 1 to 389; None for all.

    Returns
    -------
    Tracks with ``position`` (time, space, individual) in the unit of the tracker, which is not
    calibrated: the tank spans about 119 of them, so that one is some 2.5 cm. x points right and y
    down. Labels are the tracker's numbers. No step is longer than five times the median one, but
    identities were not verified by eye, and a centroid shifts by some tenths of a unit where two
    fish touch. ``attrs`` carry scale, species, source, license, attribution and changes made.

    Raises
    ------
    InputError
        If ``individuals`` is not a number of fish that there are.

    References
    ----------
    Walter, T., Albi, A., Bath, D., Couzin, I. D. et al. (2020). Reproduction data for: TRex.
    doi:10.17617/3.4y, CC BY 4.0.
    """
    with (
        resources.files("swarmssm").joinpath("data", "sunbleak.npz").open("rb") as stream,
        np.load(stream, allow_pickle=False) as clip,
    ):
        arrays = {name: clip[name] for name in clip.files}
    most = arrays["xy"].shape[1]
    if individuals is None:
        individuals = most
    if not isinstance(individuals, int | np.integer) or not 1 <= individuals <= most:
        raise InputError(
            f"individuals: give a whole number from 1 to {most}, the fish in the clip, "
            f"not {individuals!r}."
        )
    return make_tracks(
        arrays["xy"][:, :individuals],
        fps=float(arrays["fps"]),
        frames=arrays["frame"],
        individuals=arrays["id"][:individuals].tolist(),
        unit=str(arrays["unit"]),
        source_software="TRex",
        source_file="sunbleak.npz",
        attrs={"y_axis": "down"} | {name: str(arrays[name]) for name in TEXTS},
    )


def load_sunbleak_groups(individuals: int = 10, groups: int = 8) -> xr.Dataset:
    """Return several groups of the shoal of :func:`load_sunbleak`, no fish in two of them.

    One group of ten swims through a corner of the tank in five seconds; several tell more of the
    shoal. The first is that of :func:`load_sunbleak`. Each other one is, among the fish not yet
    taken, a fish with those nearest to it, such that the mean distance in the group is least;
    distances of two fish are means over the frames in which both are seen.

    Parameters
    ----------
    individuals
        Fish in each group, at least 2.
    groups
        How many.

    Returns
    -------
    Tracks as of :func:`load_sunbleak`, in which each group is a trial of the same five seconds,
    and ``fish (trial, individual)`` holds the tracker's numbers.

    Raises
    ------
    InputError
        If there are not so many fish.
    """
    shoal = load_sunbleak(None)
    most = shoal.sizes["individual"]
    if individuals < 2 or groups < 1 or individuals * groups > most:
        raise InputError(
            f"groups: {groups} groups of {individuals} fish cannot be made of {most} fish; a group "
            "has at least 2."
        )
    position = shoal["position"].transpose("time", "individual", "space").to_numpy()
    members = [np.arange(individuals)]
    distance = _mean_distances(position)
    distance[members[0]] = distance[:, members[0]] = np.inf
    for _ in range(groups - 1):
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :individuals]
        spread = distance[nearest[:, :, None], nearest[:, None, :]].sum(axis=(1, 2))
        chosen = nearest[int(np.argmin(spread))]
        members.append(chosen)
        distance[chosen] = distance[:, chosen] = np.inf
    return make_tracks(
        np.stack([position[:, group] for group in members]),
        fps=shoal.attrs["fps"],
        frames=shoal["frame"].to_numpy(),
        trials=[f"group {number}" for number in range(1, groups + 1)],
        variables={"fish": (("trial", "individual"), shoal["individual"].to_numpy()[members])},
        unit=shoal.attrs["unit"],
        source_software="TRex",
        source_file="sunbleak.npz",
        attrs={name: shoal.attrs[name] for name in ("y_axis", *TEXTS)},
    )


def _mean_distances(position: Array) -> Array:
    """Return the mean distance of each two fish over the frames in which both are seen.

    A fish is at distance 0 of itself; two that are never seen together are infinitely far apart.
    """
    total = np.zeros((position.shape[1],) * 2)
    count = np.zeros_like(total)
    for frame in position:
        apart = np.sqrt(((frame[:, None] - frame[None]) ** 2).sum(-1))
        known = np.isfinite(apart)
        total += np.where(known, apart, 0.0)
        count += known
    return np.where(count > 0, total / np.maximum(count, 1), np.inf)
