"""What the scores share: arrays with NaN for the unknown, and means over what is known."""

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def as_array(values: npt.ArrayLike, name: str, axes: str, *, allow_inf: bool = False) -> Array:
    """Return ``values`` as float64 with at least the named axes.

    Parameters
    ----------
    values
        NaN = unknown.
    name
        What the caller calls the argument.
    axes
        Its last axes, comma separated, as the error is to name them.
    allow_inf
        Whether infinite values may stand, as in a forecast that grew beyond all bounds.

    Raises
    ------
    InputError
        If there are no numbers, too few axes, or infinite values that may not stand.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: it must be an array of numbers (..., {axes}).") from error
    if array.ndim < axes.count(",") + 1:
        raise InputError(f"{name}: its shape is {array.shape}; it must be (..., {axes}).")
    if not allow_inf and np.isinf(array).any():
        place = tuple(int(i) for i in np.argwhere(np.isinf(array))[0])
        raise InputError(f"{name}: the entry at {place} is infinite. Write NaN for the unknown.")
    return array


def check_same_shape(first: Array, second: Array, first_name: str, second_name: str) -> None:
    """Refuse two arrays that do not lie on top of each other."""
    if first.shape != second.shape:
        raise InputError(
            f"{second_name}: its shape {second.shape} differs from that of {first_name}, "
            f"{first.shape}."
        )


def known(values: Array) -> Mask:
    """Return where a whole vector (the last axis) is known."""
    return np.asarray(~np.isnan(values).any(axis=-1))


def ratio(numerator: npt.ArrayLike, denominator: npt.ArrayLike) -> Array:
    """Divide, giving NaN where the denominator is 0: a mean over nothing is unknown."""
    top, bottom = np.broadcast_arrays(
        np.asarray(numerator, dtype=np.float64), np.asarray(denominator, dtype=np.float64)
    )
    out = np.full(top.shape, np.nan)
    np.divide(top, bottom, out=out, where=bottom != 0)
    return out


def masked_mean(values: Array, mask: Mask, axis: int | tuple[int, ...] | None = None) -> Array:
    """Return the mean of ``values`` where ``mask`` holds, NaN where it nowhere holds."""
    # A forecast may hold inf or huge numbers; their mean is inf, and that says it.
    with np.errstate(over="ignore"):
        total = np.where(mask, values, 0.0).sum(axis=axis)
    return ratio(total, mask.sum(axis=axis))
