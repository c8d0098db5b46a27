r"""Linear prediction of each individual from its own last few states."""

from typing import ClassVar

import numpy as np

from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.baselines.gaps import fill_gaps
from swarmssm.baselines.regression import AffineMap, ridge_maps
from swarmssm.baselines.selection import best_of, learning_and_judging_parts
from swarmssm.errors import InputError
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["AR1", "AR5"]


class AR5(Baseline):
    r"""Each individual's change of state is an affine function of its last five states.

    .. math:: x_i(t + 1) = x_i(t) + b + \sum_{k=0}^{4} B_k\, x_i(t - k)

    with one *b* and one set of matrices for everybody, fitted by ridge regression (Hoerl and
    Kennard 1970) on features of unit variance. The penalty is that of
    :data:`~swarmssm.baselines.regression.PENALTIES` with the smallest error of rollouts on
    the validation part (:func:`~swarmssm.baselines.selection.rollout_error`). There is no
    interaction in it: what another method gains over this one, it may have gained from the
    neighbours; what it gains over constant velocity alone, it need not.

    It learns from whoever is known in six consecutive frames. When it predicts, unknown frames
    before the last are filled by :func:`~swarmssm.baselines.gaps.fill_gaps`.
    """

    name: ClassVar[str] = "ar5"
    title: ClassVar[str] = "ridge AR(5)"
    paper: ClassVar[str] = "Hoerl and Kennard 1970, doi:10.1080/00401706.1970.10488634"
    order: int = 5

    def __init__(self) -> None:
        super().__init__()
        self.change: AffineMap | None = None

    @property
    def num_parameters(self) -> int:
        """Coefficients and intercepts."""
        return 0 if self.change is None else self.change.size

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Fit the affine map, choosing the penalty by rollouts."""
        early, late = learning_and_judging_parts(states, training)
        chosen = best_of(
            ((index, self._with(change)) for index, change in enumerate(self._maps(early, fps))),
            late,
            fps,
            self.order,
        )
        self.change = self._maps(states, fps)[chosen]

    def step(self, window: Array, fps: float) -> Array:
        """Return the last state plus the affine function of the window."""
        if self.change is None:
            raise InputError(f"{self.name}: fit it first; it has learned nothing yet.")
        return np.asarray(window[..., -1, :, :] + self.change(_features(window, fps)))

    def _with(self, change: AffineMap) -> "AR5":
        """Return the baseline itself, set to a candidate."""
        self.change = change
        return self

    def _maps(self, states: Array, fps: float) -> list[AffineMap]:
        """Return one affine map for each penalty."""
        frames = min(self.order + 1, states.shape[1])
        windows = np.lib.stride_tricks.sliding_window_view(states, frames, axis=1)
        # (trial, window, individual, state, frame) -> (trial, window, frame, individual, state)
        windows = np.moveaxis(windows, -1, -3)
        seen = np.lib.stride_tricks.sliding_window_view(known(states), frames, axis=1)
        usable = seen.all(axis=-1)
        if usable.sum() < 2 or frames <= self.order:
            # Nobody stays that long: let filled frames stand for those that are not there.
            before = np.full((len(states), self.order - 1, *states.shape[2:]), np.nan)
            padded = np.concatenate([before, states], axis=1)
            windows = np.lib.stride_tricks.sliding_window_view(padded, self.order + 1, axis=1)
            windows = np.moveaxis(windows, -1, -3)
            usable = known(windows[..., -1, :, :]) & known(windows[..., -2, :, :])
        past, following = windows[..., :-1, :, :], windows[..., -1, :, :]
        features = _features(past, fps)[usable]
        return ridge_maps(features, (following - past[..., -1, :, :])[usable])


class AR1(AR5):
    r"""Each individual's change of state is an affine function of its present state.

    .. math:: x_i(t + 1) = x_i(t) + b + B\, x_i(t)

    :class:`AR5` of order 1.
    """

    name: ClassVar[str] = "ar1"
    title: ClassVar[str] = "ridge AR(1)"
    order: int = 1


def _features(window: Array, fps: float) -> Array:
    """Return each individual's states in a row, ``(..., individual, order * state)``."""
    filled = np.moveaxis(fill_gaps(window, fps), -3, -2)
    return filled.reshape(*filled.shape[:-2], -1)
