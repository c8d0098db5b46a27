r"""The collapsed evidence :math:`\log p(x_{1:T} \mid \theta)`: the latents summed out."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from swarmssm.inference.filtering.adjoint import (
    AffineChain,
    ForwardPass,
    chain_evidence,
    chain_smooth,
    filter_chain,
    linearized_evidence,
)
from swarmssm.inference.filtering.kalman_filter import extended_kalman, smooth
from swarmssm.inference.filtering.layouts import (
    JOINT_LIMIT,
    Frames,
    Layout,
    Points,
    frames_of,
)
from swarmssm.inference.filtering.positions import PositionPath
from swarmssm.models import KinematicTransition, StateSpaceModel, SwarmBatch

__all__ = ["Method", "Points", "collapsed_evidence", "linearization_points"]

Method = Literal["extended", "iterated"]
ITERATIONS = 20
#: Points are settled when they move by less than this part of their own standard deviation.
TOLERANCE = 1e-3


def collapsed_evidence(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor] | None = None,
    *,
    method: Method = "iterated",
    layout: Layout = "auto",
    points: Points | None = None,
    iterations: int = ITERATIONS,
    given: int = 0,
) -> Tensor:
    r"""Return the log-density of what was observed in each window, the latent path summed out.

    Exact for linear-Gaussian models. Others are linearised:

    * ``"extended"``, at the filtered mean, as the filter goes (the extended Kalman filter);
    * ``"iterated"``, at the path that maximises :math:`p(z_{1:T}, x_{1:T})`, found by Gauss-Newton
      steps that each are a Kalman smoother (Bell, 1994, SIAM J. Optim. 4:626). The evidence then
      is Laplace's approximation of the integral over paths with the curvature of Gauss and Newton.
      Being about the posterior path and not about a prediction, it is the more accurate one, and
      all frames are linearised in one batched call.

    The result is differentiable once in ``values`` and in the model's own parameters. For
    ``"extended"`` the derivative is that of the filter, the moving of its points included. For
    ``"iterated"`` the points are held: by Fisher's identity the derivative is the mean of
    :math:`\partial_\theta \log p(z, x \mid \theta)` over the linearised posterior of the path,
    and is as accurate as that posterior. Give ``points`` for a function whose derivative
    is exactly this one, to be maximised or sampled.

    Parameters
    ----------
    model
        With an emission.
    batch
        Windows.
    values
        Of the parameters with a prior, by full name; those that are left out must be fixed by
        the caller.
    method
        See above.
    layout
        ``"joint"``: the covariance of the whole swarm; ``"blocks"``: each individual's own
        (:mod:`swarmssm.inference.filtering.blocks`); ``"auto"``: joint up to 30 individuals.
    points
        Of ``"iterated"``: linearise here and do not iterate.
    iterations
        Of ``"iterated"``, at most.
    given
        Frames at the beginning of each window that are given and not scored: the result is
        :math:`\log p(x_{k+1:T} \mid x_{1:k}, \theta)`. Few real groups begin as
        :class:`swarmssm.models.InitialStates` says, each individual for itself. How fast a group
        forgets its beginning depends on its gains, so that this misfit biases them, and a wide
        prior on first states does not prevent it; once the filter has forgotten the
        beginning, nothing is left of it. 10 to 20 frames are enough where one or two frames of
        tracking noise are a frame's displacement.

    Returns
    -------
    ``(batch,)``, in nats; without window weights.

    Raises
    ------
    ValueError
        If the model has no emission, a name is unknown, or nothing is left to be scored.
    WorkError
        If a covariance of the innovations is not positive definite.
    """
    values = {} if values is None else values
    if not 0 <= given < batch.num_times:
        raise ValueError(f"given must be from 0 to {batch.num_times - 1}, and it is {given}")
    if given:
        if method == "iterated" and points is None:
            points = linearization_points(
                model, batch, values, layout=layout, iterations=iterations
            )
        begin = None if points is None else Points(*(part[:, :given] for part in points))
        whole = collapsed_evidence(
            model, batch, values, method=method, layout=layout, points=points
        )
        return whole - collapsed_evidence(
            model, _beginning(batch, given), values, method=method, layout=layout, points=begin
        )
    if method == "extended":
        return _extended(model, batch, values, layout)
    if method != "iterated":
        raise ValueError(f"method must be 'extended' or 'iterated', not {method!r}")
    if points is None:
        points = linearization_points(model, batch, values, layout=layout, iterations=iterations)
    with model.fixed(values):
        if _in_positions(model, batch, layout):
            path = PositionPath(model, batch)
            return path.evidence(path.expand(points))
        frames = frames_of(model, batch, layout)
        return frames.total(chain_evidence(frames.about(points)))


def linearization_points(
    model: StateSpaceModel,
    batch: SwarmBatch,
    values: Mapping[str, Tensor] | None = None,
    *,
    layout: Layout = "auto",
    start: Points | None = None,
    iterations: int = ITERATIONS,
) -> Points:
    """Return the most probable path and its spread, without gradient.

    Parameters
    ----------
    model, batch, values, layout
        As in :func:`collapsed_evidence`.
    start
        A path to begin with, such as that of other values; absent, the smoothed path of the
        extended Kalman filter.
    iterations
        At most; less if the path moves no more. A transition with kinks may go to and fro
        between two paths that differ by less than their standard deviation.
    """
    values = {} if values is None else {k: v.detach() for k, v in values.items()}
    with torch.no_grad(), model.fixed(values):
        if _in_positions(model, batch, layout):
            path = PositionPath(model, batch)
            return path.maximise(path.start() if start is None else start, iterations)
        frames = frames_of(model, batch, layout)
        if start is None:
            start = _smoothed(frames, model, batch, values)
        for _ in range(iterations):
            found = frames.points(*chain_smooth(frames.about(start)))
            spread = found.covariance.diagonal(dim1=-2, dim2=-1).clamp(min=0.0).sqrt()
            moved = (found.mean - start.mean).abs()
            start = found
            if not bool((moved > TOLERANCE * spread).any()):
                break
        return start


def _beginning(batch: SwarmBatch, frames: int) -> SwarmBatch:
    """Return the first frames of each window."""
    adjacency = batch.adjacency
    return replace(
        batch,
        observations=batch.observations[:, :frames],
        mask=batch.mask[:, :frames],
        adjacency=adjacency[:, :frames]
        if isinstance(adjacency, Tensor)
        else adjacency.select(1, 0, frames),
        present=batch.present[:, :frames],
        controls=None if batch.controls is None else batch.controls[:, :frames],
        edge_types=None if batch.edge_types is None else batch.edge_types[:, :frames],
    )


def _in_positions(model: StateSpaceModel, batch: SwarmBatch, layout: Layout) -> bool:
    """Return whether paths are told by positions, so that a band replaces the filter."""
    joint = layout == "joint" or (layout == "auto" and batch.num_individuals <= JOINT_LIMIT)
    return joint and isinstance(model.transition, KinematicTransition)


def _extended(
    model: StateSpaceModel, batch: SwarmBatch, values: Mapping[str, Tensor], layout: Layout
) -> Tensor:
    """Filter without a graph, and hang the derivative on afterwards."""
    if not model.emission.is_linear:
        return extended_kalman(model, batch, values).log_evidence
    lines: dict[int, tuple[Tensor, ...]] = {}
    still = {name: value.detach() for name, value in values.items()}
    needed = torch.is_grad_enabled() and (
        any(value.requires_grad for value in values.values())
        or any(parameter.requires_grad for parameter in model.parameters())
    )
    with model.fixed(still):
        frames = frames_of(model, batch, layout)
        run, _ = _filter(frames, lines if needed else None)
    if not needed:
        return frames.total(run.evidence)

    def pullback(step: int, mean: Tensor, matrix: Tensor, noise: Tensor) -> Tensor:
        states, *line = lines.pop(step)
        pairs = zip(line, (mean, matrix, noise), strict=True)
        outputs, cotangents = zip(*[pair for pair in pairs if pair[0].requires_grad], strict=True)
        (moved,) = torch.autograd.grad(outputs, states, cotangents)
        return frames.flat(moved)

    with model.fixed(values):
        frames = frames_of(model, batch, layout)
        points = frames.points(run.filtered_mean, run.filtered_covariance)
        chain = frames.about(points, offsets=False)
        return frames.total(linearized_evidence(chain, run, pullback))


def _smoothed(
    frames: Frames, model: StateSpaceModel, batch: SwarmBatch, values: Mapping[str, Tensor]
) -> Points:
    """Return the smoothed path of the extended Kalman filter."""
    if frames.emission.is_linear:
        run, chain = _filter(frames)
        return frames.points(*chain_smooth(chain, run))
    found = smooth(extended_kalman(model, batch, values))
    return Points(found.mean, found.own_covariance)


def _filter(
    frames: Frames, lines: dict[int, tuple[Tensor, ...]] | None = None
) -> tuple[ForwardPass, AffineChain]:
    """Run the extended Kalman filter; note the graph of each step, if there is a place for it."""
    matrices, offsets, noises = [], [], []

    def predict(step: int, mean: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        states = frames.split(mean).detach()
        with torch.set_grad_enabled(lines is not None):
            if lines is not None:
                states.requires_grad_()
            line = frames.step(step, states, frames.own(covariance))
            if lines is not None:
                lines[step] = (states, *line)
        following, matrix, noise = (part.detach() for part in line)
        if lines is None:
            matrices.append(matrix)
            offsets.append(following - (matrix @ mean.unsqueeze(-1)).squeeze(-1))
            noises.append(noise)
        return following, matrix, noise

    with torch.no_grad():
        chain = frames.still()
        run = filter_chain(chain, predict)
        if lines is None and matrices:
            chain = chain._replace(
                transition_matrix=torch.stack(matrices),
                offset=torch.stack(offsets),
                process_cov=torch.stack(noises),
            )
    return run, chain
