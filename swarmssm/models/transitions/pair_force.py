"""Forces of neighbours that are any functions of their distance."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import torch
from pyro.distributions import constraints
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.graphs import Graph, degree, pair_sum
from swarmssm.models.transitions.force import ForceTransition, Noise
from swarmssm.models.transitions.protocols import Form, PairKernel

__all__ = ["PairForceTransition"]

#: What a user's own function may be: the strength by distance and parameters.
Strength = Callable[..., Tensor]


class PairForceTransition(ForceTransition):
    r"""Velocities changed by pair forces that are functions of the distance.

    Each neighbour j of i, at the distance r and in the direction :math:`\hat u`, adds
    :math:`f(r; \theta)\, \hat u`, or :math:`f(r; \theta)\, (v_j - v_i)`, and the force is the mean
    or the sum over the neighbours (:class:`~swarmssm.models.transitions.PairKernel`). Derivatives
    are automatic. Walls, speed regulation, limits of speed and noise are those of
    :class:`~swarmssm.models.transitions.ForceTransition`.

    Parameters
    ----------
    space
        Number of spatial dimensions, 2 or 3.
    dt
        Seconds from one frame to the next.
    strengths
        Name of a force -> function of the distance ``(...)`` and of named parameters that returns
        its strength ``(...)``, positive for towards the neighbour.
    parameters
        Name of a parameter of these functions -> its value: a number, a prior, or a parameter to be
        learned (:func:`swarmssm.models.parameters.assign`), one for all or ``(individual,)``.
        Functions that name the same parameter share it.
    kinds
        How a function becomes a force, by the name of the force; absent, the mean over the
        neighbours, along the direction to each.
    form, noise
        See :class:`~swarmssm.models.transitions.ForceTransition`.
    **self_terms
        For :meth:`ForceTransition.assign_self_terms`: process noise, walls and so on.

    Raises
    ------
    InputError
        If there is no function, or a parameter is missing, is no argument of any function, or has
        the name of something else in a transition.
    """

    def __init__(
        self,
        space: int,
        dt: float,
        strengths: Mapping[str, Strength],
        parameters: Mapping[str, Any],
        *,
        kinds: Mapping[str, PairKernel] | None = None,
        form: Form = "acceleration",
        noise: Noise = "additive",
        **self_terms: Any,
    ) -> None:
        super().__init__(space, dt, form=form, noise=noise)
        if not strengths:
            raise InputError("strengths: there must be at least one function of the distance.")
        self._strengths = dict(strengths)
        self._arguments = {
            name: tuple(inspect.signature(function).parameters)[1:]
            for name, function in strengths.items()
        }
        given = dict(kinds or {})
        self._kinds = {name: given.pop(name, PairKernel()) for name in strengths}
        needed = list(dict.fromkeys(name for names in self._arguments.values() for name in names))
        for what, names in (
            ("parameters: there is no value for", [n for n in needed if n not in parameters]),
            ("parameters: no function takes", [n for n in parameters if n not in needed]),
            ("kinds: there is no force", list(given)),
        ):
            if names:
                raise InputError(f"{what} {', '.join(names)}.")
        for name in needed:
            if name in dir(self) or name in self.self_parameter_names:
                raise InputError(
                    f"parameters: {name} is taken; give the argument of the function another name."
                )
        for name in needed:
            self.assign_parameter(name, parameters[name], constraints.real)
        self.assign_self_terms(**self_terms)

    @property
    def pair_terms(self) -> tuple[str, ...]:
        """Names of the functions."""
        return tuple(self._strengths)

    @property
    def kernel_kinds(self) -> Mapping[str, PairKernel]:
        """How each function becomes a force."""
        return self._kinds

    def kernels(self, distance: Tensor) -> dict[str, Tensor]:
        """Return each function at distances ``(distance,)``.

        ``(distance,)``, or ``(individual, distance)`` where individuals have values of their own.
        """
        return {
            name: self._strength(name, distance, {n: _column(getattr(self, n)) for n in names})
            for name, names in self._arguments.items()
        }

    def pair_forces(self, states: Tensor, graph: Graph) -> Tensor:
        """Return the force of each function; see :meth:`ForceTransition.pair_forces`."""
        space = self.space
        values = {n: getattr(self, n) for names in self._arguments.values() for n in names}
        own = [name for name, value in values.items() if value.dim()]
        # Values of individuals go to their edges as features.
        columns = torch.cat(
            [states, *(values[n].expand(states.shape[:-1]).unsqueeze(-1) for n in own)], -1
        )

        def message(mine: Tensor, theirs: Tensor) -> Tensor:
            away = theirs[..., : 2 * space] - mine[..., : 2 * space]
            squared = away[..., :space].square().sum(-1)
            apart = squared > 0
            distance = torch.where(apart, squared, 1.0).sqrt()
            toward = away[..., :space] / distance.unsqueeze(-1)
            at = values | {name: mine[..., 2 * space + k] for k, name in enumerate(own)}
            parts = []
            for name, names in self._arguments.items():
                strength = self._strength(name, distance, {n: at[n] for n in names})
                along = toward if self._kinds[name].along == "offset" else away[..., space:]
                parts.append(torch.where(apart, strength, 0.0).unsqueeze(-1) * along)
            return torch.cat(parts, -1)

        summed = torch.split(pair_sum(columns, graph, message), space, -1)
        total = degree(columns, graph)
        share = torch.where(total > 0, 1.0 / torch.where(total > 0, total, 1.0), 0.0)
        found = [
            force * share if self._kinds[name].over == "mean" else force
            for name, force in zip(self._strengths, summed, strict=True)
        ]
        return torch.stack(found, -3)

    def _strength(self, name: str, distance: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return what a function says, which must be a number for each distance."""
        found = torch.as_tensor(self._strengths[name](distance, **values))
        try:
            shape = torch.broadcast_shapes(found.shape, distance.shape)  # type: ignore[no-untyped-call]
            fits = shape == found.shape or not found.dim()
        except RuntimeError:
            fits = False
        if not fits:
            raise InputError(
                f"{name}: the function must return one number for each distance, in the shape "
                f"{tuple(distance.shape)}, and it returns {tuple(found.shape)}."
            )
        return found.expand(distance.shape) if not found.dim() else found


def _column(value: Tensor) -> Tensor:
    """Return values of individuals so that they broadcast against distances."""
    return value.unsqueeze(-1) if value.dim() else value
