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
#: A variance so many times that of what is seen of it is that of something unknown.
UNKNOWN = 1e6


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
    causal: bool = False,
) -> Array:
    r"""Smooth each track with filterpy's Kalman filter and smoother (Rauch, Tung, Striebel 1965).

    The state of each axis is ``[p, v]``, moved by a white acceleration that is constant within a
    frame and has standard deviation ``process_noise`` *q*; ``p`` is seen with standard deviation
    ``observation_noise`` *r*. A run of consecutive observed frames is smoothed on its own, so that
    nothing is carried across a gap. It begins at its first position, with the difference to its
    second as velocity, whose variance is a million times that of such a difference,
    :math:`2 r^2 / dt^2 + q^2 dt^2 / 4`: next to nothing is known of it beforehand (two-point
    differencing, Bar-Shalom et al. 2001, section 5.5.3).

    All runs have the same covariances and gains, which filterpy therefore computes once.

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
    causal
        Whether each frame's state is that of the filter, which knows no later frame. It is unknown
        in the first frame of a run.

    Returns
    -------
    Shape ``(..., time, individual, 2 * space)``: smoothed positions and velocities, NaN where an
    individual was not tracked, and in runs of a single frame.

    Raises
    ------
    InputError
        If a noise is not positive.

    References
    ----------
    Y. Bar-Shalom, X.-R. Li and T. Kirubarajan (2001), Estimation with Applications to Tracking and
    Navigation, Wiley.
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
    times, members, space = position.shape[-3:]
    tracks: Array = position.reshape(-1, times, members, space)
    tracks = tracks.swapaxes(1, 2).reshape(-1, times, space)
    present = np.logical_and.reduce(np.isfinite(tracks), axis=-1)
    runs = np.array(
        [(k, *run) for k, row in enumerate(present) for run in observed_runs(row)], dtype=np.int64
    ).reshape(-1, 3)
    runs = runs[runs[:, 2] - runs[:, 1] > 1]
    runs = runs[np.argsort(runs[:, 1] - runs[:, 2], kind="stable")]
    out: Array = np.full((*tracks.shape[:2], 2 * space), np.nan)
    if len(runs):
        model = _ConstantVelocity(fps, process_noise, observation_noise)
        model.prepare(int(runs[0, 2] - runs[0, 1]))
    while len(runs):
        # Runs of about one length go together; the shorter ones are padded at their ends.
        longest = int(runs[0, 2] - runs[0, 1])
        size = max(1, GROUP_SIZE // (6 * space * longest))
        (owner, start, stop), runs = runs[:size].T, runs[size:]
        row, age = np.nonzero(np.arange(longest) < (stop - start)[:, None])
        seen = np.full((longest, len(owner), space), np.nan)
        seen[age, row] = tracks[owner[row], start[row] + age]
        states = model.smooth(seen, causal=causal)
        out[owner[row], start[row] + age] = states[age, row]
    if causal:
        out[:, 1:][~present[:, :-1]] = np.nan
        out[:, :1] = np.nan
    whole = out.reshape(-1, members, times, 2 * space).swapaxes(1, 2)
    return whole.reshape(*position.shape[:-1], 2 * space)


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


class _ConstantVelocity:
    """Filter and smoother of many runs at once, with the gains that filterpy finds for one.

    Covariances depend on no observation, so that those of a run are a function of its age alone.
    """

    def __init__(self, fps: float, process_noise: float, observation_noise: float) -> None:
        # Imported where it runs: it brings scipy.stats.
        from filterpy.common import Q_discrete_white_noise
        from filterpy.kalman import KalmanFilter

        self.fps = fps
        self.filter = KalmanFilter(dim_x=2, dim_z=1)
        self.filter.F = np.array([[1.0, 1.0 / fps], [0.0, 1.0]])
        self.filter.H = np.array([[1.0, 0.0]])
        self.filter.R = np.array([[observation_noise**2]])
        self.filter.Q = Q_discrete_white_noise(2, dt=1.0 / fps, var=process_noise**2)
        difference = 2.0 * (observation_noise * fps) ** 2 + 0.25 * (process_noise / fps) ** 2
        self.filter.P = np.diag([observation_noise**2, UNKNOWN * difference])

    def prepare(self, longest: int) -> None:
        """Compute gains and covariances at each age; they settle, and then are all the same."""
        gains, covariances = [np.zeros((2, 1))], [self.filter.P.copy()]
        for _ in range(1, longest):
            self.filter.predict()
            self.filter.update(0.0)
            gains.append(self.filter.K.copy())
            covariances.append(self.filter.P.copy())
            if np.allclose(covariances[-1], covariances[-2], rtol=1e-14, atol=0.0):
                break
        left = longest - len(gains)
        self.gains = np.stack(gains + gains[-1:] * left)
        self.covariances = np.stack(covariances + covariances[-1:] * left)

    def smooth(self, seen: Array, *, causal: bool) -> Array:
        """Return states ``(age, run, 2 * space)`` of positions ``(age, run, space)``.

        NaN at the ends stands for ages that a run does not reach.
        """
        from filterpy.kalman import rts_smoother

        longest, count, space = seen.shape
        columns = seen.reshape(longest, -1)
        states = np.empty((longest, 2, columns.shape[1]))
        states[0] = columns[0], (columns[1] - columns[0]) * self.fps
        for age in range(1, longest):
            ahead = self.filter.F @ states[age - 1]
            # Beyond its end a run goes on as expected, which tells the smoother nothing.
            surprise = np.nan_to_num(columns[age] - ahead[0])
            states[age] = ahead + self.gains[age] * surprise
        if not causal:
            states = rts_smoother(
                states,
                self.covariances[:longest],
                np.broadcast_to(self.filter.F, (longest, 2, 2)),
                np.broadcast_to(self.filter.Q, (longest, 2, 2)),
            )[0]
        by_run = states.reshape(longest, 2, count, space)
        return np.concatenate([by_run[:, 0], by_run[:, 1]], axis=-1)
