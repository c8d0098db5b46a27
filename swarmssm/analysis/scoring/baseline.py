"""What every baseline offers: one small interface, on arrays and on tracks."""

import time
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array, states_of, with_trials

__all__ = ["Baseline", "Training", "histories"]

#: Origins from which the errors of a baseline are measured, and individuals at all of them.
ERROR_ORIGINS = 2000
ERROR_FORECASTS = 20_000


@dataclass(frozen=True)
class Training:
    """The terms on which all baselines learn, so that none has more than another.

    Attributes
    ----------
    validation
        States ``(trial, time, individual, state)`` that tell when to stop, in the tracks' units;
        ``None``: there are none.
    graph
        Who sees whom, for methods that do not find it out themselves; ``None``: everybody sees
        everybody.
    seconds
        Processor time after which learning ends with the best so far; ``None``: the method's own
        number of epochs.
    seed
        Of weights, batches and draws.
    """

    validation: Array | None = None
    graph: GraphRule | None = None
    seconds: float | None = None
    seed: int = 0
    began: float = field(default_factory=time.process_time)

    @property
    def spent(self) -> float:
        """Processor seconds since the beginning."""
        return time.process_time() - self.began

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.seconds is not None and self.spent >= self.seconds

    @property
    def progress(self) -> float:
        """Share of the time that is gone, from 0 to 1; 0 where there is no limit."""
        return 0.0 if self.seconds is None else min(1.0, self.spent / self.seconds)


