"""A path of states as one random variable: drawn step by step, scored in one call."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from pyro.distributions import TorchDistribution
from torch.distributions import constraints

__all__ = ["MarkovChain", "StepInputs", "Transition"]


@dataclass(frozen=True)
class StepInputs:
    """What a transition knows besides the states, for every step ``t - 1 -> t``.

    Attributes
    ----------
    adjacency
        ``(..., step, individual, individual)``: the graph at the beginning of the step, where it
        is observed; ``None`` where it follows from the states.
    controls
        ``(..., step, control)``: exogenous inputs, or ``None``.
    present
        ``(..., step, individual)`` of bool: who is there at the beginning of the step; ``None`` if
        all are.
    """

    adjacency: torch.Tensor | None = None
    controls: torch.Tensor | None = None
    present: torch.Tensor | None = None

    def at(self, step: int) -> "StepInputs":
        """Return the inputs of one step, without the step dimension."""
        return StepInputs(
            None if self.adjacency is None else self.adjacency[..., step, :, :],
            None if self.controls is None else self.controls[..., step, :],
            None if self.present is None else self.present[..., step, :],
        )


#: From states ``(..., individual, state)`` and inputs to the distribution of the next states, of
#: batch shape ``(..., individual)`` and event shape ``(state,)``.
Transition = Callable[[torch.Tensor, StepInputs], TorchDistribution]


class MarkovChain(TorchDistribution):  # type: ignore[misc]
    r"""Path :math:`z_{1:T}` of all individuals.

    .. math:: p(z_{1:T}) = \prod_i p(z_{1,i}) \prod_{t=2}^T p(z_{t,i} \mid z_{t-1}, u_{t-1})

    ``event_shape = (time, individual, state)``. The individuals of one step are independent given
    the whole swarm at the step before. :meth:`rsample` goes step by step; :meth:`log_prob` asks the
    transition once, for all steps of all batches together.

    An individual that is absent at a frame (``mask``) has state 0 there and no term in the density.
    One that comes, or comes back, is drawn and scored by ``initial``.

    Parameters
    ----------
    initial
        Distribution of the first states: event shape ``(state,)``, batch shape broadcastable with
        ``batch_shape + (individual,)``.
    transition
        See :data:`Transition`. A :class:`torch.nn.Module` is as good as a function.
    num_steps
        T, the number of frames.
    num_individuals
        Number of individuals.
    inputs
        For the ``T - 1`` steps; see :class:`StepInputs`.
    mask
        ``batch_shape + (time, individual)`` of bool: who is there; ``None`` for all.
    batch_shape
        Of the path; absent, that of ``initial`` without its individuals, ``mask`` and ``inputs``.

    Raises
    ------
    ValueError
        If the shapes do not fit; the message has both.
    """

    has_rsample = True

    def __init__(
        self,
        initial: TorchDistribution,
        transition: Transition,
        num_steps: int,
        num_individuals: int,
        *,
        inputs: StepInputs | None = None,
        mask: torch.Tensor | None = None,
        batch_shape: torch.Size | None = None,
        validate_args: bool | None = None,
    ) -> None:
        if len(initial.event_shape) != 1:
            raise ValueError(
                f"initial must have event shape (state,), and it is {tuple(initial.event_shape)}"
            )
        if num_steps < 1:
            raise ValueError(f"num_steps must be at least 1, and it is {num_steps}")
        inputs = StepInputs() if inputs is None else inputs
        expected = (num_steps, num_individuals)
        if mask is not None and tuple(mask.shape[-2:]) != expected:
            raise ValueError(
                f"mask must end in (time, individual) = {expected}, and its shape is "
                f"{tuple(mask.shape)}"
            )
        for name, trailing in (("adjacency", 3), ("controls", 2), ("present", 2)):
            value = getattr(inputs, name)
            if value is not None and value.shape[-trailing] != num_steps - 1:
                raise ValueError(
                    f"{name} must have {num_steps - 1} steps, and its shape is {tuple(value.shape)}"
                )
        if batch_shape is None:
            shapes = [initial.batch_shape[:-1]]
            shapes += [] if mask is None else [mask.shape[:-2]]
            shapes += [] if inputs.adjacency is None else [inputs.adjacency.shape[:-3]]
            shapes += [] if inputs.controls is None else [inputs.controls.shape[:-2]]
            batch_shape = torch.broadcast_shapes(*shapes)  # type: ignore[no-untyped-call]
        self.initial = initial.expand((*batch_shape, num_individuals))
        self.transition = transition
        self.inputs = inputs
        self.mask_present = mask
        event_shape = torch.Size([num_steps, num_individuals, *initial.event_shape])
        super().__init__(torch.Size(batch_shape), event_shape, validate_args=validate_args)

    @property
    def arg_constraints(self) -> dict[str, Any]:
        """Return no constraints: the parts check their own parameters."""
        return {}

    @constraints.dependent_property(is_discrete=False, event_dim=3)
    def support(self) -> constraints.Constraint:
        """Return all real paths."""
        return constraints.independent(constraints.real, 3)  # type: ignore[no-untyped-call]

    def expand(self, batch_shape: Any, _instance: Any = None) -> "MarkovChain":
        """Return the distribution with another batch shape."""
        num_steps, num_individuals, _ = self.event_shape
        return MarkovChain(
            self.initial,
            self.transition,
            num_steps,
            num_individuals,
            inputs=self.inputs,
            mask=self.mask_present,
            batch_shape=torch.Size(batch_shape),
            validate_args=False,
        )

    def rsample(self, sample_shape: Any = torch.Size()) -> torch.Tensor:  # noqa: B008
        """Draw paths, step by step."""
        num_steps = self.event_shape[0]
        initial = self.initial.expand((*sample_shape, *self.initial.batch_shape))
        present = self.mask_present
        state = initial.rsample()
        if present is not None:
            state = state * present[..., 0, :, None]
        path = [state]
        for step in range(num_steps - 1):
            following = self.transition(state, self.inputs.at(step)).rsample()
            if present is not None:
                before, after = present[..., step, :, None], present[..., step + 1, :, None]
                following = torch.where(before, following, initial.rsample()) * after
            state = following.expand_as(state)
            path.append(state)
        return torch.stack(path, dim=-3)

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """Return the log-density of paths, all steps in one call of the transition.

        Parameters
        ----------
        value
            Shape ``(..., time, individual, state)``.
        """
        if self._validate_args:
            self._check_path(value)
        # Time in front is a sample dimension to the initial distribution, which scores all frames
        # at once: it needs the first one, and those in which somebody comes.
        frames = self.initial.log_prob(value.movedim(-3, 0)).movedim(0, -2)
        if value.shape[-3] == 1:
            steps = frames[..., :0, :]
        else:
            before, after = value[..., :-1, :, :], value[..., 1:, :, :]
            steps = self.transition(before, self.inputs).log_prob(after)
        if self.mask_present is None:
            total: torch.Tensor = frames[..., 0, :].sum(-1) + steps.sum((-1, -2))
            return total
        there = self.mask_present
        stays = there[..., 1:, :] & there[..., :-1, :]
        comes = there.clone()
        comes[..., 1:, :] &= ~there[..., :-1, :]
        # `where`, not a product: 0 times an infinite density would be NaN.
        steps = torch.where(stays, steps, 0.0).sum((-1, -2))
        total = torch.where(comes, frames, 0.0).sum((-1, -2)) + steps
        return total

    def _check_path(self, value: torch.Tensor) -> None:
        """Refuse a path of another shape, naming both."""
        if value.shape[-3:] != self.event_shape:
            raise ValueError(
                f"a path must end in (time, individual, state) = {tuple(self.event_shape)}, and "
                f"its shape is {tuple(value.shape)}"
            )
