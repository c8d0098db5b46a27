"""The extended Kalman filter at many draws of the parameters side by side.

Kept of each frame is what it was foreseen to be: in a swarm of ten the covariances of all states of
200 draws and 1000 frames would fill gigabytes.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import pyro
import torch
from torch import Tensor
from torch.func import vmap

from swarmssm.graphs import dense
from swarmssm.inference.data import Prepared
from swarmssm.inference.filtering.affine import AffineMap, Window
from swarmssm.inference.filtering.layouts import JOINT_LIMIT, frames_of
from swarmssm.inference.filtering.matrices import (
    block_diagonal,
    cholesky,
    own_blocks,
    symmetrize,
)
from swarmssm.models import KinematicTransition, StateSpaceModel, StepInputs
from swarmssm.models.batch import presence
from swarmssm.models.distributions.moments import covariance_of

__all__ = ["Foreseen", "filter_draws"]

LOG_2PI = math.log(2.0 * math.pi)
#: Numbers of the largest matrix of one chunk: small enough to stay near the processor.
CHUNK = 400_000

Values = Mapping[str, Tensor]


class Foreseen(NamedTuple):
    """Positions as foreseen from the frames before, scaled as the model sees them.

    Attributes
    ----------
    density
        ``(draw, trial, time, individual)``: log-density of each observed position; NaN where none
        was observed.
    joint
        ``(draw, trial, time)``: of all of a frame together; 0 where nobody was observed.
    replicates
        ``(draw, trial, time, individual, space)``: positions as they might have been observed,
        drawn together for all individuals of a frame.
    """

    density: Tensor
    joint: Tensor
    replicates: Tensor


def filter_draws(
    model: StateSpaceModel, prepared: Prepared, values: Values, draws: int, replicates: int
) -> Foreseen:
    """Foresee each frame of each trial by the extended Kalman filter, at each draw.

    The joint state of the swarm is filtered, linearised at the filtered mean: exact for a linear
    Gaussian model. Above :data:`~swarmssm.inference.filtering.layouts.JOINT_LIMIT` individuals
    each has a covariance of its own alone, and ``joint`` is the sum over individuals.

    Parameters
    ----------
    model
        With an emission whose first features are positions.
    prepared
        Tracks as the model sees them.
    values
        ``(draw, ...)`` of each parameter with a prior, by full name; of a model without any, none.
    draws
        How many there are; 1 without parameters.
    replicates
        Replicates of each draw, which stand in the place of draws: ``draws * replicates``.

    Raises
    ------
    WorkError
        If the covariance of an observation is not positive definite.
    """
    trials, _, individuals = prepared.mask.shape
    features = model.state_dim
    found = []
    with torch.no_grad(), pyro.validation_enabled(False):
        if individuals > JOINT_LIMIT and model.emission.is_linear:
            for draw in range(draws):
                own = {name: value[draw] for name, value in values.items()}
                found.append(_filter_blocks(model, prepared, own, replicates))
        else:
            pairs = torch.cartesian_prod(torch.arange(draws), torch.arange(trials))
            size = max(1, CHUNK // (individuals * features) ** 2)
            for chosen in torch.split(pairs.reshape(-1, 2), size):
                own = {name: value[chosen[:, 0]] for name, value in values.items()}
                found.append(_filter_joint(model, prepared, own, chosen[:, 1], replicates))
    density, joint = (torch.cat([part[k] for part in found]) for k in (0, 1))
    drawn = torch.cat([part[2] for part in found])
    shape = (draws, trials)
    split = torch.unflatten(drawn, 0, shape).movedim(2, 1).flatten(0, 1)
    return Foreseen(torch.unflatten(density, 0, shape), torch.unflatten(joint, 0, shape), split)


def _filter_joint(
    model: StateSpaceModel, prepared: Prepared, values: Values, trials: Tensor, replicates: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Filter rows, each a draw and a trial; the second dimension of the last result: replicates."""
    _, times, individuals = prepared.mask.shape
    space = prepared.tracks.sizes["space"]
    rows, features = len(trials), model.state_dim
    laws = _Laws(model, values, rows)
    shape = (rows, individuals, features)
    first_mean, first_covariance = laws.initial(individuals)
    observed = model.emission.is_linear
    still = laws.observe(first_mean.new_zeros(shape)) if observed else None
    size = prepared.observations.shape[-1]
    kinematic = isinstance(model.transition, KinematicTransition)
    present = presence(prepared.mask)
    density, joints, drawn = [], [], []
    mean = covariance = first_mean.flatten(-2).double()
    for time in range(times):
        there = present[trials, time]
        if time == 0:
            there_all = there.repeat_interleave(features, -1)
            mean = torch.where(there_all, first_mean.flatten(-2).double(), 0.0)
            both = there_all.unsqueeze(-1) & there_all.unsqueeze(-2)
            covariance = block_diagonal(first_covariance).double() * both
        else:
            before = present[trials, time - 1]
            graph = prepared.adjacency[trials, time - 1].to(prepared.observations.dtype)
            line = laws.step(mean.view(shape), own_blocks(covariance, individuals), graph, before)
            if not bool((there & before).all()):
                window = Window(
                    first_mean.flatten(-2).double(),
                    block_diagonal(first_covariance).double(),
                    mean.new_zeros(rows, 2, individuals * size),
                    torch.zeros(rows, 2, individuals * size, dtype=torch.bool),
                    torch.stack([before, there], 1),
                    StepInputs(None, None, None),
                    features,
                    model.transition.dt if kinematic else None,
                )
                line = window.settle_step(line, 0)
            mean = line(mean)
            covariance = line.jacobian @ covariance @ line.jacobian.mT + line.noise
            covariance = symmetrize(covariance)
        shown = laws.observe(mean.view(shape).to(prepared.observations.dtype), still)
        seen = prepared.mask[trials, time]
        observations = prepared.observations[trials, time].double()
        part, mean, covariance = _take_in(
            mean, covariance, shown, observations, seen, space, replicates
        )
        density.append(part[0])
        joints.append(part[1])
        drawn.append(part[2])
    return torch.stack(density, 1), torch.stack(joints, 1), torch.stack(drawn, 2)


