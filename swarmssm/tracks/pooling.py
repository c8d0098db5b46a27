"""Several recordings as the trials of one."""

from collections.abc import Mapping

import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks.dataset import has_trials
from swarmssm.tracks.validation import validate_tracks

__all__ = ["pool_tracks"]

#: Variables that are pooled; further ones are left out.
POOLED = ("position", "velocity", "adjacency")
#: Largest relative difference of two frame rates that are taken as equal.
RATE_TOLERANCE = 1e-6


def pool_tracks(recordings: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """Put recordings of one kind together, each as one trial or, if it has trials, several.

    Parameters
    ----------
    recordings
        Name -> tracks. A recording without trials becomes a trial of this name; trials keep their
        own names where these are all different; else they are ``<recording>/<trial>``, and a single
        one is ``<recording>``.

    Returns
    -------
    Tracks that begin at 0 seconds. Shorter recordings end with NaN. Individuals are matched by
    label; where a recording has no individual of a label, it is not observed. Attributes are those
    on which all recordings agree.

    Raises
    ------
    InputError
        If there are no recordings, or they differ in frame rate, unit, dimensions of space, or in
        whether they have velocities or graphs.
    """
    if not recordings:
        raise InputError("tracks: the list of recordings is empty.")
    valid = {name: validate_tracks(tracks, name) for name, tracks in recordings.items()}
    first = next(iter(valid))
    for name, tracks in valid.items():
        _check_alike(first, valid[first], name, tracks)
    labels = [str(label) for t in valid.values() if has_trials(t) for label in t["trial"].values]
    labels += [name for name, tracks in valid.items() if not has_trials(tracks)]
    distinct = len(set(labels)) == len(labels)
    parts = [_as_trials(tracks, name, distinct) for name, tracks in valid.items()]
    pooled = xr.concat(parts, "trial", join="outer", combine_attrs="drop_conflicts")
    if "adjacency" in pooled:
        kind = parts[0]["adjacency"].dtype
        pooled["adjacency"] = pooled["adjacency"].fillna(0).astype(kind)
    longest = max(parts, key=lambda part: part.sizes["time"])
    return validate_tracks(pooled.assign_coords(time=longest["time"]))


def _check_alike(first: str, one: xr.Dataset, name: str, other: xr.Dataset) -> None:
    """Refuse recordings of two kinds."""
    rates = float(one.attrs["fps"]), float(other.attrs["fps"])
    if abs(rates[1] - rates[0]) > RATE_TOLERANCE * rates[0]:
        raise InputError(
            f"fps: recording {first} has {rates[0]:g} frames per second and {name} has "
            f"{rates[1]:g}. Resample one of them, or fit them one by one."
        )
    units = [tracks.attrs.get("unit") or "no unit" for tracks in (one, other)]
    spaces = [f"{tracks.sizes['space']} dimensions" for tracks in (one, other)]
    for what, values in (("unit", units), ("space", spaces)):
        if values[0] != values[1]:
            raise InputError(
                f"{what}: recording {first} has {values[0]} and {name} has {values[1]}. Recordings "
                "that are pooled must agree in it."
            )
    for variable in POOLED[1:]:
        if (variable in one) != (variable in other):
            raise InputError(
                f"{variable}: only one of the recordings {first} and {name} has it. Remove it from "
                "all with drop_vars, or add it to all."
            )


def _as_trials(tracks: xr.Dataset, name: str, distinct: bool) -> xr.Dataset:
    """Return the pooled variables with a dimension ``trial``, and a time that begins at 0."""
    kept = tracks[[variable for variable in POOLED if variable in tracks]]
    kept = kept.drop_vars([c for c in kept.coords if c not in kept.dims])
    if not has_trials(kept):
        kept = kept.expand_dims(trial=[name])
    elif not distinct:
        several = kept.sizes["trial"] > 1
        own = [f"{name}/{label}" if several else name for label in kept["trial"].values]
        kept = kept.assign_coords(trial=own)
    seconds = kept["time"].to_numpy()
    return kept.assign_coords(time=(seconds - seconds[0]).round(9))
