"""How the acceleration that a fitted model expects of one individual hangs on the states of all."""

import pyro
import torch

from swarmssm.analysis.posterior.accelerations import AccelerationModel, Values
from swarmssm.analysis.posterior.inferred_graph import step_inputs
from swarmssm.inference import Fit
from swarmssm.models import StateSpaceModel
from swarmssm.models.transitions import KinematicTransition

__all__ = ["acceleration_jacobian", "has_closed_form"]


def has_closed_form(fit: Fit) -> bool:
    """Return whether the model's transition knows its own derivatives."""
    if not isinstance(fit.model, StateSpaceModel):
        return False
    transition = fit.model.transition
    if not isinstance(transition, KinematicTransition):
        return False
    own = type(transition).linearize_velocity
    return own is not KinematicTransition.linearize_velocity


def acceleration_jacobian(
    fit: Fit,
    motion: AccelerationModel,
    states: torch.Tensor,
    adjacency: torch.Tensor,
    present: torch.Tensor,
    values: Values,
    *,
    closed_form: bool | None = None,
) -> torch.Tensor:
    r"""Return :math:`\partial a_i / \partial z_j`, with :math:`a_i = (E[v'_i \mid z] - v_i) / dt`.

    The graph is held: a neighbour that comes into view or leaves it has no derivative where a rule
    says so at once.

    Parameters
    ----------
    fit, motion
        A fit, and its law of motion.
    states
        ``(frame, individual, state)``, in the tracks' own units.
    adjacency
        ``(frame, individual, individual)``, as observed.
    present
        ``(frame, individual)`` of bool.
    values
        Of the parameters that have a prior, by full name.
    closed_form
        By the transition's own linearisation, or by reverse-mode differentiation; absent: the
        former where there is one.

    Returns
    -------
    ``(frame, individual, space, individual, state)``, ``[f, i, a, j, b]``: what feature b of j does
    to coordinate a of the acceleration of i. In 1 / s^2 for positions and 1 / s for velocities; 0
    for who is absent.
    """
    if closed_form is None:
        closed_form = has_closed_form(fit)
    if closed_form:
        found = _linearized(fit, motion, states, adjacency, present, values)
    else:
        found = _differentiated(motion, states, adjacency, present, values)
    there = present[:, :, None, None, None] & present[:, None, None, :, None]
    return found * there


def _linearized(
    fit: Fit,
    motion: AccelerationModel,
    states: torch.Tensor,
    adjacency: torch.Tensor,
    present: torch.Tensor,
    values: Values,
) -> torch.Tensor:
    """Return the Jacobian as the transition knows it, brought to the tracks' units."""
    model = fit.model
    assert isinstance(model, StateSpaceModel)
    assert isinstance(model.transition, KinematicTransition)
    scaler = fit.preparation.scaler
    scaled = scaler.transform_tensor(states).masked_fill(~present.unsqueeze(-1), 0.0)
    dtype = next(
        (t.dtype for t in (*model.parameters(), *model.buffers()) if t.is_floating_point()),
        torch.get_default_dtype(),
    )
    scaled = scaled.to(dtype)
    inputs = step_inputs(model, adjacency.to(dtype), present)
    with torch.no_grad(), fit.with_parameters(values), pyro.validation_enabled(False):
        inputs = model.edges.complete(scaled, inputs)
        following = model.transition.linearize_velocity(scaled, inputs).jacobian.to(states.dtype)
    scale = states.new_tensor(scaler.scale)
    following = following * scale[motion.space :, None, None] / scale
    # By one's own velocity, the change is one less than the next velocity.
    space, individuals = motion.space, states.shape[-2]
    lift = torch.zeros(space, 2 * space, dtype=states.dtype)
    lift[:, space:] = torch.eye(space, dtype=states.dtype)
    each = torch.eye(individuals, dtype=states.dtype)
    return (following - each[:, None, :, None] * lift[:, None, :]) / motion.dt


def _differentiated(
    motion: AccelerationModel,
    states: torch.Tensor,
    adjacency: torch.Tensor,
    present: torch.Tensor,
    values: Values,
) -> torch.Tensor:
    """Return the Jacobian by one backward pass for each coordinate of each individual.

    Frames do not know of each other, so that a pass through the sum over frames gives all of them.
    """
    with torch.enable_grad():
        leaf = states.detach().clone().requires_grad_()
        moved = motion.acceleration(leaf, adjacency, present, values)
        if not moved.requires_grad:
            return states.new_zeros(*moved.shape, *states.shape[-2:])
        summed = moved.sum(0).flatten()
        rows = [
            torch.autograd.grad(
                entry, leaf, retain_graph=index + 1 < len(summed), materialize_grads=True
            )[0]
            for index, entry in enumerate(summed)
        ]
    return torch.stack(rows, 1).reshape(*moved.shape, *states.shape[-2:])
