"""What a fit makes of it from one frame on, at the times of the tracks."""

import numpy as np
import xarray as xr

from swarmssm.analysis.plots.scenes.scene import one_trial, row_at
from swarmssm.analysis.posterior.frames import same_tracks
from swarmssm.errors import InputError, WorkError
from swarmssm.graphs import add_adjacency
from swarmssm.inference import Fit
from swarmssm.tracks import MAX_COORDINATE, make_tracks, validate_tracks, with_trials

__all__ = ["free_run", "with_free_run"]

#: Probability from which on an edge is drawn.
THRESHOLD = 0.5
#: Frames of history from which the first velocity and the first graph are taken.
BEFORE = 50
#: Frames of history at least, where a trial is in the test part from its first frame on.
MARGIN = 10


def free_run(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    trial: str | None = None,
    start: float | None = None,
    steps: int | None = None,
    noise: bool = True,
    seed: int = 0,
    edges: str = "decoder",
) -> xr.Dataset:
    """Let the learned rule run freely from a frame of the tracks, knowing what went before.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Tracks.
    trial
        Label; default the first (of the test part, where ``start`` is absent and there is one).
    start
        Seconds: the run goes on from the last frame that is not later. Default: where the test part
        begins, if these are the tracks of the fit, else in the middle.
    steps
        Number of steps; default as many as are recorded.
    noise
        Whether the noise of the model is drawn; else everything takes its mean.
    seed
        Of the draws.
    edges
        Where later graphs come from, see :meth:`swarmssm.inference.Fit.predictor`.

    Returns
    -------
    Tracks of one trial with ``steps + 1`` frames at the times of the recording (and beyond its
    end). The first is the observed one; who was just out of sight there joins in the second.
    ``attrs`` say ``free_run_of`` which model and ``free_run_start`` in seconds.

    Raises
    ------
    InputError
        If a label or a time is not in the tracks, there are fewer than two frames up to it,
        ``steps`` is not positive, or the tracks do not fit the model.
    WorkError
        If the run leaves all bounds.
    """
    if steps is not None and steps < 1:
        raise InputError(f"steps: it must be at least 1, and it is {steps}.")
    tracks = with_trials(validate_tracks(tracks))
    if start is None:
        trial, row = _usual_start(fit, tracks, trial)
        tracks = one_trial(tracks, trial, "tracks")
    else:
        tracks = one_trial(tracks, trial, "tracks")
        row = row_at(tracks, start)
    stamps = tracks["time"].to_numpy()
    if row < 1:
        raise InputError(
            f"start: a free run needs two frames to go on from, and {stamps[row]:g} s is the "
            f"first. Start at {stamps[min(1, len(stamps) - 1)]:g} s or later."
        )
    if steps is None:
        seen = np.flatnonzero(tracks["position"].notnull().any(("trial", "space", "individual")))
        steps = int(seen[-1]) - row
        if steps < 1:
            raise InputError(
                f"start: nobody is tracked after {stamps[row]:g} s. Start before, or give steps."
            )
    history = tracks.isel(time=slice(0, row + 1))
    future = fit.forecast(history, steps, draws=int(noise), seed=seed, edges=edges)
    if "draw" in future.dims:
        future = future.isel(draw=0)
    if abs(float(future["history_end"][0]) - stamps[row]) > 0.5 / float(tracks.attrs["fps"]):
        raise InputError(
            f"start: nobody is tracked at {stamps[row]:g} s. Start at "
            f"{float(future['history_end'][0]):g} s."
        )
    now = fit.prepare(history.isel(time=slice(-BEFORE, None)))
    half = now.states.shape[-1] // 2
    # The first velocity is but drawn: what the model starts from, it knows better.
    paths = {}
    for name, columns in (("position", slice(0, half)), ("velocity", slice(half, None))):
        later = future[name].transpose("trial", "time", "individual", "space").to_numpy()
        paths[name] = np.concatenate([now.states[:, -1:, :, columns], later], axis=1)
        if np.isinf(later).any() or (np.abs(later[~np.isnan(later)]) > MAX_COORDINATE).any():
            raise WorkError("free run: it left all bounds; take fewer steps.")
    pairs = ("trial", "time", "individual", "neighbor")
    probability = future["edge_probability"].transpose(*pairs).to_numpy()
    graph = np.nan_to_num(probability) >= THRESHOLD
    return make_tracks(
        paths["position"],
        velocity=paths["velocity"],
        adjacency=np.concatenate([now.adjacency.numpy()[:, -1:], graph], axis=1),
        time=stamps[row] + np.arange(steps + 1) / float(tracks.attrs["fps"]),
        individuals=[str(name) for name in tracks["individual"].values],
        trials=[str(tracks["trial"].values[0])],
        unit=tracks.attrs.get("unit", ""),
        source_software="swarmssm",
        attrs={"free_run_of": fit.settings.model, "free_run_start": float(stamps[row])},
    )


def with_free_run(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    trial: str | None = None,
    start: float | None = None,
    steps: int | None = None,
    noise: bool = True,
    seed: int = 0,
    edges: str = "decoder",
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return what was recorded from a frame on, with its graph, and a free run beside it.

    Parameters
    ----------
    fit, tracks, trial, start, steps, noise, seed, edges
        As for :func:`free_run`.

    Returns
    -------
    The tracks of that trial, a few frames before the run and as many as it has; their graph, where
    they carry none, is that by which the fit saw them. And the free run.

    Raises
    ------
    InputError, WorkError
        As :func:`free_run`.
    """
    run = free_run(
        fit,
        tracks,
        trial=trial,
        start=start,
        steps=steps,
        noise=noise,
        seed=seed,
        edges=edges,
    )
    own = one_trial(with_trials(validate_tracks(tracks)), str(run["trial"].values[0]), "tracks")
    row = row_at(own, run.attrs["free_run_start"])
    own = own.isel(time=slice(max(0, row - BEFORE), row + run.sizes["time"]))
    rule = fit.preparation.rule
    if "adjacency" not in own and rule is not None:
        own = add_adjacency(own, rule)
    return own, run


def _usual_start(fit: Fit, tracks: xr.Dataset, trial: str | None) -> tuple[str, int]:
    """Return trial and row at which the test part begins, else the middle of the first trial."""
    labels = [str(label) for label in tracks["trial"].values]
    if same_tracks(fit, tracks):
        for segment in fit.split.test:
            if trial in (None, segment.trial) and segment.trial in labels:
                return segment.trial, max(segment.start, MARGIN)
    own = one_trial(tracks, trial, "tracks")
    seen = np.flatnonzero(own["position"].notnull().any(("trial", "space", "individual")))
    middle = int(seen[len(seen) // 2]) if seen.size else 0
    return str(own["trial"].values[0]), middle
