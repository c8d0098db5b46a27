"""The graph state-space model: a swarm whose forces nobody has written down."""

from typing import Literal

import torch
from pyro.distributions import constraints
from pyro.nn import PyroParam

from swarmssm.errors import InputError
from swarmssm.models.edges import Edges, LatentEdges, ObservedEdges
from swarmssm.models.emissions import PositionEmission
from swarmssm.models.initial import InitialStates
from swarmssm.models.scales import Scales
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.graph import GraphTransition, Noise, Symmetries, Tails

__all__ = ["graph_ssm"]

#: Tracking noise is taken to be at least this part of what an individual moves in a frame: without
#: a bound, nothing keeps a model from following every wobble of the tracks.
LEAST_NOISE = 1e-3


def graph_ssm(
    scales: Scales,
    *,
    width: int = 64,
    rounds: int = 1,
    positions: bool = True,
    speed_limits: bool = True,
    symmetries: Symmetries | None = None,
    noise: Noise = "state",
    tails: Tails = "student",
    observed: Literal["positions", "states"] = "positions",
    observation_noise: float | None = None,
    edges: str = "observed",
    weight_prior: float | Literal["auto"] | None = "auto",
    controls: int = 0,
) -> StateSpaceModel:
    """Return a state-space model whose law of motion is a gated graph network.

    Before training it is constant velocity, seen with the tracking noise that the tracks show. By
    default the noise of the motion is that of animals: heavy-tailed, and other in other states. In
    simulations it may be known to be Gaussian and constant, which is learned sooner.

    Parameters
    ----------
    scales
        Typical sizes of the training tracks.
    width, rounds, positions, speed_limits, noise, tails, controls
        Of :class:`swarmssm.models.transitions.GraphTransition`.
    symmetries
        The same; absent, ``"mirror"``, or ``"none"`` where there are controls.
    weight_prior
        The same. ``"auto"``: 0.05 for positions, since in recordings of some hundreds of frames a
        free network learns by heart; none for states that are known exactly.
    observed
        ``"positions"``: positions are seen with noise, and velocities are latent. ``"states"``:
        positions and velocities are known exactly, and the law of motion is fitted to them alone.
    observation_noise
        Standard deviation of the tracking noise of a coordinate, in the tracks' unit; absent, it is
        learned.
    edges
        ``"observed"``: the graph that comes with the tracks; else a rule such as ``"radius:2.5"``,
        which makes it anew of the latent positions.

    Raises
    ------
    InputError
        If an option is none of the above.
    """
    if observed not in ("positions", "states"):
        raise InputError(f"observed: it must be 'positions' or 'states', not {observed!r}.")
    if observed == "states" and observation_noise is not None:
        raise InputError(
            "observation_noise: states that are observed exactly have none. Leave it out, or take "
            "observed='positions'."
        )
    transition = GraphTransition(
        scales,
        width=width,
        rounds=rounds,
        positions=positions,
        speed_limits=speed_limits,
        symmetries=symmetries or ("none" if controls else "mirror"),
        noise=noise,
        tails=tails,
        weight_prior=_weight_prior(observed) if weight_prior == "auto" else weight_prior,
        controls=controls,
    )
    emission = None
    if observed == "positions":
        emission = PositionEmission(scales.space, _tracking_noise(scales, observation_noise))
    graph: Edges = ObservedEdges() if edges == "observed" else LatentEdges(edges)
    return StateSpaceModel(InitialStates.for_scales(scales), transition, emission, graph)


def _weight_prior(observed: str) -> float | None:
    """Return the usual prior of a network's weights."""
    return None if observed == "states" else 0.05


def _tracking_noise(scales: Scales, given: float | None) -> float | PyroParam:
    """Return the given noise, or a parameter that starts at the noise of the tracks."""
    if given is not None:
        return given
    least = LEAST_NOISE * scales.speed * scales.dt or LEAST_NOISE
    start = torch.tensor(max(scales.noise, 10.0 * least))
    return PyroParam(start, constraint=constraints.greater_than(least))
