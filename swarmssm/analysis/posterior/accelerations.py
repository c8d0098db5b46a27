"""How a fitted model says that individuals move, in the tracks' own units: accelerations, terms.

All that this folder says of forces, kernels and influence is computed from these two questions to
a model: what does it take the states to have been, and what does it expect of each next.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import pyro
import torch
import xarray as xr

from swarmssm.analysis.posterior.inferred_graph import graph_of_steps, step_inputs
from swarmssm.errors import InputError
from swarmssm.graphs import Graph, dense
from swarmssm.inference import Fit
from swarmssm.inference.guides import OneStepGuide, PathGuide
from swarmssm.inference.prediction import seeded
from swarmssm.models import OneStepModel, StateSpaceModel, StepInputs
from swarmssm.models.pyro_modules import own_parameters
from swarmssm.models.transitions import NamedForces
from swarmssm.tracks.scaling import Scaler

__all__ = ["AccelerationModel", "PosteriorPaths", "acceleration_model", "posterior_paths"]

Values = Mapping[str, torch.Tensor]


@dataclass(frozen=True)
class PosteriorPaths:
    """Draws of what the states of a recording were, with the parameters they go with.

    Attributes
    ----------
    states
        ``(draw, trial, time, individual, state)``, double precision, in the tracks' own units; 0
        where ``present`` is false.
    present
        ``(trial, time, individual)`` of bool: the state is known.
    adjacency
        ``(trial, time, individual, individual)`` of 0.0 and 1.0: the graph as observed. A model
        with latent edges makes its own. Of one with inferred edges it is
        ``(trial, time, individual, individual, type)``: how likely each type is.
    parameters
        For each draw the parameters that have a prior, by full name.
    tracks
        The tracks as the model saw them: with trials, velocities and adjacency.
    """

    states: torch.Tensor
    present: torch.Tensor
    adjacency: torch.Tensor
    parameters: tuple[Values, ...]
    tracks: xr.Dataset

    @property
    def draws(self) -> int:
        """Number of draws."""
        return len(self.parameters)


def posterior_paths(
    fit: Fit, tracks: xr.Dataset, draws: int = 20, seed: int | torch.Generator = 0
) -> PosteriorPaths:
    """Draw states and parameters from the posterior, given all frames.

    A model that takes states as exactly observed has the same ones in every draw.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or others.
    draws
        How many.
    seed
        Seed or generator.

    Raises
    ------
    InputError
        If ``draws`` is not positive, the model cannot predict, or the tracks do not fit it.
    """
    if draws < 1:
        raise InputError(f"draws: there must be at least 1, not {draws}.")
    prepared = fit.prepare(tracks)
    with seeded(seed):
        states, parameters = fit.predictor().paths(prepared, draws)
    states = fit.preparation.scaler.inverse_tensor(states.to(torch.float64))
    present = states.isfinite().all(-1).all(0)
    return PosteriorPaths(
        states.masked_fill(~present.unsqueeze(-1), 0.0),
        present,
        graph_of_steps(fit, prepared).to(torch.float64),
        parameters,
        prepared.tracks,
    )


class AccelerationModel(ABC):
    """The law of motion of a fitted model, on tensors in the tracks' own units.

    Attributes
    ----------
    space
        Number of spatial dimensions.
    dt
        Seconds from one frame to the next.
    terms
        Names of the forces that the model is built of, in the order of :meth:`forces`; empty for
        one that has none.
    forgets_velocity
        Whether forces add up to the next velocity, so that the old one is lost.
    """

    space: int
    dt: float
    terms: tuple[str, ...] = ()
    forgets_velocity: bool = False

    @abstractmethod
    def acceleration(
        self,
        states: torch.Tensor,
        adjacency: Graph,
        present: torch.Tensor | None = None,
        values: Values | None = None,
    ) -> torch.Tensor:
        r"""Return the expected acceleration, :math:`(E[v_{t+1} \mid z_t] - v_t) / dt`.

        Differentiable by the states, but for the graph that a rule makes of them.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        adjacency
            ``(..., individual, individual)``, or a list of edges.
        present
            ``(..., individual)`` of bool; ``None`` if all are there.
        values
            Of the parameters that have a prior, by full name; ``None``: the middle of
            the posterior.

        Returns
        -------
        ``(..., individual, space)``; 0 for who is absent.
        """

    def forces(
        self,
        states: torch.Tensor,
        adjacency: Graph,
        present: torch.Tensor | None = None,
        values: Values | None = None,
    ) -> torch.Tensor:
        """Return what each of :attr:`terms` contributes to the acceleration.

        Parameters
        ----------
        states, adjacency, present, values
            As in :meth:`acceleration`.

        Returns
        -------
        ``(..., term, individual, space)``; 0 for who is absent.

        Raises
        ------
        InputError
            If the model has no named terms.
        """
        raise InputError("model: it has no named forces, only accelerations as a whole.")


def acceleration_model(fit: Fit) -> AccelerationModel:
    """Return the law of motion of a fit.

    Raises
    ------
    InputError
        If it is neither a :class:`~swarmssm.models.StateSpaceModel` of physical states nor a
        :class:`~swarmssm.models.OneStepModel` with a guide that encodes frames.
    """
    scaler = fit.preparation.scaler
    if isinstance(fit.model, StateSpaceModel):
        if fit.model.state_dim != len(scaler.offset):
            raise InputError(
                f"model: its states have {fit.model.state_dim} features, and to speak of forces "
                f"they must be positions and velocities, {len(scaler.offset)} of them."
            )
        middle = fit.guide.parameters_guide.median() if isinstance(fit.guide, PathGuide) else {}
        return _StateSpaceMotion(fit.model, scaler, fit.scales.dt, middle)
    if isinstance(fit.model, OneStepModel) and isinstance(fit.guide, OneStepGuide):
        return _OneStepMotion(fit.model, fit.guide, scaler, fit.scales.dt)
    raise InputError(
        f"model: {fit.settings.model} with guide {fit.settings.guide} has no law of motion to look "
        "at; it must be a StateSpaceModel, or a OneStepModel with a OneStepGuide."
    )


def _alone(accelerations: torch.Tensor, present: torch.Tensor | None) -> torch.Tensor:
    """Return accelerations, 0 for who is absent."""
    return accelerations if present is None else accelerations * present.unsqueeze(-1)


class _StateSpaceMotion(AccelerationModel):
    """A transition, with the edges that its model says."""

    def __init__(self, model: StateSpaceModel, scaler: Scaler, dt: float, middle: Values) -> None:
        self.model, self.scaler, self.dt, self.middle = model, scaler, dt, middle
        self.space = model.state_dim // 2
        transition = model.transition
        self.named = transition if isinstance(transition, NamedForces) else None
        if self.named is not None:
            self.terms = tuple(self.named.terms)
            self.forgets_velocity = bool(self.terms) and self.named.form == "velocity"
        self.dtype = next(
            (t.dtype for t in (*model.parameters(), *model.buffers()) if t.is_floating_point()),
            torch.get_default_dtype(),
        )

    def acceleration(
        self,
        states: torch.Tensor,
        adjacency: Graph,
        present: torch.Tensor | None = None,
        values: Values | None = None,
    ) -> torch.Tensor:
        """Return the expected acceleration; see :meth:`Motion.acceleration`."""
        scaled, inputs = self._scaled(states, adjacency, present)
        with self._given(values), pyro.validation_enabled(False):
            following = self.model.step(scaled, inputs).mean
        moved = self.scaler.inverse_tensor(following.to(states.dtype))
        change = moved[..., self.space :] - states[..., self.space :]
        return _alone(change / self.dt, present)

    def forces(
        self,
        states: torch.Tensor,
        adjacency: Graph,
        present: torch.Tensor | None = None,
        values: Values | None = None,
    ) -> torch.Tensor:
        """Return the named terms; see :meth:`Motion.forces`."""
        if self.named is None or not self.terms:
            return super().forces(states, adjacency, present, values)
        scaled, inputs = self._scaled(states, adjacency, present)
        with self._given(values), pyro.validation_enabled(False):
            inputs = self.model.edges.complete(scaled, inputs)
            found: torch.Tensor = self.named.forces(scaled, inputs).to(states.dtype)
        found = found * states.new_tensor(self.scaler.scale)[self.space :]
        if self.forgets_velocity:
            found = found / self.dt
        return found if present is None else found * present[..., None, :, None]

    @contextlib.contextmanager
    def _given(self, values: Values | None) -> Iterator[None]:
        """Let the parameters have given values, or the middle ones."""
        held = self.middle if values is None else values
        with own_parameters(self.model), self.model.fixed(held):
            yield

    def _scaled(
        self, states: torch.Tensor, adjacency: Graph, present: torch.Tensor | None
    ) -> tuple[torch.Tensor, StepInputs]:
        """Return states and inputs as the model takes them."""
        if isinstance(adjacency, torch.Tensor):
            adjacency = adjacency.to(self.dtype)
        scaled = self.scaler.transform_tensor(states)
        if present is not None:
            scaled = scaled.masked_fill(~present.unsqueeze(-1), 0.0)
        return scaled.to(self.dtype), step_inputs(self.model, adjacency, present)


class _OneStepMotion(AccelerationModel):
    """Encode a frame, decode the next, at the mean of the latent states."""

    def __init__(self, model: OneStepModel, guide: OneStepGuide, scaler: Scaler, dt: float) -> None:
        self.model, self.guide, self.scaler, self.dt = model, guide, scaler, dt
        self.space = len(scaler.offset) // 2

    def acceleration(
        self,
        states: torch.Tensor,
        adjacency: Graph,
        present: torch.Tensor | None = None,
        values: Values | None = None,
    ) -> torch.Tensor:
        """Return the expected acceleration; see :meth:`Motion.acceleration`."""
        scaled = self.scaler.transform_tensor(states).to(torch.get_default_dtype())
        if present is not None:
            scaled = scaled.masked_fill(~present.unsqueeze(-1), 0.0)
        graph = dense(adjacency, scaled.dtype)
        with own_parameters(self.model, self.guide), pyro.validation_enabled(False):
            latent = self.guide.encode(scaled, graph.to(scaled.dtype)).mean
            following = self.model.decode(latent).states.mean
        moved = self.scaler.inverse_tensor(following.to(states.dtype))
        change = moved[..., self.space :] - states[..., self.space :]
        return _alone(change / self.dt, present)
