"""Velocities from positions: plain differences, or a constant-velocity Kalman smoother."""

import numpy as np
import numpy.typing as npt
import scipy
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks.dataset import Array, stepwise_velocity

__all__ = ["add_velocity", "estimate_noise", "observed_runs", "smooth_positions"]

METHODS = ("difference", "kalman")
#: Tracks are smoothed in groups that need about this many numbers of working memory.
GROUP_SIZE = 2**26


def add_velocity(
    tracks: xr.Dataset,
    method: str = "difference",
    *,
    process_noise: float | None = None,
    observation_noise: float | None = None,
) -> xr.Dataset:
    """Return the tracks with a ``velocity``; one that is there is replaced.

    Parameters
    ----------
    tracks
        Tracks. Split them first (``take``): the smoother looks ahead, and
        would otherwise carry the test part into the training part.
    method
        ``"difference"``: backward difference across consecutive observed frames
        (:func:`swarmssm.tracks.stepwise_velocity`). ``"kalman"``: constant-velocity Kalman
        smoother (:func:`smooth_positions`) for noisy tracks; positions stay as tracked.
    process_noise, observation_noise
        Of the smoother, see :func:`smooth_positions`.

    Raises
    ------
    InputError
        If ``method`` is unknown, or a noise is not positive.
    """
    dims = tracks["position"].dims
    position = np.swapaxes(tracks["position"].to_numpy(), -2, -1)
    if method == "difference":
        velocity = stepwise_velocity(position, tracks.attrs["fps"])
    elif method == "kalman":
        smoothed = smooth_positions(
            position,
            tracks.attrs["fps"],
            process_noise=process_noise,
            observation_noise=observation_noise,
        )
        velocity = smoothed[..., position.shape[-1] :]
    else:
        raise InputError(f"method: {method!r} is unknown; choose one of {', '.join(METHODS)}.")
    unit = tracks.attrs.get("unit", "")
    return tracks.assign(
        velocity=(dims, np.swapaxes(velocity, -1, -2), {"units": f"{unit}/s".lstrip("/")})
    )


