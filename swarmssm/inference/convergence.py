"""Whether a fit had come to rest when it ended."""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd

__all__ = ["Convergence", "convergence"]

#: Rows of a history from which a slope is told, at least; twice as many have to be there.
FEWEST_ROWS = 5
#: Of the whole fall of the loss, what the last tenth of a fit may still bring.
SHARE_OF_FALL = 0.01


class Convergence(NamedTuple):
    """Whether a fit had come to rest when it ended.

    Attributes
    ----------
    fall
        By how much the loss still fell over the last tenth of the history, in nats per coordinate,
        by the line of least squares.
    noise
        Standard error of it.
    converged
        Whether that is below a hundredth of the whole fall, or within two standard errors of none.
    verdict
        One sentence.
    """

    fall: float
    noise: float
    converged: bool
    verdict: str


def convergence(history: pd.DataFrame) -> Convergence:
    """Return whether the loss was still falling when training ended.

    Parameters
    ----------
    history
        Of a fit, with a column ``loss``, see :func:`swarmssm.inference.training.train`.
    """
    loss = history["loss"].to_numpy(np.float64)
    if len(loss) < 2 * FEWEST_ROWS:
        text = f"Not known to have converged: the history has {len(loss)} rows. Fit for longer."
        return Convergence(math.nan, math.nan, False, text)
    last = loss[-max(FEWEST_ROWS, len(loss) // 10) :]
    place = np.linspace(-0.5, 0.5, len(last))
    spread = float((place**2).sum())
    slope = float((place * last).sum()) / spread
    residual = last - last.mean() - slope * place
    noise = math.sqrt(float((residual**2).sum()) / (len(last) - 2) / spread)
    whole = float(loss[: len(last)].mean() - last.mean())
    rests = -slope <= max(2.0 * noise, SHARE_OF_FALL * abs(whole))
    told = f"the loss fell by {max(-slope, 0.0):.2g} nats per coordinate in the last tenth"
    told += f" of the fit, and by {whole:.2g} in all"
    text = f"Converged: {told}." if rests else f"Not converged: {told}. Fit for longer."
    return Convergence(-slope, noise, rests, text)
