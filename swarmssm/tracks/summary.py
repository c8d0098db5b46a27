"""What a file of tracks holds, in a dozen numbers."""

import itertools
from typing import Any

import numpy as np
import xarray as xr

from swarmssm import metrics
from swarmssm.tracks.dataset import (
    Array,
    has_trials,
    observed,
    spatial_attributes,
    states_of,
    with_trials,
)
from swarmssm.tracks.jumps import find_jumps
from swarmssm.tracks.kinematics import observed_runs

__all__ = ["describe", "summarize"]


def summarize(tracks: xr.Dataset) -> dict[str, Any]:
    """Return what tracks hold.

    Parameters
    ----------
    tracks
        Tracks.

    Returns
    -------
    By name: ``trials``, ``frames`` (of the longest trial), ``seconds``, ``fps``, ``individuals``,
    ``space``, ``unit``, ``y_axis``
    (``"up"`` or ``"down"``), ``observed`` (share of individuals and frames, over each trial's own
    length), ``gaps`` (number) and ``longest_gap`` (frames), ``never_observed`` (labels),
    ``velocity`` and ``adjacency`` (whether they are there), ``edges`` (mean number an individual
    sees), ``speed`` (5, 50, 95 % quantiles, per second), ``polarization``, ``rotation``,
    ``nearest_neighbor`` (medians or means over time), ``jumps`` (steps that look like
    errors of tracking, see :mod:`swarmssm.tracks.jumps`),
    ``source_software``, ``source_file``, and ``truth`` (names of what a simulation attached).
    """
    whole = with_trials(tracks)
    seen = observed(whole).transpose("trial", "time", "individual").to_numpy()
    extents = [np.flatnonzero(trial.any(-1)) for trial in seen]
    lengths = [int(rows[-1] - rows[0] + 1) if rows.size else 0 for rows in extents]
    gaps = []
    for trial in seen:
        for column in trial.T:
            runs = observed_runs(column)
            gaps += [b[0] - a[1] for a, b in itertools.pairwise(runs)]
    states = states_of(whole)
    half = states.shape[-1] // 2
    position, velocity = states[..., :half], states[..., half:]
    speed = metrics.speeds(velocity)
    known = speed[np.isfinite(speed)]
    neighbor = metrics.nearest_neighbor_distance(position)
    present = max(int(sum(n * seen.shape[2] for n in lengths)), 1)
    labels = tracks["individual"].values
    edges = None
    if "adjacency" in whole:
        edges = float(whole["adjacency"].sum() / max(int(seen.sum()), 1))
    own = {"position", "velocity", "adjacency"}
    return {
        "trials": int(whole.sizes["trial"]) if has_trials(tracks) else 1,
        "frames": max(lengths),
        "seconds": max(lengths) / tracks.attrs["fps"],
        "fps": float(tracks.attrs["fps"]),
        "individuals": int(tracks.sizes["individual"]),
        "space": int(tracks.sizes["space"]),
        "unit": str(tracks.attrs.get("unit", "")),
        "y_axis": spatial_attributes(tracks).get("y_axis", "up"),
        "observed": float(seen.sum() / present),
        "gaps": len(gaps),
        "longest_gap": int(max(gaps, default=0)),
        "never_observed": [str(labels[i]) for i in np.flatnonzero(~seen.any(axis=(0, 1)))],
        "velocity": "velocity" in tracks,
        "adjacency": "adjacency" in tracks,
        "edges": edges,
        "speed": np.quantile(known, (0.05, 0.5, 0.95)).tolist() if known.size else None,
        "polarization": _mean(metrics.polarization(velocity)),
        "rotation": _mean(metrics.rotation(position, velocity)),
        "nearest_neighbor": _median(neighbor),
        "jumps": int(find_jumps(position).sum()),
        "source_software": str(tracks.attrs.get("source_software", "")),
        "source_file": str(tracks.attrs.get("source_file", "")),
        "truth": sorted(str(name) for name in whole.data_vars if name not in own),
    }


def describe(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return a summary as rows of words for a person: name and value."""
    unit = summary["unit"]
    length = f" {unit}" if unit else ""
    down = ", y downwards" if summary["y_axis"] == "down" else ""
    rows = [
        ("individuals", str(summary["individuals"])),
        ("trials", str(summary["trials"])),
        (
            "frames",
            f"{summary['frames']} at {summary['fps']:g} per second ({summary['seconds']:.4g} s)",
        ),
        ("space", f"{summary['space']}-dimensional, unit {unit or 'unknown'}{down}"),
        (
            "observed",
            f"{100 * summary['observed']:.1f} %; {summary['gaps']} gaps, "
            f"the longest of {summary['longest_gap']} frames",
        ),
    ]
    if summary["never_observed"]:
        rows.append(("never observed", ", ".join(summary["never_observed"])))
    if summary["speed"]:
        low, middle, high = summary["speed"]
        rows.append(("speed", f"{middle:.3g}{length}/s (5 to 95 %: {low:.3g} to {high:.3g})"))
    if summary["nearest_neighbor"] is not None:
        distance = f"{summary['nearest_neighbor']:.3g}{length} (median)"
        rows.append(("nearest neighbour", distance))
    for name in ("polarization", "rotation"):
        if summary[name] is not None:
            rows.append((name, f"{summary[name]:.2f}"))
    if summary["jumps"]:
        rows.append(("jumps", f"{summary['jumps']} steps that look like errors of tracking"))
    rows.append(("velocity", "in the file" if summary["velocity"] else "from differences"))
    graph = f"in the file, {summary['edges']:.3g} seen by each" if summary["adjacency"] else "none"
    rows.append(("graph", graph))
    if summary["truth"]:
        rows.append(("also", ", ".join(summary["truth"])))
    for name in ("source_software", "source_file"):
        if summary[name]:
            rows.append((name.replace("_", " "), summary[name]))
    return rows


def _mean(values: Array) -> float | None:
    """Return the mean of what is known."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def _median(values: Array) -> float | None:
    """Return the median of what is known."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None