def smooth_positions(
    position: Array,
    fps: float,
    *,
    process_noise: float | None = None,
    observation_noise: float | None = None,
) -> Array:
    """Smooth each track with a constant-velocity Kalman smoother (Rauch, Tung, Striebel 1965).

    The state of each axis is ``[p, v]``, moved by a white acceleration that is constant within a
    frame and has standard deviation ``process_noise``; ``p`` is seen with standard deviation
    ``observation_noise``. Before a run begins nothing is known of ``p``, and ``v`` is 0 with twice
    the root mean square of the run's own steps as its standard deviation (or of the observation
    noise per frame, if that is larger). Each run of consecutive observed frames is smoothed on its
    own, so that nothing is carried across a gap.

    Parameters
    ----------
    position
        Shape ``(..., time, individual, space)``, NaN where not tracked.
    fps
        Frames per second.
    process_noise
        In length unit per second squared; estimated by :func:`estimate_noise` if absent.
    observation_noise
        In length unit; likewise.

    Returns
    -------
    Shape ``(..., time, individual, 2 * space)``: smoothed positions and velocities, NaN where an
    individual was not tracked, and in runs of a single frame.

    Raises
    ------
    InputError
        If a noise is not positive.
    """
    for name, value in (
        ("process_noise", process_noise),
        ("observation_noise", observation_noise),
    ):
        if value is not None and not 0 < value < np.inf:
            raise InputError(f"{name}: it must be a positive number, not {value}.")
    if process_noise is None or observation_noise is None:
        estimated = estimate_noise(position, fps)
        process_noise = estimated[0] if process_noise is None else process_noise
        observation_noise = estimated[1] if observation_noise is None else observation_noise
    num_times, num_members, num_space = position.shape[-3:]
    trials = position.reshape(-1, num_times, num_members, num_space)
    out = np.full((*trials.shape[:-1], 2 * num_space), np.nan)
    group = max(1, GROUP_SIZE // (num_times * (2 * num_space + 4) or 1))
    for trial, target in zip(trials, out, strict=True):
        for first in range(0, num_members, group):
            members = slice(first, first + group)
            target[:, members] = _smooth(
                np.ascontiguousarray(trial[:, members]), fps, process_noise, observation_noise
            )
    return out.reshape(*position.shape[:-1], 2 * num_space)


def observed_runs(present: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return ``(start, stop)`` of each run of true values of a one-dimensional array."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], present.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def estimate_noise(position: Array, fps: float) -> tuple[float, float]:
    """Estimate process and observation noise from the autocovariance of second differences.

    Under the model of :func:`smooth_positions`, ``p(t+1) - 2 p(t) + p(t-1)`` has autocovariance
    ``s/2 + 6 r, s/4 - 4 r, r`` at lags 0, 1, 2, where ``s = dt^4 q^2`` and ``r`` is the squared
    observation noise. The three are solved for ``s, r >= 0`` by least squares.

    Returns
    -------
    ``process_noise`` (length unit per second squared) and ``observation_noise`` (length unit),
    both positive: at least a millionth of the mean step (per frame squared), so that a smoother
    stays regular. Both need runs of at least four observed frames.
    """
    second = np.diff(position, n=2, axis=-3)
    design, covariance = [], []
    for lag, row in enumerate(([0.5, 6.0], [0.25, -4.0], [0.0, 1.0])):
        early = second[..., : max(0, second.shape[-3] - lag), :, :]
        product = early * second[..., lag:, :, :]
        known = np.isfinite(product)
        # Where all runs are short a lag may not be there at all: it then says nothing.
        if known.any():
            design.append(row)
            covariance.append(product[known].mean())
    s, r = scipy.optimize.nnls(np.array(design), np.array(covariance))[0] if design else (0.0, 0.0)
    steps = np.abs(np.diff(position, axis=-3))
    known = np.isfinite(steps)
    smallest = 1e-6 * (float(steps[known].mean()) if known.any() else 1.0) or 1e-12
    return max(float(np.sqrt(s)), smallest) * fps**2, max(float(np.sqrt(r)), smallest)


def _smooth(track: Array, fps: float, process_noise: float, observation_noise: float) -> Array:
    """Smooth all individuals of one trial side by side; the axes share their covariances.

    Covariances of an axis are ``pp, pv, vv`` and their determinant ``det``, which is carried along
    because ``pp * vv - pv**2`` would lose its digits where the noise is small beside the motion.
    """
    dt, r = 1.0 / fps, observation_noise**2
    # One acceleration a moves the state by g * a.
    gp, gv = 0.5 * dt**2, dt
    qpp, qpv, qvv = (process_noise**2 * product for product in (gp * gp, gp * gv, gv * gv))
    present: npt.NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(track), axis=-1)
    begins = present.copy()
    begins[1:] &= ~present[:-1]
    follows = present & ~begins
    first_variance = _first_velocity_variance(track, follows, begins, fps, observation_noise)
    num_times, num_members, num_space = track.shape
    out = np.full((num_times, num_members, 2 * num_space), np.nan)
    if not num_times:
        return out
    predicted = np.full_like(out, np.nan)
    covariance = np.full((num_times, 4, num_members), np.nan)
    pp = np.full(num_members, r)
    pv, vv, det = np.zeros((3, num_members))
    state = np.full((num_members, 2 * num_space), np.nan)
    for t in range(num_times):
        det = det + (pp + 2 * dt * pv + dt**2 * vv) * qvv + vv * qpp - 2 * (pv + dt * vv) * qpv
        pp = pp + 2 * dt * pv + dt**2 * vv + qpp
        pv = pv + dt * vv + qpv
        vv = vv + qvv
        covariance[t] = pp, pv, vv, det
        state[:, :num_space] += dt * state[:, num_space:]
        predicted[t] = state
        total = pp + r
        surprise = track[t] - state[:, :num_space]
        state[:, :num_space] += (pp / total)[:, None] * surprise
        state[:, num_space:] += (pv / total)[:, None] * surprise
        pp, pv, vv, det = pp * r / total, pv * r / total, (det + vv * r) / total, det * r / total
        begin = begins[t]
        if begin.any():
            state[begin, :num_space] = track[t, begin]
            state[begin, num_space:] = 0.0
            pp = np.where(begin, r, pp)
            pv = np.where(begin, 0.0, pv)
            vv = np.where(begin, first_variance[t], vv)
            det = np.where(begin, r * first_variance[t], det)
        out[t] = state
    # Backwards, the smoothed acceleration of each frame is undone: with Q = g g' this is the gain
    # of Rauch, Tung and Striebel, and needs no inverse of a matrix.
    for t in range(num_times - 2, -1, -1):
        pp, pv, vv, det = covariance[t + 1][..., None]
        wrong = out[t + 1] - predicted[t + 1]
        to_p, to_v = gp * vv - gv * pv, gv * pp - gp * pv
        acceleration = to_p * wrong[:, :num_space] + to_v * wrong[:, num_space:]
        acceleration *= process_noise**2 / det
        velocity = out[t + 1, :, num_space:] - gv * acceleration
        place = out[t + 1, :, :num_space] - gp * acceleration - dt * velocity
        joined = follows[t + 1][:, None]
        np.copyto(out[t, :, :num_space], place, where=joined)
        np.copyto(out[t, :, num_space:], velocity, where=joined)
    alone = begins.copy()
    alone[:-1] &= ~follows[1:]
    out[~present | alone] = np.nan
    return out


def _first_velocity_variance(
    track: Array,
    follows: npt.NDArray[np.bool_],
    begins: npt.NDArray[np.bool_],
    fps: float,
    observation_noise: float,
) -> Array:
    """Return, where a run begins, the variance of its first velocity: four mean squared steps."""
    steps = np.zeros(track.shape[:2])
    steps[1:] = ((np.diff(track, axis=0) * fps) ** 2).mean(-1)
    # Runs are numbered along each individual's own time, one individual after the other.
    run = np.cumsum(begins.T.reshape(-1)) - 1
    inside = follows.T.reshape(-1)
    count = int(begins.sum())
    sums = np.bincount(run[inside], steps.T.reshape(-1)[inside], count)
    lengths = np.bincount(run[inside], minlength=count)
    mean = sums / np.maximum(lengths, 1)
    variance = np.zeros(track.shape[:2])
    variance.T[begins.T] = 4.0 * np.maximum(mean, (observation_noise * fps) ** 2)
    return variance
