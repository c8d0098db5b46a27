"""What an individual's neighbours do to it, as features of a regression of its acceleration."""

from typing import ClassVar

import numpy as np
import torch

from swarmssm import forces
from swarmssm.analysis.scoring.baseline import Baseline
from swarmssm.graphs import GraphRule
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["AccelerationBaseline", "accelerations", "social_terms"]

#: So many pairs of individuals are taken at once.
PAIRS_AT_ONCE = 2**21


def social_terms(states: Array, rule: GraphRule | None, exponent: float = 1.0) -> Array:
    r"""Return cohesion, separation and alignment of everybody, (3.16) to (3.18) of the thesis.

    Alignment is the neighbours' mean velocity less one's own.

    Parameters
    ----------
    states
        Shape ``(..., individual, state)``; who is not known moves nobody.
    rule
        Who sees whom; ``None``: everybody sees everybody.
    exponent
        *n* of the separation.

    Returns
    -------
    Shape ``(..., individual, 3 * space)``, the terms one after the other. 0 for who sees nobody.
    """
    frames = np.where(known(states)[..., None], states, np.nan)
    frames = frames.reshape(-1, *states.shape[-2:])
    rule = GraphRule("complete") if rule is None else rule
    individuals = states.shape[-2]
    portion = max(1, PAIRS_AT_ONCE // individuals**2)
    found = np.empty((*frames.shape[:-1], 3 * (states.shape[-1] // 2)))
    for start in range(0, len(frames), portion):
        part = torch.from_numpy(np.ascontiguousarray(frames[start : start + portion]))
        positions, velocities = part.chunk(2, dim=-1)
        graph = rule(positions, velocities)
        terms = [
            forces.cohesion(positions, graph),
            forces.separation(positions, graph, exponent),
            forces.alignment(velocities, graph),
        ]
        found[start : start + portion] = torch.cat(terms, dim=-1).numpy()
    return found.reshape(*states.shape[:-1], -1)


def accelerations(states: Array, fps: float) -> Array:
    """Return each step's change of velocity a second, ``(..., time - 1, individual, space)``.

    NaN unless the individual is known at both ends of the step.
    """
    velocity = states[..., states.shape[-1] // 2 :]
    change = (velocity[..., 1:, :, :] - velocity[..., :-1, :, :]) * fps
    both = known(states[..., 1:, :, :]) & known(states[..., :-1, :, :])
    return np.asarray(np.where(both[..., None], change, np.nan))


class AccelerationBaseline(Baseline):
    r"""A baseline that says how velocities change; positions follow from them.

    .. math:: v_i(t + 1) = v_i(t) + dt\, a_i(t) \qquad p_i(t + 1) = p_i(t) + dt\, v_i(t + 1)

    A subclass writes :meth:`acceleration`.
    """

    name: ClassVar[str]
    title: ClassVar[str]

    def acceleration(self, states: Array) -> Array:
        """Return accelerations ``(..., individual, space)`` of states in one frame each."""
        raise TypeError(f"{type(self).__name__} must define acceleration(states)")

    def velocity_after(self, velocity: Array, acceleration: Array, fps: float) -> Array:
        """Return the velocity one step on."""
        return velocity + acceleration / fps

    def step(self, window: Array, fps: float) -> Array:
        """Return the next state: first the velocity, and then the position by the new one."""
        states = window[..., -1, :, :]
        position, velocity = np.split(states, 2, axis=-1)
        velocity = self.velocity_after(velocity, self.acceleration(states), fps)
        moved = np.concatenate([position + velocity / fps, velocity], axis=-1)
        return np.asarray(np.where(known(states)[..., None], moved, np.nan))
