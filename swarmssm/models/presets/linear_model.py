"""The linear-Gaussian swarm: ``swarmssm fit FILE --model linear``."""

import math
from typing import Any, Literal

import pyro.distributions as dist
import torch

from swarmssm.errors import InputError
from swarmssm.models.edges import Edges, LatentEdges, ObservedEdges
from swarmssm.models.emissions import PositionEmission
from swarmssm.models.initial import InitialStates
from swarmssm.models.scales import Scales
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.linear_force import LinearForceTransition

__all__ = ["linear"]

#: Standard deviation of the logarithm of what only the order of magnitude is known of.
WIDE = 1.5
#: Standard deviation of a gain of either sign, in the one with which neighbours turn each other.
STRONG = 3.0
#: Share of its speed by which an individual is thought to be changed by noise in a length's time.
WANDER = 0.3
#: The least that a scale may be, where tracks stand still.
LEAST = 1e-6


def linear(
    scales: Scales,
    *,
    homing: bool = True,
    edges: str = "observed",
    observed: Literal["positions", "states"] = "positions",
) -> StateSpaceModel:
    r"""Return a swarm on springs, which Kalman filters solve exactly.

    Each individual keeps its velocity but for damping, is drawn to the mean position and velocity
    of those it sees (:class:`~swarmssm.models.transitions.LinearForceTransition`), and home, to the
    mean of the tracks' positions; seen with noise.

    Let L be the standard deviation of positions, l the distance to the nearest neighbour, U the
    typical speed (tracking noise taken off). ``LogNormal`` is written with its median:

    ==============================  ==========================================================
    ``transition.cohesion_gain``    Normal(0, 3 (U/l)^2): at 1 (U/l)^2, a neighbour turns an
                                    individual within the distance to it
    ``transition.alignment_gain``   Normal(0, 3 U/l), likewise
    ``transition.damping``          LogNormal(U/L, 1.5)
    ``transition.homing_gain``      LogNormal((U/L)^2, 1.5)
    ``transition.process_noise``    LogNormal: in the time L/U it changes the velocity by 0.3 U;
                                    1.5 wide
    ``emission.noise``              LogNormal(estimated tracking noise, 0.5); if none could be
                                    told, a tenth of the step from frame to frame, and 1.5 wide
    ==============================  ==========================================================

    Parameters
    ----------
    scales
        Of the training tracks.
    homing
        Whether there is a home. Without one nothing keeps a swarm in its place.
    edges
        ``"observed"``: the graph that comes with the data. A rule such as ``"radius:2.5"``: the
        graph of the hidden states, with which the model is no longer linear.
    observed
        ``"positions"`` with noise, or ``"states"``, exactly.

    Raises
    ------
    InputError
        If an option is none of the above.
    """
    if observed not in ("positions", "states"):
        raise InputError(f"observed: it must be 'positions' or 'states', not {observed!r}.")
    length, spacing = max(scales.length, LEAST), max(scales.spacing, LEAST)
    added = 2.0 * scales.space * (scales.noise / scales.dt) ** 2
    least = max((0.1 * scales.speed) ** 2, LEAST**2)
    speed = math.sqrt(max(scales.speed**2 - added, least))
    slow, quick = speed / length, speed / spacing
    options: dict[str, Any] = {
        "cohesion_gain": _normal(STRONG * quick**2),
        "alignment_gain": _normal(STRONG * quick),
        "damping": _lognormal(slow, WIDE),
        "process_noise": _lognormal(WANDER * speed * math.sqrt(slow), WIDE),
    }
    if homing:
        options["homing_gain"] = _lognormal(slow**2, WIDE)
        options["home"] = torch.tensor(scales.centre)
    emission = None
    if observed == "positions":
        seen = scales.noise > 0
        deviation = scales.noise if seen else 0.1 * speed * scales.dt
        emission = PositionEmission(scales.space, _lognormal(deviation, 0.5 if seen else WIDE))
    graph: Edges = ObservedEdges() if edges == "observed" else LatentEdges(edges)
    return StateSpaceModel(
        InitialStates.for_scales(scales),
        LinearForceTransition(scales.space, scales.dt, **options),
        emission,
        graph,
    )


def _normal(spread: float) -> dist.Normal:
    return dist.Normal(torch.tensor(0.0), torch.tensor(spread))


def _lognormal(median: float, spread: float) -> dist.LogNormal:
    return dist.LogNormal(torch.tensor(math.log(median)), torch.tensor(spread))
