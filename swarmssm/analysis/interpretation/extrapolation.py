"""Where tracks leave the region that a model was trained in, and how that is told."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from swarmssm.analysis.posterior.joining import joined
from swarmssm.inference import Fit
from swarmssm.tracks import states_of, with_trials

__all__ = ["Extrapolation", "beyond_training"]

#: A share of the positions beyond the region, or a way beyond it in lengths of its longest side,
#: from which a reader is told. Who is observed longer is seen in a slightly larger region.
WORTH_TELLING = 0.02
FAR = 0.05
#: An individual is named if this share of its positions is beyond.
MOSTLY = 0.5
NAMED = 6


@dataclass(frozen=True)
class Extrapolation:
    """How much of some tracks lies beyond the region of the training part.

    Attributes
    ----------
    share
        Of the known positions.
    depth
        How far the farthest is from the region, in lengths of the region's longest side.
    individuals
        Names of those with at least half of their positions beyond.
    walls
        Whether the model has learned where walls are, in that region.
    """

    share: float
    depth: float
    individuals: tuple[str, ...]
    walls: bool

    @property
    def note(self) -> str:
        """A sentence or two for a reader; empty where there is nothing worth telling."""
        if self.share < WORTH_TELLING and self.depth < FAR:
            return ""
        text = (
            f"{100 * self.share:.0f} % of the positions lie outside the rectangle in which the "
            f"model was trained, by up to {self.depth:.2g} of its longer side"
        )
        if self.individuals:
            more = len(self.individuals) - NAMED
            names = [*self.individuals[:NAMED], *([f"{more} more"] if more > 0 else [])]
            text += f", most of those of {joined(names)} among them"
        text += ". What is said there is extrapolated"
        if self.walls:
            text += (
                ", above all the force of the walls, whose place was learned inside: compare with "
                "a fit without them (--model-option walls=false)"
            )
        return f"{text}."


def beyond_training(fit: Fit, tracks: xr.Dataset) -> Extrapolation:
    """Measure how much of the tracks lies outside the rectangle of the training positions.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Tracks in the unit of those it was fitted on.
    """
    tracks = with_trials(tracks)
    position = states_of(tracks)[..., : tracks.sizes["space"]]
    low, high = np.array(fit.scales.low), np.array(fit.scales.high)
    seen = np.isfinite(position).all(-1)
    excess = np.where(seen, np.maximum(low - position, position - high).max(-1), -np.inf)
    number = np.maximum(seen.sum((0, 1)), 1)
    own = (excess > 0).sum((0, 1)) / number
    names = tracks["individual"].to_numpy()
    side = float((high - low).max())
    return Extrapolation(
        share=float((excess > 0).sum() / max(seen.sum(), 1)),
        depth=max(0.0, float(excess.max(initial=0.0))) / side if side > 0 else 0.0,
        individuals=tuple(str(name) for name in names[own >= MOSTLY]),
        walls="transition.half_width" in fit.parameters(1),
    )
