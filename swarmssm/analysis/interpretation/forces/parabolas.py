"""Velocities and accelerations of raw tracks, without a model: parabolas through nearby frames.

The errors of velocity and acceleration of a parabola are independent, so that tracking noise does
not feign a brake along the heading (A. Savitzky and M. J. E. Golay 1964, Analytical Chemistry 36).
"""

import numpy as np
from scipy.signal import savgol_coeffs

from swarmssm.errors import InputError
from swarmssm.tracks import Array
from swarmssm.tracks.kinematics import estimate_noise

__all__ = ["checked_window", "parabola", "shortest_window"]

#: Frames over which raw tracks are smoothed at most.
LONGEST_WINDOW = 21


def checked_window(window: int) -> int:
    """Return a window, or raise."""
    if isinstance(window, bool) or not isinstance(window, int | np.integer) or window < 3:
        raise InputError(f"window: it must be an odd number from 3 upwards, not {window!r}.")
    if window % 2 == 0:
        raise InputError(f"window: it must be odd, so that a frame is in its middle, not {window}.")
    return int(window)


def shortest_window(position: Array, fps: float) -> int:
    """Return the shortest window whose accelerations are mostly signal."""
    noise = estimate_noise(position, fps)[1]
    longest = int(min(max(fps, 5.0), LONGEST_WINDOW, position.shape[1]))
    window = 3
    for window in range(3, longest + 1, 2):
        acceleration = parabola(position, fps, window)[1]
        known = acceleration[np.isfinite(acceleration)]
        if not known.size:
            break
        of_noise = noise * np.linalg.norm(savgol_coeffs(window, 2, deriv=2, delta=1 / fps))
        if of_noise <= 0.5 * np.sqrt(np.square(known).mean()):
            break
    return window


def parabola(position: Array, fps: float, window: int) -> tuple[Array, Array]:
    """Return states and accelerations of a parabola through the frames around each.

    ``(trial, time, individual, 4)`` and ``(trial, time, individual, 2)``, NaN where one is missing.
    """
    found = np.full((3, *position.shape), np.nan)
    if position.shape[1] >= window:
        around = np.lib.stride_tricks.sliding_window_view(position, window, axis=1)
        half = window // 2
        for order, target in enumerate(found):
            weights = savgol_coeffs(window, 2, deriv=order, delta=1 / fps, use="dot")
            target[:, half : half + around.shape[1]] = around @ weights
    return np.concatenate([found[0], found[1]], -1), found[2]
