"""A path of states as one random variable: drawn step by step, scored in one call."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from pyro.distributions import TorchDistribution
from torch.distributions import constraints

from swarmssm.graphs import EdgeList, Graph
from swarmssm.models.distributions.kinematic import Kinematic

__all__ = ["MarkovChain", "Step", "StepInputs"]


@dataclass(frozen=True)
class StepInputs:
    """What a transition knows besides the states, for every step ``t - 1 -> t``.

    Attributes
    ----------
    adjacency
        ``(..., step, individual, individual)``: the graph at the beginning of the step, or a list
        of its edges with leading shape ``(..., step)``; ``None`` where there is none.
    controls
        ``(..., step, control)``: exogenous inputs, or ``None``.
    present
        ``(..., step, individual)`` of bool: who is there at the beginning of the step; ``None`` if
        all are.
    edge_types
        ``(..., step, individual, individual, type)``: types of the edges, one-hot or
        probabilities; ``None`` where they have none.
    """

    adjacency: Graph | None = None
    controls: torch.Tensor | None = None
    present: torch.Tensor | None = None
    edge_types: torch.Tensor | None = None

    def at(self, step: int) -> "StepInputs":
        """Return the inputs of one step, without the step dimension."""
        if isinstance(self.adjacency, EdgeList):
            adjacency: Graph | None = self.adjacency.select(-1, step, step + 1).squeeze(-1)
        else:
            adjacency = None if self.adjacency is None else self.adjacency[..., step, :, :]
        return StepInputs(
            adjacency,
            None if self.controls is None else self.controls[..., step, :],
            None if self.present is None else self.present[..., step, :],
            None if self.edge_types is None else self.edge_types[..., step, :, :, :],
        )

    def dense(self) -> "StepInputs":
        """Return the same inputs with a matrix in place of a list of edges."""
        if isinstance(self.adjacency, EdgeList):
            return replace(self, adjacency=self.adjacency.to_dense(torch.get_default_dtype()))
        return self

    def tensors(self, frames: Any) -> list[torch.Tensor]:
        """Return what is there as tensors with one leading dimension, all frames in a row.

        Parameters
        ----------
        frames
            Shape of the frames, against which the inputs broadcast.
        """
        inner = {"adjacency": 2, "controls": 1, "present": 1, "edge_types": 3}
        found = []
        for name, dims in inner.items():
            value = getattr(self.dense(), name)
            if value is not None:
                shape = (*frames, *value.shape[value.dim() - dims :])
                found.append(value.expand(shape).reshape(-1, *shape[len(frames) :]))
        return found

    def rebuild(self, tensors: Sequence[torch.Tensor]) -> "StepInputs":
        """Return inputs with other tensors in the order of :meth:`tensors`."""
        rest = iter(tensors)
        names = ("adjacency", "controls", "present", "edge_types")
        return StepInputs(*(None if getattr(self, n) is None else next(rest) for n in names))


#: From states ``(..., individual, state)`` and inputs to the distribution of the next states, of
#: batch shape ``(..., individual)`` and event shape ``(state,)``.
Step = Callable[[torch.Tensor, StepInputs], TorchDistribution]


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
        See :data:`Step`. A :class:`torch.nn.Module` is as good as a function.
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
        transition: Step,
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
        _check_initial(initial, num_individuals)
        _check_inputs(inputs, num_steps - 1, num_individuals)
        if batch_shape is None:
            shapes = [initial.batch_shape[:-1]]
            shapes += [] if mask is None else [mask.shape[:-2]]
            if isinstance(inputs.adjacency, EdgeList):
                shapes += [torch.Size(inputs.adjacency.leading[:-1])]
            elif inputs.adjacency is not None:
                shapes += [inputs.adjacency.shape[:-3]]
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
            validate_args=self._validate_args,
        )

    def rsample(self, sample_shape: Any = torch.Size()) -> torch.Tensor:  # noqa: B008
        """Draw paths, step by step; differentiable as far as the draws of the parts are."""
        num_steps = self.event_shape[0]
        initial = self.initial.expand((*sample_shape, *self.initial.batch_shape))
        present = self.mask_present
        # Calling a distribution of Pyro's is `rsample` where it has that, and else `sample`.
        state = initial()
        if present is not None:
            state = state * present[..., 0, :, None]
        path = [state]
        for step in range(num_steps - 1):
            following = self._following(state, self.inputs.at(step))()
            if present is not None:
                before, after = present[..., step, :, None], present[..., step + 1, :, None]
                following = torch.where(before, following, initial()) * after
            state = following.expand_as(state)
            path.append(state)
        return torch.stack(path, dim=-3)

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """Return the log-density of paths, all steps in one call of the transition.

        Parameters
        ----------
        value
            Shape ``(..., time, individual, state)``.

        Raises
        ------
        ValueError
            If arguments are checked and the path has another shape, or positions that do not follow
            from its velocities under a transition in which they must.
        """
        if self._validate_args:
            self._check_path(value)
        there = self.mask_present
        # Time in front is a sample dimension to the initial distribution, which scores all frames
        # at once: it needs the first one, and those in which somebody comes.
        if there is None:
            frames = self.initial.log_prob(value[..., 0, :, :]).unsqueeze(-2)
        else:
            frames = self.initial.log_prob(value.movedim(-3, 0)).movedim(0, -2)
        if value.shape[-3] == 1:
            steps = frames[..., :0, :]
        else:
            before, after = value[..., :-1, :, :], value[..., 1:, :, :]
            following = self._following(before, self.inputs)
            steps = following.log_prob(after)
            if self._validate_args:
                self._check_surface(following, after)
        if there is None:
            total: torch.Tensor = frames[..., 0, :].sum(-1) + steps.sum((-1, -2))
            return total
        comes = there.clone()
        comes[..., 1:, :] &= ~there[..., :-1, :]
        # `where`, not a product: 0 times an infinite density would be NaN.
        steps = torch.where(self._stays(there), steps, 0.0).sum((-1, -2))
        total = torch.where(comes, frames, 0.0).sum((-1, -2)) + steps
        return total

    def _following(self, states: torch.Tensor, inputs: StepInputs) -> TorchDistribution:
        """Return what the transition says of the next states, if it has their shape."""
        following = self.transition(states, inputs)
        own, wanted = following.batch_shape, states.shape[:-1]
        fits = all(a in (1, b) for a, b in zip(own[::-1], wanted[::-1], strict=False))
        if following.event_shape != states.shape[-1:] or not fits:
            raise ValueError(
                "a transition must return a distribution of batch shape (..., individual) = "
                f"{tuple(wanted)} and event shape (state,) = {tuple(states.shape[-1:])}, and this "
                f"one has {tuple(own)} and {tuple(following.event_shape)}; .to_event(1) is missing "
                "where the features of a state are not its event"
            )
        return following

    @staticmethod
    def _stays(there: torch.Tensor) -> torch.Tensor:
        """Return who is there at both ends of each step."""
        return there[..., 1:, :] & there[..., :-1, :]

    def _check_surface(self, following: TorchDistribution, after: torch.Tensor) -> None:
        """Refuse positions that cannot have come about."""
        if not isinstance(following, Kinematic):
            return
        # The longest way from the origin: a path that is summed up has rounding errors of its size.
        size = following.position.abs().amax((-3, -1), keepdim=True).squeeze(-1)
        off = following.is_off_surface(after, size)
        if self.mask_present is not None:
            off = off & self._stays(self.mask_present)
        if bool(off.any()):
            raise ValueError(
                "positions of a path must follow from its velocities, p' = p + dt v', and some do "
                "not; a guide draws such paths with transition.path(first, free), and data need "
                "velocities by backward differences"
            )

    def _check_path(self, value: torch.Tensor) -> None:
        """Refuse a path of another shape, naming both."""
        if value.shape[-3:] != self.event_shape:
            raise ValueError(
                f"a path must end in (time, individual, state) = {tuple(self.event_shape)}, and "
                f"its shape is {tuple(value.shape)}"
            )


def _check_initial(initial: TorchDistribution, num_individuals: int) -> None:
    """Refuse first states of another number of individuals."""
    if initial.batch_shape and initial.batch_shape[-1] not in (1, num_individuals):
        raise ValueError(
            f"initial must have batch shape (..., individual) with {num_individuals} individuals "
            f"or 1, and it is {tuple(initial.batch_shape)}"
        )


def _check_inputs(inputs: StepInputs, steps: int, num_individuals: int) -> None:
    """Refuse inputs of another number of steps or individuals."""
    expected: dict[str, tuple[int, ...]] = {
        "adjacency": (steps, num_individuals, num_individuals),
        "present": (steps, num_individuals),
    }
    for name in ("adjacency", "controls", "present", "edge_types"):
        value = getattr(inputs, name)
        if value is None:
            continue
        if name == "edge_types":
            expected[name] = (steps, num_individuals, num_individuals, value.shape[-1])
        if isinstance(value, EdgeList):
            shape: tuple[int, ...] = (*value.leading, value.individuals, value.individuals)
        else:
            shape = tuple(value.shape)
        wanted = expected.get(name, (steps, *shape[-1:]))
        if shape[-len(wanted) :] != wanted:
            words = "(step, control)" if name == "controls" else "(step, individual)"
            words = "(step, individual, individual)" if name == "adjacency" else words
            words = "(step, individual, individual, type)" if name == "edge_types" else words
            raise ValueError(f"{name} must end in {words} = {wanted}, and its shape is {shape}")
