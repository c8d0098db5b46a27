"""What every baseline offers: one small interface, on arrays and on tracks."""

from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array, states_of, with_trials

__all__ = ["Baseline"]


class Baseline:
    """A forecast that needs no graph network.

    A subclass writes :meth:`step`; if it learns something it also overrides :meth:`learn`. States
    are in the tracks' own units, ordered ``[x, y, vx, vy]``, NaN where unknown: an individual that
    is not known throughout the frames that a step looks at is not forecast.

    Attributes
    ----------
    name, title
        For the command line and for tables.
    order
        Number of past frames that a step looks at.
    residual_covariance
        Covariance of one-step errors on the tracks it was fitted to, ``(state, state)``; ``None``
        before :meth:`fit`.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    order: ClassVar[int] = 1

    def __init__(self) -> None:
        self.residual_covariance: Array | None = None

    def step(self, window: Array, fps: float) -> Array:
        """Return the expected next state.

        Parameters
        ----------
        window
            The last :attr:`order` frames, ``(..., order, individual, state)``.
        fps
            Frames per second.

        Returns
        -------
        Shape ``(..., individual, state)``.
        """
        raise TypeError(f"{type(self).__name__} must define step(window, fps)")

    def learn(self, states: Array, fps: float) -> None:
        """Learn what :meth:`step` needs from states ``(trial, time, individual, state)``."""

    def fit(self, tracks: xr.Dataset) -> Self:
        """Learn from tracks, and measure how far the steps are off.

        Parameters
        ----------
        tracks
            The training part. Where it carries no velocity, differences take its place.

        Returns
        -------
        The baseline itself.

        Raises
        ------
        InputError
            If there are not two steps of anybody to learn from.
        """
        states, fps = states_of(tracks), float(tracks.attrs["fps"])
        self.learn(states, fps)
        errors = states - self.one_step(states, fps)
        seen = errors[known(errors)]
        if len(seen) < 2:
            raise InputError("tracks: there are not two steps to learn from.")
        self.residual_covariance = np.cov(seen, rowvar=False)
        return self

    def one_step(self, states: Array, fps: float) -> Array:
        """Predict each frame from those before it.

        Parameters
        ----------
        states
            Shape ``(..., time, individual, state)``.
        fps
            Frames per second.

        Returns
        -------
        Same shape; NaN in the first :attr:`order` frames.
        """
        predicted = np.full(states.shape, np.nan)
        num_times = states.shape[-3]
        if num_times > self.order:
            windows = np.lib.stride_tricks.sliding_window_view(states, self.order, axis=-3)
            windows = np.moveaxis(windows, -1, -3)[..., :-1, :, :, :]
            predicted[..., self.order :, :, :] = self.step(windows, fps)
        return predicted

    def predict(
        self,
        states: Array,
        horizon: int,
        fps: float,
        generator: np.random.Generator | None = None,
    ) -> Array:
        """Go on from the last frame.

        Parameters
        ----------
        states
            History ``(..., time, individual, state)`` of at least :attr:`order` frames, in the
            tracks' units.
        horizon
            Number of steps.
        fps
            Frames per second.
        generator
            With it, errors like those that :meth:`fit` saw are drawn at each step; without it
            every step is the expected one.

        Returns
        -------
        Shape ``(..., horizon, individual, state)``.

        Raises
        ------
        InputError
            If ``horizon`` is not positive, the history is too short, or draws are asked of a
            baseline that was not fitted.
        """
        if horizon < 1:
            raise InputError(f"horizon: it must be at least 1, and it is {horizon}.")
        if states.shape[-3] < self.order:
            raise InputError(
                f"history: {self.name} looks at {self.order} frames, and there are "
                f"{states.shape[-3]}."
            )
        root = None if generator is None else self._noise_root()
        window = states[..., -self.order :, :, :]
        path = np.empty((*states.shape[:-3], horizon, *states.shape[-2:]))
        for ahead in range(horizon):
            following = self.step(window, fps)
            if generator is not None and root is not None:
                following = following + generator.standard_normal(following.shape) @ root.T
            path[..., ahead, :, :] = following
            newest = following[..., None, :, :]
            window = np.concatenate([window[..., 1:, :, :], newest], axis=-3)
        return path

    def forecast(
        self,
        history: xr.Dataset,
        horizon: int,
        draws: int = 0,
        seed: int | np.random.Generator = 0,
    ) -> xr.Dataset:
        """Forecast what comes after the last frame of the history, which is all it knows.

        Parameters
        ----------
        history
            Tracks. Each trial goes on from its last frame with anybody in it; who is absent there
            stays NaN.
        horizon
            Number of steps.
        draws
            Number of sampled futures, for which :meth:`fit` must have been called; 0 for the
            expected one.
        seed
            Seed or generator.

        Returns
        -------
        Dataset with ``position`` and ``velocity`` ``([draw,] trial, time, space, individual)``,
        labelled as that of :meth:`swarmssm.inference.Fit.forecast`.

        Raises
        ------
        InputError
            As :meth:`predict`, or if in one trial nobody's velocity is known in any frame.
        """
        if draws < 0:
            raise InputError(f"draws: it must be at least 0, and it is {draws}.")
        source = with_trials(history)
        states, fps = states_of(source), float(source.attrs["fps"])
        last = _last_frames(states)
        if int(last.min()) + 1 < self.order:
            raise InputError(
                f"history: {self.name} looks at {self.order} frames, and a trial ends after "
                f"{int(last.min()) + 1}."
            )
        rows = last[:, None] + np.arange(1 - self.order, 1)
        recent = states[np.arange(len(last))[:, None], rows]
        generator = np.random.default_rng(seed) if draws else None
        start = np.broadcast_to(recent, (draws, *recent.shape)) if draws else recent
        path = self.predict(start, horizon, fps, generator)
        return _labelled(path, source, last, bool(draws))

    def _noise_root(self) -> Array:
        """Return a root of the residual covariance, which may be singular."""
        if self.residual_covariance is None:
            raise InputError(f"{self.name}: fit it first; its draws need to know its errors.")
        values, vectors = np.linalg.eigh(self.residual_covariance)
        root: Array = vectors * np.sqrt(values.clip(min=0.0))
        return root


def _last_frames(states: Array) -> npt.NDArray[np.int64]:
    """Return each trial's last row in which anybody's state is known."""
    anybody = np.logical_or.reduce(known(states), axis=-1)
    if not anybody.any(axis=-1).all():
        raise InputError("tracks: in one trial nobody is seen in two consecutive frames.")
    last: npt.NDArray[np.int64] = anybody.shape[1] - 1 - np.argmax(anybody[:, ::-1], axis=1)
    return last


def _labelled(
    path: Array, source: xr.Dataset, last: npt.NDArray[np.int64], drawn: bool
) -> xr.Dataset:
    """Give forecast states ``([draw,] trial, step, individual, state)`` the history's labels."""
    half = path.shape[-1] // 2
    dims = (*("draw",) * drawn, "trial", "time", "space", "individual")
    ends = source["time"].to_numpy()[last]
    common = len(set(ends.tolist())) == 1
    ahead = np.arange(1, path.shape[-3] + 1) / source.attrs["fps"]
    coords: dict[str, Any] = {
        name: source[name].to_numpy() for name in ("trial", "space", "individual")
    }
    coords["time"] = (ends[0] if common else 0.0) + ahead
    coords["history_end"] = ("trial", ends)
    if drawn:
        coords["draw"] = np.arange(path.shape[0])
    attrs = {key: source.attrs[key] for key in ("fps", "time_unit", "unit")}
    return xr.Dataset(
        {
            "position": (dims, np.swapaxes(path[..., :half], -1, -2)),
            "velocity": (dims, np.swapaxes(path[..., half:], -1, -2)),
        },
        coords,
        {**attrs, "horizon": path.shape[-3]},
    )
