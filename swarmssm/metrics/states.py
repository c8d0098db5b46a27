"""Which of the known states a group is in - swarm, polarized, milling - and for how long.

The limits are those of Tunstrøm et al. (2013), for golden shiners in groups of 30 to 300.
"""

import numpy as np
import numpy.typing as npt

from swarmssm.errors import InputError
from swarmssm.metrics.masked import as_array, check_same_shape

__all__ = ["STATES", "group_states", "mean_state_duration"]

#: Names of the states, in the order of their numbers.
STATES = ("swarm", "polarized", "milling", "transition")
#: Below the first an order parameter is low, above the second it is high.
LOW, HIGH = 0.35, 0.65

States = npt.NDArray[np.int64]


def group_states(polarization: npt.ArrayLike, rotation: npt.ArrayLike) -> States:
    """Return which state a group is in.

    A *swarm* has both order parameters below 0.35; a *polarized* group has a polarization above
    0.65 and a rotation below 0.35; a *milling* one the reverse; anything else is a *transition*.

    Parameters
    ----------
    polarization, rotation
        Shape ``(..., time)``, NaN where unknown.

    Returns
    -------
    Shape ``(..., time)``: places in :data:`STATES`, -1 where unknown.

    Raises
    ------
    InputError
        If the shapes differ.

    References
    ----------
    Tunstrøm, K. et al. (2013). Collective states, multistability and transitional behavior in
    schooling fish. PLoS Computational Biology 9, e1002915. doi:10.1371/journal.pcbi.1002915
    """
    order = as_array(polarization, "polarization", "time")
    turn = as_array(rotation, "rotation", "time")
    check_same_shape(order, turn, "polarization", "rotation")
    states = np.full(order.shape, STATES.index("transition"))
    states[(order < LOW) & (turn < LOW)] = STATES.index("swarm")
    states[(order > HIGH) & (turn < LOW)] = STATES.index("polarized")
    states[(order < LOW) & (turn > HIGH)] = STATES.index("milling")
    states[np.isnan(order) | np.isnan(turn)] = -1
    return states


def mean_state_duration(states: npt.ArrayLike, fps: float) -> float:
    """Return the mean time between changes of state.

    A group has changed when it arrives in another of swarm, polarized and milling; on the way, in
    transition or unknown, it still counts as where it was. The last stay of a run, which is cut
    short, counts as one: without any change the mean is the length of a run.

    Parameters
    ----------
    states
        Shape ``(..., time)`` of :func:`group_states`; each row is a run of its own.
    fps
        Frames per second.

    Returns
    -------
    Seconds; NaN where nothing is known.

    Raises
    ------
    InputError
        If ``fps`` is not positive.
    """
    if not fps > 0:
        raise InputError(f"fps: it must be positive, and it is {fps}.")
    array = np.asarray(states, dtype=np.int64)
    runs = array.reshape(-1, array.shape[-1]) if array.ndim else array.reshape(1, 1)
    frames, stays = 0, 0
    for run in runs:
        if not (run >= 0).any():
            continue
        frames += int((run >= 0).sum())
        named = run[(run >= 0) & (run != STATES.index("transition"))]
        stays += 1 + int((np.diff(named) != 0).sum())
    return frames / fps / stays if stays else float("nan")
