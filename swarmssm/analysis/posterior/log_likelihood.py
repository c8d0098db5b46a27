"""How probable a fit made each observed position, or window of them, at draws of its posterior."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.analysis.posterior.foresight import predict_one_step
from swarmssm.analysis.posterior.frames import same_tracks
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array
from swarmssm.tracks.splits import PARTS, Segment

__all__ = [
    "Window",
    "pointwise_log_likelihood",
    "rows_of",
    "segments_of",
    "window_log_likelihood",
    "window_sums",
    "windows_over",
]

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Window:
    """Frames ``start <= t < stop`` of the trial in a row of the tracks."""

    trial: int
    start: int
    stop: int


def pointwise_log_likelihood(
    fit: Fit, tracks: xr.Dataset, draws: int = 200, seed: int = 0
) -> xr.DataArray:
    r"""Return :math:`\log p(x_{t,i} \mid x_{1:t-1}, \theta)` of each observed position.

    Each frame is foreseen from all frames before it, of all individuals, at each draw of the
    parameters. Latent states are summed out: by the extended Kalman filter where the guide is
    ``linearized``, else as a mixture over states that the guide samples from the frames before
    (``attrs["how"]`` says which). Where weights are points there is one value, repeated.

    It is the margin of one individual: of the sum over individuals the joint density of a frame
    differs by what they have in common (:func:`window_log_likelihood` has the joint one).

    Parameters
    ----------
    fit
        A fit.
    tracks
        Any tracks of as many spatial dimensions.
    draws
        How many of the parameters.
    seed
        Seed.

    Returns
    -------
    ``(draw, trial, time, individual)``, densities of positions in the tracks' unit of length, in
    nats; NaN where nobody was seen, or a model of exact states knew no state to start from.

    Raises
    ------
    InputError
        If ``draws`` is not positive, or the tracks do not fit the model.
    """
    found = predict_one_step(fit, tracks, draws, seed)
    density = np.broadcast_to(found.density, (draws, *found.density.shape[1:]))
    source = found.prepared.tracks
    return xr.DataArray(
        density,
        dims=("draw", "trial", "time", "individual"),
        coords={"draw": np.arange(draws)}
        | {name: source[name].to_numpy() for name in ("trial", "time", "individual")},
        name="log_likelihood",
        attrs={
            "units": "nat",
            "long_name": "log-density of each position given the frames before",
            "how": found.how,
        },
    )


def window_log_likelihood(
    fit: Fit,
    tracks: xr.Dataset,
    draws: int = 200,
    window: int | None = None,
    seed: int = 0,
    *,
    part: str = "all",
) -> xr.DataArray:
    r"""Return :math:`\log p(x_{a:b} \mid x_{1:a-1}, \theta)` of windows of frames.

    The joint log-density of all positions in a window, given all frames before it. Of a whole
    trial that is its own evidence, and leaving it out is leaving out a part of the data that
    nothing else depends on. Of a window within a trial it is the window's factor of the trial's
    evidence: leaving it out takes from the posterior what the window told of the parameters, while
    later windows are still foreseen from its frames.

    Parameters
    ----------
    fit, tracks, draws, seed
        As in :func:`pointwise_log_likelihood`.
    window
        Frames in a window; the rest of a trial goes to its last one. Absent: whole trials (each
        segment of the part).
    part
        ``"train"``, ``"validation"``, ``"test"`` of the tracks that the model was fitted on, or
        ``"all"``: which frames count. Earlier ones are history all the same.

    Returns
    -------
    ``(draw, window)`` in nats, with coordinates ``trial``, ``start`` and ``stop`` (frames) and
    ``positions``, how many are scored; windows without any are left out. Where no filter says the
    joint density, individuals count as independent given the past, as ``attrs["how"]`` says.

    Raises
    ------
    InputError
        If ``draws`` or ``window`` is not positive, the part is empty or unknown, or nothing can be
        scored.
    """
    segments = segments_of(fit, tracks, part)
    found = predict_one_step(fit, tracks, draws, seed)
    scored: Mask = np.logical_or.reduce(~np.isnan(found.density), axis=0)
    labels = [str(name) for name in found.prepared.tracks["trial"].values]
    chosen = windows_over(np.asarray(scored.any(-1)), labels, segments, window)
    values = window_sums(found.joint, chosen)
    return xr.DataArray(
        np.broadcast_to(values, (draws, len(chosen))),
        dims=("draw", "window"),
        coords={
            "draw": np.arange(draws),
            "trial": ("window", [labels[w.trial] for w in chosen]),
            "start": ("window", [w.start for w in chosen]),
            "stop": ("window", [w.stop for w in chosen]),
            "positions": (
                "window",
                [int(scored[w.trial, w.start : w.stop].sum()) for w in chosen],
            ),
        },
        name="log_likelihood",
        attrs={
            "units": "nat",
            "long_name": "joint log-density of a window's positions given the frames before",
            "how": found.how,
        },
    )


def segments_of(fit: Fit, tracks: xr.Dataset, part: str) -> tuple[Segment, ...] | None:
    """Return the segments of a part, ``None`` for all frames.

    Raises
    ------
    InputError
        If the part is unknown or empty, or the tracks are not those of the fit.
    """
    if part == "all":
        return None
    if part not in PARTS:
        raise InputError(f"part: {part!r} is unknown; choose one of {', '.join(PARTS)} or all.")
    if not same_tracks(fit, tracks):
        raise InputError(
            f"part: these are not the tracks that the model was fitted on, and have no {part} "
            "part of its. Take all of them."
        )
    segments = fit.split.part(part)
    if not segments:
        raise InputError(f"part: the {part} part is empty; fit with other fractions.")
    return segments


def rows_of(labels: Sequence[str], times: int, segments: Sequence[Segment] | None) -> Mask:
    """Return which frames of which trials belong to segments, ``(trial, time)``."""
    if segments is None:
        return np.ones((len(labels), times), dtype=bool)
    rows = np.zeros((len(labels), times), dtype=bool)
    for segment in segments:
        rows[labels.index(segment.trial), segment.start : segment.stop] = True
    return rows


def windows_over(
    scored: Mask,
    labels: Sequence[str],
    segments: Sequence[Segment] | None,
    window: int | None,
) -> list[Window]:
    """Return windows that cover segments (or whole trials) once and have something to score.

    Parameters
    ----------
    scored
        ``(trial, time)``: whether a frame can be scored.
    labels
        Of the trials.
    segments
        Which frames count; ``None``, all.
    window
        Frames in a window, ``None`` for whole segments.

    Raises
    ------
    InputError
        If ``window`` is not positive, or nothing can be scored.
    """
    if window is not None and window < 1:
        raise InputError(f"window: it must be at least 1 frame, and it is {window}.")
    spans = (
        [Window(trial, 0, scored.shape[1]) for trial in range(len(labels))]
        if segments is None
        else [Window(labels.index(s.trial), s.start, s.stop) for s in segments]
    )
    chosen = []
    for span in spans:
        rows = np.flatnonzero(scored[span.trial, span.start : span.stop])
        if not rows.size:
            continue
        # Windows are of frames with somebody in them, whatever padding comes before or after.
        first, last = span.start + int(rows[0]), span.start + int(rows[-1]) + 1
        length = last - first if window is None else window
        count = max(1, (last - first) // length)
        cuts = [*(first + k * length for k in range(count)), last]
        chosen += [
            Window(span.trial, a, b)
            for a, b in itertools.pairwise(cuts)
            if scored[span.trial, a:b].any()
        ]
    if not chosen:
        raise InputError("tracks: the model foresees no position that was observed.")
    return chosen


def window_sums(joint: Array, windows: Sequence[Window]) -> Array:
    """Return the log-density of windows, ``(draw, window)``, from that of frames."""
    return np.stack([joint[:, w.trial, w.start : w.stop].sum(-1) for w in windows], -1)
