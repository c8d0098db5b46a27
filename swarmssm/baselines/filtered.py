"""What the baselines that follow each individual with a filter have in common."""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import scipy

from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.baselines.jump_filter import JumpModel
from swarmssm.errors import InputError
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["FilteredBaseline", "typical_noise"]

#: Noise levels are learned from pieces of this many frames, of at most so many individuals.
PIECE, MOST_FOLLOWED = 150, 48
#: First steps of the search, in logarithms of levels and odds: each is doubled.
FIRST_STEP = 0.7
#: Smallest tracking error, as a share of the typical length of a step.
LEAST_TRACKING_ERROR = 1e-4


class FilteredBaseline(Baseline):
    """A baseline that follows each individual with a filter, and draws futures from its model.

    A subclass writes :meth:`learn` and sets :attr:`model` there.

    Attributes
    ----------
    model
        What the filter assumes; ``None`` before it has learned.
    differenced
        Whether velocities in the tracks are backward differences of positions. A forecast velocity
        is then the difference of forecast positions, the first one from the last tracked position
        with its tracking error, since that is what will be seen. Otherwise it is the filter's.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    #: So much of a history is given to the filter in :meth:`forecast`; it has long forgotten more.
    order: int = 50
    #: Of the likelihood, at most so many for each number that is learned.
    evaluations: ClassVar[int] = 40

    def __init__(self) -> None:
        super().__init__()
        self.model: JumpModel | None = None
        self.differenced = False

    def one_step(self, states: Array, fps: float) -> Array:
        """Predict each frame from those before it, in one pass of the filter."""
        expected = self._model(fps).follow(states)[0]
        predicted = np.full_like(states, np.nan)
        past, ahead = states[..., :-1, :, :], expected[..., :-1, None, :, :]
        predicted[..., 1:, :, :] = self._tracked(ahead, past, fps)[..., 0, :, :]
        return predicted

    def predict(
        self,
        states: Array,
        horizon: int,
        fps: float,
        generator: np.random.Generator | None = None,
    ) -> Array:
        """Go on from what the filter makes of the history, as :meth:`Baseline.predict` does.

        Draws are of the filter's own model: of the present state, of the noise of each step, and of
        the tracking error of each position.
        """
        if horizon < 1:
            raise InputError(f"horizon: it must be at least 1, and it is {horizon}.")
        model = self._model(fps)
        # Draws come as one history repeated: it is filtered once.
        repeated = states.ndim > 3 and states.strides[0] == 0 and len(states) > 1
        beliefs = model.follow(states[0] if repeated else states)[2]
        if repeated:
            beliefs = beliefs.repeated(len(states))
        if generator is None:
            path = model.expect(beliefs, horizon)
        else:
            path = model.draw(beliefs, horizon, generator)
        return self._tracked(path, states[..., -1, :, :], fps)

    def _model(self, fps: float) -> JumpModel:
        """Return the model, which holds for one frame rate."""
        if self.model is None:
            raise InputError(f"{self.name}: fit it first; it knows no noise levels yet.")
        if not np.isclose(fps, self.model.fps):
            raise InputError(
                f"fps: {self.name} was fitted at {self.model.fps:g} frames per second, and these "
                f"states have {fps:g}."
            )
        return self.model

    def _tracked(self, path: Array, last: Array, fps: float) -> Array:
        """Return a path ``(..., horizon, individual, state)`` as it would be tracked.

        Only of those whose last state, ``(..., individual, state)``, is known.
        """
        position, velocity = np.split(path, 2, axis=-1)
        if self.differenced:
            begin = last[..., None, :, : position.shape[-1]]
            velocity = np.diff(np.concatenate([begin, position], axis=-3), axis=-3) * fps
        both = np.concatenate([position, velocity], axis=-1)
        return np.asarray(np.where(known(last)[..., None, :, None], both, np.nan))

    def _most_likely(
        self,
        build: Callable[[Array], JumpModel],
        begin: list[float],
        states: Array,
        training: Training,
    ) -> Array:
        """Return the parameters under which the positions are most probable.

        By Nelder and Mead's simplex, on pieces of the tracks spread evenly over individuals and
        time; it ends early when the training time is up.
        """
        pieces = _pieces(states)

        def surprise(parameters: Array) -> float:
            densities = build(parameters).follow(pieces)[1]
            mean = np.nanmean(densities) if np.isfinite(densities).any() else -np.inf
            return float(-mean) if np.isfinite(mean) else 1e12

        def stop(_: Array) -> None:
            if training.over:
                raise StopIteration

        corners = np.eye(len(begin) + 1, len(begin), k=-1)
        options = {
            "xatol": 0.02,
            "fatol": 1e-4,
            "maxfev": self.evaluations * len(begin),
            "initial_simplex": np.array(begin) + FIRST_STEP * corners,
        }
        simplex: Any = scipy.optimize.minimize
        found = simplex(surprise, begin, method="Nelder-Mead", callback=stop, options=options)
        best: Array = found.x
        return best

    def _is_differenced(self, states: Array, fps: float) -> bool:
        """Return whether velocities are backward differences of positions, to a thousandth."""
        position, velocity = np.split(states, 2, axis=-1)
        difference = np.diff(position, axis=-3) * fps
        error = difference - velocity[..., 1:, :, :]
        both = known(error)
        return bool(
            both.any() and (error[both] ** 2).mean() <= 1e-6 * (difference[both] ** 2).mean()
        )


def typical_noise(states: Array, fps: float) -> tuple[float, float]:
    """Return typical changes of one coordinate in a frame: of velocity, and of position.

    Root mean squares; the second, where nobody moves, is a thousandth of how far apart places are.
    """
    change = np.diff(states, axis=1)
    seen = known(change)
    position, velocity = np.split(change[seen], 2, axis=-1)
    step = float(np.sqrt((position**2).mean()))
    if step == 0.0:
        step = 1e-3 * float(states[known(states)].std()) or 1.0
    return max(float(np.sqrt((velocity**2).mean())), 1e-6 * step * fps), step


def _pieces(states: Array) -> Array:
    """Return pieces of tracks, ``(piece, time, 1, state)``, that hold the most of what is known."""
    length = min(PIECE, states.shape[1])
    starts = np.arange(0, states.shape[1] - length + 1, length)
    cut = np.stack([states[:, start : start + length] for start in starts], axis=1)
    cut = np.moveaxis(cut, 3, 2).reshape(-1, length, states.shape[-1])
    usable = np.flatnonzero(known(cut).sum(axis=1) >= 3)
    if not len(usable):
        usable = np.arange(len(cut))
    chosen = np.linspace(0, len(usable) - 1, min(len(usable), MOST_FOLLOWED)).round().astype(int)
    return np.asarray(cut[usable[chosen]][:, :, None])
