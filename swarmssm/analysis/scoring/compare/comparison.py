"""Which of several fits is best, by how much, and how surely."""

from collections.abc import Callable, Mapping, Sequence

import xarray as xr

from swarmssm.analysis.scoring.compare.fairness import (
    check_future,
    check_same_scales,
    held_out_frames,
    seen_frames,
)
from swarmssm.analysis.scoring.compare.held_out import by_forecasts
from swarmssm.analysis.scoring.compare.left_out import by_windows
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import validate_tracks

__all__ = ["METHODS", "compare"]

METHODS = ("held-out", "lfo", "loo")
HORIZONS = (1, 2, 5, 10, 20)


def compare(
    fits: Mapping[str, Fit],
    tracks: xr.Dataset,
    *,
    method: str = "held-out",
    part: str | None = None,
    horizons: Sequence[int] = HORIZONS,
    origins: int = 40,
    draws: int | None = None,
    window: int | None = None,
    allow_seen: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> xr.Dataset:
    r"""Rank fits by how probable they make what they have not seen, on the same frames.

    * ``"held-out"``: forecasts from many held-out frames
      (:func:`swarmssm.analysis.scoring.backtest`), by the log score of an individual's position,
      averaged over the horizons; staying put, constant velocity and, of simulated tracks, the true
      rule stand beside the fits. The question of a forecaster, fair to any kind of model. With the
      standard errors of a moving-block bootstrap.
    * ``"lfo"``: leave-future-out. The held-out frames in the order of time, window by window: each
      by the joint log-density that the frames before give it, one step ahead of another, and by
      parameters that have learned from the windows before (PSIS-LFO). Exact refits are too dear:
      where the weights can no longer be believed, the parameters stop learning there.
    * ``"loo"``: leave-one-out of trials or windows of the *training* frames, by weighting the
      draws of the posterior (PSIS-LOO). Uses all data, and needs fits whose every parameter has a
      posterior (``boids``, ``kernel``, ``linear``), all trained on the same frames.

    Held-out frames of a fit are its test part (else its validation part) of its own tracks, and all
    of any others. A fit that was trained on frames to be scored by ``"held-out"`` or ``"lfo"`` is
    refused, unless ``allow_seen`` says that this is meant. For ``"loo"`` the very point is that
    the frames were seen, so that the reverse is refused: a fit that was not trained on them, or on
    others too.

    Parameters
    ----------
    fits
        Name -> fit, at least two.
    tracks
        What they are judged on.
    method
        See above.
    part
        Of ``"held-out"`` and ``"lfo"``: see :func:`swarmssm.analysis.scoring.backtest`.
    horizons, origins
        Of ``"held-out"``, likewise.
    draws
        Sampled futures of each origin, or of the parameters. Absent: 100 futures, 400 parameters.
    window
        Frames in a window of ``"loo"`` and ``"lfo"``. Absent: whole trials if there are at least
        ten, else about thirty windows of at least ten frames.
    allow_seen
        See above.
    seed
        Of all draws.
    progress
        Called with what is being done, in words.

    Returns
    -------
    Dataset over ``model``, best first:

    - ``score`` and its ``se``: of ``"held-out"`` the mean log score in nats per coordinate, else
      the sum of the windows' expected log predictive densities in nats (elpd); higher is better;
    - ``difference``: how much worse than the best, and ``difference_se``, its standard error from
      pairs on the same origins or windows; NaN where it cannot be told;
    - ``rank``, from 1; 0 of the true rule, which is no rival; ``fitted``: whether it is a fit;
    - of ``"held-out"``: ``log_score (model, horizon)``; else ``elpd (model, window)``,
      ``pareto_k (model, window)``, ``believed (model, window)`` and ``effective_parameters
      (model)`` (of ``"loo"``).

    ``attrs["notes"]`` is what a reader has to know, the Pareto k in words among it.

    Raises
    ------
    InputError
        If there are fewer than two fits, an argument is unknown, out of range or of no use to the
        method, or the fits cannot be compared on these tracks.
    """
    tracks = validate_tracks(tracks)
    _check(fits, method, part, window, allow_seen, draws)
    check_same_scales(fits, tracks)
    if method == "held-out":
        return by_forecasts(
            fits, tracks, part, horizons, origins, draws or 100, allow_seen, seed, progress
        )
    notes: list[str] = []
    if method == "loo":
        segments, name = seen_frames(fits, tracks), "train"
    else:
        frames = held_out_frames(fits, tracks, part, allow_seen=allow_seen)
        if not allow_seen:
            check_future(fits, tracks, frames)
        segments, name, notes = frames.segments, frames.part, [*frames.notes]
    return by_windows(
        fits, tracks, method, segments, name, draws or 400, window, seed, progress, notes
    )


def _check(
    fits: Mapping[str, Fit],
    method: str,
    part: str | None,
    window: int | None,
    allow_seen: bool,
    draws: int | None,
) -> None:
    """Refuse arguments that say nothing."""
    if method not in METHODS:
        raise InputError(f"method: {method!r} is unknown; choose one of {', '.join(METHODS)}.")
    if len(fits) < 2:
        raise InputError("fits: at least two are needed to be compared.")
    if method == "loo" and part is not None:
        raise InputError("part: leave-one-out is of the training part; leave the part away.")
    if method == "loo" and allow_seen:
        raise InputError(
            "allow_seen: leave-one-out is of frames that the fits have seen; leave it away."
        )
    if method == "held-out" and window is not None:
        raise InputError("window: method held-out has no windows; it has horizons and origins.")
    if draws is not None and draws < 100 and method != "held-out":
        raise InputError(
            f"draws: weights of fewer than 100 draws say nothing, and these are {draws}."
        )
