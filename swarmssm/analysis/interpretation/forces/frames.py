"""Walk through the frames of posterior paths: in portions, with the graph that the model sees."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
import xarray as xr

from swarmssm import forces
from swarmssm.analysis.posterior.accelerations import PosteriorPaths
from swarmssm.analysis.posterior.inferred_graph import step_inputs
from swarmssm.analysis.posterior.intervals import QUANTILES
from swarmssm.errors import InputError
from swarmssm.graphs import dense
from swarmssm.inference import Fit
from swarmssm.models import StateSpaceModel
from swarmssm.models.transitions import PerceptionRadius
from swarmssm.models.transitions.perception import sight

__all__ = [
    "OWN_COLUMNS",
    "QUANTILES",
    "Frames",
    "check_plane",
    "frames_of",
    "labels_of",
    "own_columns",
    "seen_graph",
    "unit_of",
]

#: What an individual could do by itself, with the units of the coefficients.
OWN_COLUMNS = {"velocity": "1/s", "heading": "{}/s^2", "offset": "1/s^2", "wall": "1/s^2"}
#: The wall stands at this share of half the extent of the training tracks.
WALL_AT = 0.85

#: Pairs of individuals that are worked on at once.
PAIRS_AT_ONCE = 2**18


@dataclass(frozen=True)
class Frames:
    """Some frames of one draw, those of all trials in one row.

    Attributes
    ----------
    rows
        Which of ``trial * time`` frames.
    states
        ``(frame, individual, state)``, in the tracks' own units.
    adjacency
        ``(frame, individual, individual)``, as observed.
    present
        ``(frame, individual)`` of bool.
    values
        The draw's parameters that have a prior, by full name.
    """

    rows: slice
    states: torch.Tensor
    adjacency: torch.Tensor
    present: torch.Tensor
    values: Any

    @property
    def positions(self) -> torch.Tensor:
        """``(frame, individual, space)``."""
        return self.states[..., : self.states.shape[-1] // 2]

    @property
    def velocities(self) -> torch.Tensor:
        """``(frame, individual, space)``."""
        return self.states[..., self.states.shape[-1] // 2 :]


def frames_of(paths: PosteriorPaths, draw: int) -> Iterator[Frames]:
    """Yield all frames of a draw, so few at a time that pairs of individuals fit into memory."""
    individuals = paths.states.shape[-2]
    states = paths.states[draw].flatten(0, 1)
    adjacency, present = paths.adjacency.flatten(0, 1), paths.present.flatten(0, 1)
    step = max(1, PAIRS_AT_ONCE // individuals**2)
    for first in range(0, len(states), step):
        rows = slice(first, min(first + step, len(states)))
        yield Frames(rows, states[rows], adjacency[rows], present[rows], paths.parameters[draw])


def seen_graph(fit: Fit, frames: Frames) -> torch.Tensor:
    """Return with what weight i sees j, in the model's own graph and view.

    Parameters
    ----------
    fit
        A fit.
    frames
        Frames of a draw.

    Returns
    -------
    ``(frame, individual, individual)``; 0 for who is absent, and on the diagonal.
    """
    graph = frames.adjacency
    model = fit.model
    if isinstance(model, StateSpaceModel):
        scaler = fit.preparation.scaler
        scaled = scaler.transform_tensor(frames.states)
        scaled = scaled.masked_fill(~frames.present.unsqueeze(-1), 0.0)
        with fit.with_parameters(frames.values):
            inputs = model.edges.complete(scaled, step_inputs(model, graph, frames.present))
            if inputs.adjacency is None:
                return torch.zeros_like(graph)
            graph = dense(inputs.adjacency, scaled.dtype).to(scaled.dtype)
            transition = model.transition
            view = transition.view() if isinstance(transition, PerceptionRadius) else None
            if view is not None:
                place = scaled[..., : scaled.shape[-1] // 2]
                distance = torch.cdist(place, place, compute_mode="donot_use_mm_for_euclid_dist")
                width = None if view.width is None else view.width.unsqueeze(-1)
                graph = graph * sight(distance, view.radius.unsqueeze(-1), width)[0]
    there = frames.present.unsqueeze(-1) & frames.present.unsqueeze(-2)
    itself = torch.eye(graph.shape[-1], dtype=torch.bool)
    return graph.masked_fill(~there | itself, 0.0)


def own_columns(fit: Fit, frames: Frames) -> list[torch.Tensor]:
    """Return what an individual could do by itself, as accelerations without coefficients.

    Parameters
    ----------
    fit
        A fit; its scales say where the middle and the walls are.
    frames
        Frames of a draw.

    Returns
    -------
    In the order of :data:`OWN_COLUMNS`, each ``(frame, individual, space)``: the velocity, the
    heading, the offset from the mean position, and the push of a soft wall
    (:func:`swarmssm.forces.wall`) around the inner 85 % of the extent of the training tracks.
    """
    positions, velocities, scales = frames.positions, frames.velocities, fit.scales
    low, high = positions.new_tensor(scales.low), positions.new_tensor(scales.high)
    speed = velocities.norm(dim=-1, keepdim=True)
    return [
        velocities,
        velocities / torch.where(speed > 0, speed, 1.0),
        positions - positions.new_tensor(scales.centre),
        forces.wall(positions, 0.5 * WALL_AT * (high - low), 0.5 * (low + high)),
    ]


def labels_of(tracks: xr.Dataset, *dims: str) -> dict[str, Any]:
    """Return the coordinates of tracks along the given dimensions."""
    return {dim: tracks[dim].to_numpy() for dim in dims if dim in tracks.coords}


def unit_of(tracks: xr.Dataset, per: str = "") -> str:
    """Return the unit of length of tracks, with what stands behind it such as ``/s^2``."""
    return f"{tracks.attrs.get('unit') or 'length units'}{per}"


def check_plane(tracks: xr.Dataset, what: str) -> None:
    """Refuse tracks in three dimensions.

    Raises
    ------
    InputError
        If they have other than two.
    """
    if tracks.sizes["space"] != 2:
        raise InputError(
            f"tracks: {what} is made for two dimensions, and these have {tracks.sizes['space']}. "
            "Give two of the coordinates."
        )
