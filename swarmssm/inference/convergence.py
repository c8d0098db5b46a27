"""Whether a fit has come to rest: how much its loss still falls, and how far parameters move."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch

__all__ = ["Convergence", "add_distances", "convergence"]

#: Share of the history that is judged.
LAST = 0.1
#: A parameter that moved farther, in posterior standard deviations, has not come to rest.
FAR = 0.5
#: A loss that fell by more nats per coordinate, and by twice its standard error, still falls.
FALL = 0.005


@dataclass(frozen=True)
class Convergence:
    """What the last tenth of a history says.

    Attributes
    ----------
    fall
        By how much the loss fell there, in nats per observed coordinate: the slope of a straight
        line, times the length.
    fall_error
        Its standard error, from the scatter about the line; 0 with two rows.
    distance
        Largest distance that a parameter with a prior moved there, in posterior standard
        deviations; NaN where the history does not tell.
    rows
        How many rows of the history that are.
    """

    fall: float
    fall_error: float
    distance: float
    rows: int

    @property
    def converged(self) -> bool:
        """Whether neither the loss nor the parameters still move; false for a single row."""
        falls = self.fall > max(FALL, 2.0 * self.fall_error)
        return self.rows > 1 and not falls and not self.distance > FAR

    @property
    def verdict(self) -> str:
        """One sentence."""
        if self.rows < 2:
            return "Not known to have converged: the history has a single row. Fit longer."
        moved = "" if np.isnan(self.distance) else f", parameters moved {self.distance:.2g} sd"
        detail = f"in the last tenth the loss fell by {self.fall:.2g} nats per coordinate{moved}"
        if self.converged:
            return f"Converged: {detail}."
        return f"Not converged: {detail}. Fit longer before reading the parameters."


def convergence(history: pd.DataFrame | Sequence[Mapping[str, float]]) -> Convergence:
    """Judge the last tenth of the history of a fit, at least its last two rows.

    Parameters
    ----------
    history
        Rows with ``loss``, ``step`` (else the rows are counted) and, where parameters have a
        posterior, ``distance``: how far they are from the end, in posterior standard deviations.
    """
    table = pd.DataFrame(history)
    last = table.iloc[-min(len(table), max(2, round(LAST * len(table)))) :]
    loss = last["loss"].to_numpy(float)
    step = last["step"].to_numpy(float) if "step" in last else np.arange(len(last), dtype=float)
    distance = float(last["distance"].iloc[0]) if "distance" in last else np.nan
    if len(last) < 2 or np.ptp(step) == 0:
        return Convergence(np.nan, 0.0, distance, len(last))
    centred = step - step.mean()
    slope = centred @ loss / (centred @ centred)
    residual = loss - loss.mean() - slope * centred
    spare = len(last) - 2
    error = np.sqrt(residual @ residual / spare / (centred @ centred)) if spare else 0.0
    length = float(np.ptp(step))
    return Convergence(float(-slope * length), float(error) * length, distance, len(last))


def add_distances(
    history: Sequence[dict[str, float]], places: Sequence[torch.Tensor], sd: torch.Tensor
) -> None:
    """Write ``distance`` into a history: how far parameters with a prior are from the last row.

    Parameters
    ----------
    history
        Rows; left as they are where no parameter has a prior.
    places
        Unconstrained parameters ``(number,)`` of each row.
    sd
        Their posterior standard deviations ``(number,)``.
    """
    if not places or not sd.numel():
        return
    moved = (torch.stack(list(places)) - places[-1]).abs() / sd
    for row, distance in zip(history, moved.amax(-1).tolist(), strict=True):
        row["distance"] = distance