class Baseline:
    """A method to compare a model with: it learns from states, and forecasts states.

    A subclass writes :meth:`step`; if it learns something it also overrides :meth:`learn`, and if
    it remembers more than a window of states, :meth:`one_step` and :meth:`predict`. States are in
    the tracks' own units, ordered ``[x, y, vx, vy]``, NaN where unknown. Everybody whose state is
    known in the last frame is forecast, whatever gaps there are before it; nobody else is.

    Attributes
    ----------
    name, title
        For the command line and for tables.
    paper
        Where the method comes from.
    knows_true_form
        Whether it is an oracle: it is given what others have to find, such as the true forms of
        the forces.
    is_random
        Whether what it learns depends on the seed.
    order
        Number of past frames that a step looks at, the present one included.
    residual_covariance
        Covariance of one-step errors, ``(state, state)``, on the validation part if there was one,
        else on the tracks it was fitted to; ``None`` before :meth:`fit`.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    paper: ClassVar[str] = ""
    knows_true_form: ClassVar[bool] = False
    is_random: ClassVar[bool] = False
    order: int = 1

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

    @classmethod
    def for_tracks(cls, tracks: xr.Dataset) -> Self:
        """Return a baseline to be fitted to these tracks; an oracle reads its knowledge from them.

        Raises
        ------
        InputError
            If the tracks do not hold what an oracle needs.
        """
        return cls()

    @property
    def num_parameters(self) -> int:
        """How many numbers were learned."""
        return 0

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Learn what :meth:`step` needs from states ``(trial, time, individual, state)``."""

    def fit(
        self,
        tracks: xr.Dataset,
        *,
        validation: xr.Dataset | None = None,
        graph: GraphRule | str | None = None,
        seconds: float | None = None,
        seed: int = 0,
    ) -> Self:
        """Learn from tracks, and measure how far the steps are off.

        Parameters
        ----------
        tracks
            The training part. Where it carries no velocity, differences take its place.
        validation
            Tracks that tell a method with many parameters when to stop.
        graph
            Who sees whom, for instance ``"radius:2.5"``; absent, everybody sees everybody.
        seconds
            Processor time for a method that learns by steps; absent, its own number of epochs.
        seed
            Of weights and batches.

        Returns
        -------
        The baseline itself.

        Raises
        ------
        InputError
            If there are not two steps of anybody to learn from, or the graph is no rule.
        """
        states, fps = states_of(tracks), float(tracks.attrs["fps"])
        held = None if validation is None else states_of(validation)
        rule = GraphRule.parse(graph) if isinstance(graph, str) else graph
        self.fit_states(states, fps, Training(held, rule, seconds, seed))
        return self

    def fit_states(self, states: Array, fps: float, training: Training) -> None:
        """Learn from states ``(trial, time, individual, state)``, as :meth:`fit` does.

        Raises
        ------
        InputError
            If there are not two steps of anybody to learn from.
        """
        steps = known(states)[:, 1:] & known(states)[:, :-1]
        if steps.sum() < 2:
            raise InputError("tracks: there are not two steps to learn from.")
        self.learn(states, fps, training)
        judge = states if training.validation is None else training.validation
        errors = judge - self.one_step(judge, fps)
        seen = errors[known(errors)]
        if len(seen) < 2:
            raise InputError("validation: there are not two steps to measure errors on.")
        self.residual_covariance = np.cov(seen, rowvar=False)

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
        Same shape; NaN in the first frame, and where nothing was forecast.
        """
        predicted = np.full(states.shape, np.nan)
        if states.shape[-3] > 1:
            windows = np.lib.stride_tricks.sliding_window_view(
                _padded(states, states.shape[-3] + self.order - 1), self.order, axis=-3
            )
            windows = np.moveaxis(windows, -1, -3)[..., :-1, :, :, :]
            predicted[..., 1:, :, :] = self.step(windows, fps)
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
            History ``(..., time, individual, state)``, in the tracks' units.
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
            If ``horizon`` is not positive, or draws are asked of a baseline that was not fitted.
        """
        if horizon < 1:
            raise InputError(f"horizon: it must be at least 1, and it is {horizon}.")
        root = None if generator is None else self._noise_root()
        window = _padded(states, self.order)[..., -self.order :, :, :]
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
        states = _padded(states, states.shape[1] + self.order - 1)
        rows = last[:, None] + np.arange(self.order)
        recent = states[np.arange(len(last))[:, None], rows]
        generator = np.random.default_rng(seed) if draws else None
        start = np.broadcast_to(recent, (draws, *recent.shape)) if draws else recent
        path = self.predict(start, horizon, fps, generator)
        return _labelled(path, source, last, bool(draws))

    def error_covariances(self, states: Array, horizon: int, fps: float) -> Array:
        """Return the covariance of position errors at each step: the spread of its forecasts.

        Parameters
        ----------
        states
            ``(trial, time, individual, state)``, NaN where unknown.
        horizon
            Number of steps.
        fps
            Frames per second.

        Returns
        -------
        ``(step, space, space)``, NaN where fewer than ten errors are known: mean squares about
        zero, since a baseline takes its forecasts to be unbiased.
        """
        num_trials, num_times = states.shape[:2]
        space = states.shape[-1] // 2
        last = max(1, num_times - 1)
        origins = min(ERROR_ORIGINS, ERROR_FORECASTS // states.shape[-2])
        count = max(2, origins // num_trials)
        rows = np.unique(np.linspace(0, last - 1, min(last, count)).astype(int))
        trials, rows = np.repeat(np.arange(num_trials), len(rows)), np.tile(rows, num_trials)
        predicted = self.predict(histories(states, trials, rows, self.order), horizon, fps)
        padded = np.pad(states, ((0, 0), (0, horizon), (0, 0), (0, 0)), constant_values=np.nan)
        ahead = padded[trials[:, None], rows[:, None] + np.arange(1, horizon + 1)]
        errors = (ahead - predicted)[..., :space]
        errors = np.moveaxis(errors, 1, 0).reshape(horizon, -1, space)
        covariance = np.full((horizon, space, space), np.nan)
        for step, error in enumerate(errors):
            seen = error[np.isfinite(error).all(-1)]
            if len(seen) >= 10:
                covariance[step] = seen.T @ seen / len(seen)
        return covariance

    def _noise_root(self) -> Array:
        """Return a root of the residual covariance, which may be singular."""
        if self.residual_covariance is None:
            raise InputError(f"{self.name}: fit it first; its draws need to know its errors.")
        values, vectors = np.linalg.eigh(self.residual_covariance)
        root: Array = vectors * np.sqrt(values.clip(min=0.0))
        return root


def histories(
    states: Array, trials: npt.NDArray[np.int64], rows: npt.NDArray[np.int64], order: int
) -> Array:
    """Return the last frames up to each origin, ``(origin, order, individual, state)``.

    NaN before the first frame of a trial.
    """
    first = rows[:, None] + np.arange(1 - order, 1)
    history: Array = states[trials[:, None], np.maximum(first, 0)]
    history[first < 0] = np.nan
    return history


def _padded(states: Array, frames: int) -> Array:
    """Return states of at least so many frames, unknown ones before the first."""
    missing = max(0, frames - states.shape[-3])
    before = np.full((*states.shape[:-3], missing, *states.shape[-2:]), np.nan)
    return np.concatenate([before, states], axis=-3)


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
