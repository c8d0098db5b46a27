"""The model's own smoother as a guide: no network, exact where the model is linear Gaussian."""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, get_args

import torch
from torch.func import vmap

from swarmssm.errors import InputError, WorkError
from swarmssm.inference.filtering.evidence import ITERATIONS, linearization_points
from swarmssm.inference.filtering.kalman_filter import (
    Filtered,
    filtered_at,
    kalman,
    smooth,
)
from swarmssm.inference.filtering.layouts import JOINT_LIMIT, Frames, Layout, Points, frames_of
from swarmssm.inference.filtering.matrices import root
from swarmssm.inference.filtering.paths import draw_paths, path_log_density
from swarmssm.inference.guides.base import PathGuide
from swarmssm.models import InferredEdges, KinematicTransition, StateSpaceModel, SwarmBatch

__all__ = ["Globals", "LinearizedGuide"]

#: Frames after which the beginning of a window is mostly forgotten.
GIVEN = 15
#: Numbers of the covariances of one chunk of draws: small enough to stay near the processor.
CHUNK = 400_000
#: How the parameters with a prior are fitted.
Globals = Literal["laplace", "multivariate", "normal"]


class LinearizedGuide(PathGuide):
    r"""Paths from the smoother of the linearised model.

    The model is linearised at its most probable path given the window (a Gauss-Newton iteration of
    Kalman smoothers), and :math:`q(z_{1:T} \mid x_{1:T}, \theta)` is the posterior of that
    linear-Gaussian model. Of a linear-Gaussian model it is the exact posterior: then
    :math:`\log p(x, z) - \log q(z)` is the log evidence, whatever path was drawn.

    Of a transition with hard limits (``is_smooth`` false) it is the linearised model's, in which
    the limits are averaged over: good for paths and for the evidence, but its draws may lie a
    little beyond the limits, where the model's own density is none, so that it has no ELBO.

    There is nothing to train in it. Parameters of the model are fitted with the paths summed out,
    by :func:`swarmssm.inference.fit_collapsed`.

    Parameters
    ----------
    model
        With an emission, and a transition in which noise moves all features or, as a
        :class:`swarmssm.models.KinematicTransition`, the velocities.
    globals
        How the parameters with a prior are fitted: ``"laplace"``, by a normal about the most
        probable values on the unconstrained scale; ``"multivariate"`` or ``"normal"``, by
        stochastic variational inference with or without correlations, as always where edges are
        inferred: then ``"laplace"`` stands for ``"multivariate"``.
    layout
        ``"joint"``, ``"blocks"`` or ``"auto"``, see
        :func:`swarmssm.inference.filtering.collapsed_evidence`.
    iterations
        Of the search for the most probable path, at most.
    given
        Frames at the beginning of each window that are given and not scored when parameters are
        fitted, a quarter of the window at most; see
        :func:`swarmssm.inference.filtering.collapsed_evidence` for what they prevent.

    Raises
    ------
    InputError
        If the model is none of those above, or an option is unknown.
    """

    window: ClassVar[int | None] = 150

    def __init__(
        self,
        model: StateSpaceModel,
        globals: Globals = "laplace",
        layout: Layout = "auto",
        iterations: int = ITERATIONS,
        given: int = GIVEN,
    ) -> None:
        _check(model)
        if not isinstance(given, int) or given < 0:
            raise InputError(f"given: it must be a number of frames, 0 or more, not {given!r}.")
        if globals not in get_args(Globals):
            raise InputError(f"globals: choose {', '.join(get_args(Globals))}, not {globals!r}.")
        if layout not in get_args(Layout):
            raise InputError(f"layout: choose {', '.join(get_args(Layout))}, not {layout!r}.")
        if globals == "laplace" and isinstance(model.edges, InferredEdges):
            # An encoder of edges has too many weights for a matrix of curvatures.
            globals = "multivariate"
        super().__init__(model, "multivariate" if globals == "laplace" else globals)
        self.globals = globals
        self.layout: Layout = layout
        self.iterations = iterations
        self.given = given

    def path(
        self, batch: SwarmBatch, values: Mapping[str, torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw a path for each window, differentiably in the parameters at held points."""
        return self._path(batch, values, None)

    def paths(
        self, batch: SwarmBatch, values: Sequence[Mapping[str, torch.Tensor]]
    ) -> torch.Tensor:
        """Draw paths with each of some draws of the parameters; see :meth:`PathGuide.paths`.

        Each most probable path is sought from that of the parameters' median, which is near.
        """
        middle = self.parameters_guide.median()
        start = linearization_points(
            self.model, batch, middle, layout=self.layout, iterations=self.iterations
        )
        return torch.stack([self._path(batch, drawn, start)[0] for drawn in values])

    def _path(
        self, batch: SwarmBatch, values: Mapping[str, torch.Tensor], start: Points | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw a path for each window, its most probable one being near ``start``."""
        frames, filtered = self._filter(batch, values, start)
        rows = draw_paths(filtered, 1)
        density = path_log_density(filtered, rows).squeeze(0)
        dtype = batch.observations.dtype
        return frames.paths(rows.squeeze(0)).to(dtype), frames.total(density).to(dtype)

    def can_filter(self, num_individuals: int) -> bool:
        """Return whether the joint state of so many individuals is filtered in one pass.

        The average model of a larger swarm is searched as in :meth:`path`.
        """
        return self.layout != "blocks" and num_individuals <= JOINT_LIMIT and not self.has_edges

    def last_state(
        self, batch: SwarmBatch, values: Mapping[str, torch.Tensor], draws: int
    ) -> torch.Tensor:
        """Draw the last state of each window by the extended Kalman filter alone.

        No later frame could improve the linearisation, and the filter goes through the window once.
        See :meth:`PathGuide.last_state`.
        """
        if batch.num_individuals > JOINT_LIMIT or self.layout == "blocks":
            return super().last_state(batch, values, draws)
        mean, covariance = filtered_at(self.model, batch, values, *_ends(batch))
        return mean if not draws else _about(mean, covariance, draws)

    def last_states(
        self, batch: SwarmBatch, values: Sequence[Mapping[str, torch.Tensor]]
    ) -> torch.Tensor:
        """Draw the last state of each window with each of some draws of the parameters.

        See :meth:`PathGuide.last_states` and :meth:`filtered_states`.
        """
        if batch.num_individuals > JOINT_LIMIT or self.layout == "blocks":
            return super().last_states(batch, values)
        return self.filtered_states(batch, values, *_ends(batch))

    def filtered_states(
        self,
        batch: SwarmBatch,
        values: Sequence[Mapping[str, torch.Tensor]],
        windows: torch.Tensor,
        frames: torch.Tensor,
    ) -> torch.Tensor:
        """Draw the states of some frames given those up to each, with each draw of the parameters.

        One filter goes through the windows for many draws of the parameters.

        Parameters
        ----------
        batch
            Windows of a swarm that :meth:`can_filter` allows.
        values
            Drawn parameters, by full name, one draw after the other.
        windows, frames
            ``(origin,)``: window and frame of each state.

        Returns
        -------
        ``(draw, origin, individual, state)``.
        """

        def at(own: Mapping[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
            return filtered_at(self.model, batch, own, windows, frames)

        def one_by_one() -> torch.Tensor:
            return torch.stack([_about(*at(drawn), 1)[0] for drawn in values])

        if not values[0]:
            return _about(*at({}), len(values))
        stacked = {name: torch.stack([drawn[name] for drawn in values]) for name in values[0]}
        each = len(batch) * (batch.num_individuals * self.model.state_dim) ** 2
        try:
            mean, covariance = vmap(at, chunk_size=max(1, CHUNK // each))(stacked)
        except WorkError:
            raise
        except RuntimeError:
            # A transition or edges whose course depends on numbers, which vmap cannot follow.
            return one_by_one()
        return torch.stack([_about(m, c, 1)[0] for m, c in zip(mean, covariance, strict=True)])

    def filtered_mean(
        self,
        batch: SwarmBatch,
        values: Mapping[str, torch.Tensor],
        windows: torch.Tensor,
        frames: torch.Tensor,
    ) -> torch.Tensor:
        """Return the mean of the states of some frames given those up to each.

        Parameters
        ----------
        batch, windows, frames
            As in :meth:`filtered_states`.
        values
            Parameters, by full name.

        Returns
        -------
        ``(origin, individual, state)``.
        """
        return filtered_at(self.model, batch, values, windows, frames)[0]

    def mean_path(self, batch: SwarmBatch, values: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return the smoothed mean of each window; see :meth:`PathGuide.mean_path`."""
        frames, filtered = self._filter(batch, values)
        return frames.paths(smooth(filtered).mean).to(batch.observations.dtype)

    def _filter(
        self,
        batch: SwarmBatch,
        values: Mapping[str, torch.Tensor],
        start: Points | None = None,
    ) -> tuple[Frames, Filtered]:
        """Filter windows with the model linearised at their most probable path."""
        points = linearization_points(
            self.model, batch, values, layout=self.layout, start=start, iterations=self.iterations
        )
        with self.model.fixed(values):
            frames = frames_of(self.model, batch, self.layout)
            return frames, kalman(frames.system(points))


def _ends(batch: SwarmBatch) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the last frame of each window, as windows and frames."""
    windows = torch.arange(len(batch), device=batch.mask.device)
    return windows, torch.full_like(windows, batch.num_times - 1)


def _about(mean: torch.Tensor, covariance: torch.Tensor, draws: int) -> torch.Tensor:
    """Draw states ``(draw, batch, individual, state)`` about a mean."""
    factor = root(covariance)
    noise = mean.new_empty(draws, *factor.shape[:-1]).normal_()
    return mean + (factor @ noise.unsqueeze(-1)).reshape(draws, *mean.shape)


def _check(model: StateSpaceModel) -> None:
    """Refuse a model whose paths a linearised smoother cannot draw."""
    transition = model.transition
    name = type(transition).__name__
    if model.emission.is_exact:
        raise InputError(
            "guide: a linearized guide draws hidden states, and this model's are observed exactly; "
            "choose 'parameters'."
        )
    if not isinstance(transition, KinematicTransition) and (
        transition.noise_dim != transition.state_dim
    ):
        raise InputError(
            f"guide: a linearized guide needs a KinematicTransition, or a transition that moves "
            f"all {transition.state_dim} features of a state by noise, and {name} moves "
            f"{transition.noise_dim} of them."
        )
