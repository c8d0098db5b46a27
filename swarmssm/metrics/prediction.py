"""Errors of predicted states: equations (4.1) to (4.3), at one step and at several.

Two readings of the printed equations are settled here. ``|.|`` is the Euclidean norm of the whole
state vector, and the square in (4.2) is its square. Each sum stands over its own number of terms,
so that all three are means times one half: T steps in (4.1) come from T + 1 states. The halves of
(4.1) and (4.3) cancel, therefore "stay where you are" has MAE = 1 on the steps that L was taken
from. L is a length and (4.2) divides a square by it: MSE depends on scale and sampling rate, and
compares only models scored on the same states in the same units. Scale the states to [0, 1] per
feature first, as (3.49) does; otherwise positions and velocities in different units are mixed.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.metrics.masked import Array, as_array, check_same_shape, known, masked_mean

__all__ = ["HorizonErrors", "horizon_errors", "mae", "mse", "step_length"]

AXES = "time, individual, state"


class HorizonErrors(NamedTuple):
    """Errors of forecasts, each field of shape ``(horizon,)``.

    Attributes
    ----------
    horizons
        Steps ahead.
    squared_error
        Plain mean of the squared error over forecasts, individuals and state components, in the
        square of the states' unit.
    mse, mae
        Equations (4.2) and (4.3) over the errors at that step alone.
    num_scored
        Number of individuals' states scored at that step.
    coverage
        Share of the known true states for which there was a forecast. Below 1, models are
        comparable only on what all of them forecast.
    """

    horizons: npt.NDArray[np.int64]
    squared_error: Array
    mse: Array
    mae: Array
    num_scored: npt.NDArray[np.int64]
    coverage: Array


def step_length(states: npt.ArrayLike) -> float:
    r"""Return L, half the mean distance between consecutive states.

    .. math:: L = \frac{1}{2NT} \sum_{t=1}^{T} \sum_{i=1}^{N} |x_i(t+1) - x_i(t)| \quad (4.1)

    Parameters
    ----------
    states
        True states, shape ``(..., time, individual, state)``, NaN where unknown. The mean runs
        over all leading axes (trials) too.

    Returns
    -------
    L in the unit of the states; NaN if no individual is known at two consecutive times.

    Raises
    ------
    InputError
        If ``states`` has fewer than three axes or holds infinite values.
    """
    array = as_array(states, "states", AXES)
    steps = np.diff(array, axis=-3)
    return 0.5 * float(masked_mean(np.linalg.norm(steps, axis=-1), known(steps)))


def mse(states: npt.ArrayLike, predicted: npt.ArrayLike, length: float | None = None) -> float:
    r"""Return the normalised mean squared error.

    .. math::
        MSE = \frac{1}{2LN(T-1)} \sum_{t=1}^{T-1} \sum_{i=1}^{N} |x_i(t) - x_i^*(t)|^2 \quad (4.2)

    Parameters
    ----------
    states
        True states, shape ``(..., time, individual, state)``, NaN where unknown.
    predicted
        Prediction *of* the state at the same place, same shape; NaN where there is none (for
        instance during the first history). Infinite predictions count, and make the error so;
        a NaN does not, so see to it that the models compared have theirs at the same places.
    length
        L; default :func:`step_length` of all of ``states``, not only of the predicted part.

    Returns
    -------
    Mean over all individuals' states that are known in both; NaN if there is none.

    Raises
    ------
    InputError
        If the shapes differ, ``states`` holds infinite values, or ``length`` (given or computed)
        is not positive.
    """
    errors, mask, scale = _errors(states, predicted, length)
    with np.errstate(over="ignore"):
        return 0.5 * float(masked_mean(errors**2, mask)) / scale


def mae(states: npt.ArrayLike, predicted: npt.ArrayLike, length: float | None = None) -> float:
    r"""Return the normalised mean absolute error, which does not depend on the unit.

    .. math::
        MAE = \frac{1}{2LN(T-1)} \sum_{t=1}^{T-1} \sum_{i=1}^{N} |x_i(t) - x_i^*(t)| \quad (4.3)

    It is 1 for the prediction "stay where you are" of every step of ``states``.

    Parameters
    ----------
    states, predicted, length
        As for :func:`mse`.

    Returns
    -------
    Mean over all individuals' states that are known in both; NaN if there is none.

    Raises
    ------
    InputError
        As :func:`mse`.
    """
    errors, mask, scale = _errors(states, predicted, length)
    return 0.5 * float(masked_mean(errors, mask)) / scale


def horizon_errors(
    truth: npt.ArrayLike,
    forecasts: npt.ArrayLike,
    horizons: Sequence[int],
    *,
    length: float | None = None,
) -> HorizonErrors:
    """Score forecasts at each of several steps ahead.

    Parameters
    ----------
    truth
        What came, shape ``(..., step, individual, state)``: entry k - 1 of the step axis lies k
        steps after the last state that the forecast knew. Leading axes are trials, starts or
        both. NaN where unknown.
    forecasts
        Same shape; NaN where there is none.
    horizons
        Steps ahead at which to score, each from 1 to the number of steps, rising.
    length
        L of (4.1) for ``mse`` and ``mae``; default :func:`step_length` of ``truth``, which needs
        two steps. Give that of the whole recording to compare with one-step scores.

    Returns
    -------
    The errors *at* each horizon, not up to it.

    Raises
    ------
    InputError
        If the shapes differ, a horizon lies outside the forecast, or ``length`` (given or
        computed) is not positive.
    """
    true = as_array(truth, "truth", "step, individual, state")
    given = as_array(forecasts, "forecasts", "step, individual, state", allow_inf=True)
    check_same_shape(true, given, "truth", "forecasts")
    steps = np.asarray(horizons)
    if steps.ndim != 1 or steps.size == 0 or steps.dtype.kind not in "iu":
        raise InputError(f"horizons: give a list of whole numbers of steps, not {horizons!r}.")
    if steps.min() < 1 or steps.max() > true.shape[-3] or (np.diff(steps) <= 0).any():
        raise InputError(
            f"horizons: they must rise and lie between 1 and {true.shape[-3]}, the number of "
            f"steps forecast; {[int(k) for k in steps]} do not."
        )
    if length is None and true.shape[-3] < 2:
        raise InputError("length: it cannot be computed from a single step; give it.")
    scale = _scale(true, length, "truth")

    # Horizon first, all else flat: each score is then one mean along the second axis.
    at = np.moveaxis(true, -3, 0)[steps - 1].reshape(len(steps), -1, true.shape[-1])
    ahead = np.moveaxis(given, -3, 0)[steps - 1].reshape(at.shape)
    mask = known(at) & known(ahead)
    with np.errstate(over="ignore"):
        distance = np.linalg.norm(ahead - at, axis=-1)
        mean_square = masked_mean(distance**2, mask, axis=1)
    return HorizonErrors(
        horizons=steps.astype(np.int64),
        squared_error=mean_square / true.shape[-1],
        mse=0.5 * mean_square / scale,
        mae=0.5 * masked_mean(distance, mask, axis=1) / scale,
        num_scored=mask.sum(axis=1),
        coverage=masked_mean(mask.astype(np.float64), known(at), axis=1),
    )


def _errors(
    states: npt.ArrayLike, predicted: npt.ArrayLike, length: float | None
) -> tuple[Array, npt.NDArray[np.bool_], float]:
    """Return the length of each error vector, which of them count, and L."""
    true = as_array(states, "states", AXES)
    given = as_array(predicted, "predicted", AXES, allow_inf=True)
    check_same_shape(true, given, "states", "predicted")
    with np.errstate(over="ignore"):
        distance = np.linalg.norm(given - true, axis=-1)
    return distance, known(true) & known(given), _scale(true, length, "states")


def _scale(true: Array, length: float | None, name: str) -> float:
    """Return L as given, or of the true states."""
    if length is None:
        length = step_length(true)
        if length == 0.0:
            raise InputError(f"{name}: nothing moves, so that L of (4.1) is 0. Give length.")
    elif not 0 < length < np.inf:
        raise InputError(f"length: it must be a positive number, not {length}.")
    return length