class _Laws:
    """The parts of a model at the parameters of each row, linearised in one call for all rows."""

    def __init__(self, model: StateSpaceModel, values: Values, rows: int) -> None:
        self.model, self.rows = model, rows
        self.values = dict(values)

    def _each(self, function: Callable[..., Any], *arguments: Tensor) -> Any:
        """Call a function of the states of one row with its parameters, for all rows."""

        def with_own(own: dict[str, Tensor], *parts: Tensor) -> Any:
            with self.model.fixed(own):
                return function(*parts)

        return vmap(with_own, randomness="error")(self.values, *arguments)

    def initial(self, individuals: int) -> tuple[Tensor, Tensor]:
        """Return mean and covariance of first states, of each individual."""
        size = self.model.state_dim

        def moments(_: Tensor) -> tuple[Tensor, Tensor]:
            first = self.model.initial()
            spread = covariance_of(first).expand(individuals, size, size)
            return first.mean.expand(individuals, size), spread

        found: tuple[Tensor, Tensor] = self._each(moments, torch.zeros(self.rows))
        return found

    def step(self, states: Tensor, covariance: Tensor, graph: Tensor, present: Tensor) -> AffineMap:
        """Return the transition as an affine map of the joint state, in double precision."""
        dtype = graph.dtype
        states, covariance = states.to(dtype), covariance.to(dtype)
        inputs = self.model.edges.complete(states, StepInputs(graph, None, present))
        # What a rule makes of the states may be a list of edges, of which rows have different ones.
        graph = graph if inputs.adjacency is None else dense(inputs.adjacency, dtype)
        graph = graph.expand(*states.shape[:-1], states.shape[-2])

        def linearize(states: Tensor, spread: Tensor, graph: Tensor, there: Tensor) -> Any:
            return tuple(
                self.model.transition.linearize(states, StepInputs(graph, None, there), spread)
            )

        mean, jacobian, noise = self._each(linearize, states, covariance, graph, present)
        joint = states.shape[-2] * states.shape[-1]
        return AffineMap(
            states.flatten(-2).double(),
            mean.flatten(-2).double(),
            jacobian.reshape(self.rows, joint, joint).double(),
            block_diagonal(noise).double(),
        )

    def observe(self, states: Tensor, still: AffineMap | None = None) -> AffineMap:
        """Return the emission likewise; ``still`` is that of a linear one, anywhere."""
        if still is not None:
            return still
        emission = self.model.emission
        if emission.is_exact:
            raise ValueError("a model that observes states exactly has nothing to filter")
        mean, jacobian, noise = self._each(lambda at: tuple(emission.linearize(at)), states)
        return AffineMap(
            states.flatten(-2).double(),
            mean.flatten(-2).double(),
            block_diagonal(jacobian).double(),
            block_diagonal(noise).double(),
        )


def _take_in(
    mean: Tensor,
    covariance: Tensor,
    shown: AffineMap,
    observations: Tensor,
    seen: Tensor,
    space: int,
    replicates: int,
) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor, Tensor]:
    """Score a frame, draw replicates of it, and take it into the filter.

    Parameters
    ----------
    mean, covariance
        Predicted, ``(row, joint)`` and ``(row, joint, joint)``.
    shown
        Emission of all of them.
    observations, seen
        ``(row, individual, observation)`` and ``(row, individual)`` of bool.
    space
        How many of the observed features are positions; they come first.
    replicates
        How many of each row.

    Returns
    -------
    Log-densities ``(row, individual)`` and ``(row,)``, replicates ``(row, replicate, individual,
    space)``; filtered mean and covariance.
    """
    individuals, size = observations.shape[-2:]
    location = shown(mean)
    moved = shown.jacobian @ covariance
    spread = symmetrize(moved @ shown.jacobian.mT + shown.noise)
    whole = seen.repeat_interleave(size, -1)
    error = torch.where(whole, observations.flatten(-2) - location, 0.0)
    if not bool(whole.all()):
        # What was not seen is as good as 0 = 0 with noise of variance 1.
        moved = torch.where(whole.unsqueeze(-1), moved, 0.0)
        both = whole.unsqueeze(-1) & whole.unsqueeze(-2)
        eye = torch.eye(whole.shape[-1], dtype=spread.dtype, device=spread.device)
        spread = torch.where(both, spread, eye)
    factor = cholesky(spread, "of the observations")
    solved = torch.linalg.solve_triangular(
        factor, torch.cat([moved, error.unsqueeze(-1)], -1), upper=False
    )
    reach, white = solved[..., :-1], solved[..., -1]
    filtered = mean + (reach.mT @ white.unsqueeze(-1)).squeeze(-1)
    left = symmetrize(torch.baddbmm(covariance, reach.mT, reach, alpha=-1))

    places = torch.arange(individuals * size, device=mean.device)
    places = places[places % size < space]
    if size > space:
        factor = cholesky(spread[:, places][:, :, places], "of the observed positions")
        error = error[:, places]
        white = torch.linalg.solve_triangular(factor, error.unsqueeze(-1), upper=False)[..., 0]
    count = seen.sum(-1).double() * space
    joint = -0.5 * (white.square().sum(-1) + LOG_2PI * count)
    joint = joint - factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)

    own = own_blocks(spread, individuals)[..., :space, :space]
    apart = torch.unflatten(error, -1, (individuals, -1))[..., :space]
    density = _own_density(apart, own)
    noise = mean.new_empty(len(mean), replicates, len(places)).normal_()
    drawn = location[:, places].unsqueeze(1) + noise @ factor.mT
    drawn = torch.unflatten(drawn, -1, (individuals, -1))
    return (
        (
            torch.where(seen, density, torch.nan),
            joint,
            torch.where(seen[:, None, :, None], drawn, torch.nan),
        ),
        filtered,
        left,
    )


def _own_density(error: Tensor, covariance: Tensor) -> Tensor:
    """Return normal log-densities of errors ``(..., space)``."""
    factor = cholesky(covariance, "of an observation")
    white = torch.linalg.solve_triangular(factor, error.unsqueeze(-1), upper=False)
    spread = factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    density: Tensor = -0.5 * (white.square().sum((-1, -2)) + error.shape[-1] * LOG_2PI) - spread
    return density


def _filter_blocks(
    model: StateSpaceModel, prepared: Prepared, values: Values, replicates: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Filter all trials of a large swarm at one draw, each individual on its own."""
    batch = prepared.batch()
    trials, times, individuals = prepared.mask.shape
    space = prepared.tracks.sizes["space"]
    density, drawn = [], []
    with model.fixed(values):
        frames = frames_of(model, batch, "blocks")
        chain = frames.still()
        mean, covariance = chain.initial_mean, chain.initial_cov
        for time in range(times):
            if time:
                mean, matrix, noise = frames.step(
                    time - 1, frames.split(mean), frames.own(covariance)
                )
                covariance = symmetrize(matrix @ covariance @ matrix.mT + noise)
            size = chain.emission_cov.shape[-1]
            shown = AffineMap(
                torch.zeros_like(mean),
                chain.emission_offset[time],
                chain.emission_matrix[time],
                chain.emission_cov[time],
            )
            seen = prepared.mask[:, time].flatten().unsqueeze(-1)
            observations = chain.observations[time].view(-1, 1, size)
            part, mean, covariance = _take_in(
                mean, covariance, shown, observations, seen, space, replicates
            )
            density.append(part[0].view(trials, individuals))
            places = part[2].view(trials, individuals, replicates, space)
            drawn.append(places.movedim(2, 1))
    own = torch.stack(density, 1)
    return own, own.nansum(-1), torch.stack(drawn, 2)
