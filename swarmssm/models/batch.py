"""What a model and a guide are given: windows of a swarm as tensors."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, Graph
from swarmssm.models.markov import StepInputs

__all__ = ["SwarmBatch", "presence"]


@dataclass(frozen=True)
class SwarmBatch:
    """Windows of tracks, padded and masked.

    Attributes
    ----------
    observations
        ``(batch, time, individual, observation)``: states, scaled; or positions alone, if the
        model observes no more. 0 where not observed, never NaN.
    mask
        ``(batch, time, individual)`` of bool: all of this individual's features were observed.
    adjacency
        ``(batch, time, individual, individual)`` of 0.0 and 1.0: ``[..., i, j] = 1`` when i sees
        j. No edge to or from an individual that was not observed; diagonal 0. For large swarms a
        list of the same edges, with leading shape ``(batch, time)``.
    window_weight
        ``(batch,)``: how often a window counts in the ELBO; 1 for windows that cover the
        recording once.
    population
        Number of windows of which this batch is a sample. The ELBO of a batch is scaled by
        ``population / batch``, so that the mean over batches is the ELBO of all windows.
    present
        ``(batch, time, individual)`` of bool: who is there, seen or not: from the first frame of
        the window in which an individual was observed to the last one.
    controls
        ``(batch, time, control)`` of exogenous inputs, or ``None``.
    edge_types
        ``(batch, time, individual, individual, type)``: types of edges that were drawn or inferred,
        one-hot or probabilities, see :class:`swarmssm.models.edges.InferredEdges`; ``None`` where
        edges have none. The adjacency is then that of the types.
    """

    observations: torch.Tensor
    mask: torch.Tensor
    adjacency: Graph
    window_weight: torch.Tensor
    population: int
    present: torch.Tensor
    controls: torch.Tensor | None = None
    edge_types: torch.Tensor | None = None

    @classmethod
    def of(
        cls,
        observations: torch.Tensor,
        mask: torch.Tensor,
        adjacency: Graph,
        controls: torch.Tensor | None = None,
    ) -> "SwarmBatch":
        """Make a batch that is its own population, each window counting once.

        Parameters
        ----------
        observations, mask, adjacency, controls
            As in the class. What stands where the mask is false says nothing, NaN neither.

        Raises
        ------
        InputError
            If the shapes do not go together, or an observation that is to count is not finite.
        """
        _check_shapes(observations, mask, adjacency, controls)
        mask = mask.bool()
        finite = observations.isfinite().all(-1)
        if not bool((finite | ~mask).all()):
            place = tuple(torch.nonzero(mask & ~finite)[0].tolist())
            raise InputError(
                "observations: that of (batch, time, individual) = "
                f"{place} is not finite, and the mask says that it was seen."
            )
        if not bool(finite.all()):
            observations = observations.masked_fill(~finite.unsqueeze(-1), 0.0)
        batch = len(observations)
        weight = observations.new_ones(batch)
        return cls(observations, mask, adjacency, weight, batch, presence(mask), controls)

    def __len__(self) -> int:
        return len(self.observations)

    @property
    def num_times(self) -> int:
        """Number of frames of each window."""
        return self.observations.shape[1]

    @property
    def num_individuals(self) -> int:
        """Number of individuals, observed or not."""
        return self.observations.shape[2]

    def steps(self) -> StepInputs:
        """Return graph, controls and presence at the beginning of each of the ``T - 1`` steps."""
        return self._steps

    @cached_property
    def _steps(self) -> StepInputs:
        """The same, made once: model and guide both ask, and a list of edges is long."""
        last = self.num_times - 1
        # What is made once serves all, and whoever asks first may want no gradient.
        with torch.enable_grad():
            if isinstance(self.adjacency, EdgeList):
                adjacency: Graph = self.adjacency.select(1, 0, last)
            else:
                adjacency = self.adjacency[:, :-1]
            types = None if self.edge_types is None else self.edge_types[:, :-1]
        controls = None if self.controls is None else self.controls[:, :-1]
        return StepInputs(adjacency, controls, self.present[:, :-1], types)

    def select(self, index: torch.Tensor) -> "SwarmBatch":
        """Return the windows at ``index``, as a sample of the same population."""
        return replace(
            self,
            observations=self.observations[index],
            mask=self.mask[index],
            adjacency=self.adjacency[index],
            window_weight=self.window_weight[index],
            present=self.present[index],
            controls=None if self.controls is None else self.controls[index],
            edge_types=None if self.edge_types is None else self.edge_types[index],
        )

    def to(self, device: torch.device) -> "SwarmBatch":
        """Return the batch on another device."""
        return replace(
            self,
            observations=self.observations.to(device),
            mask=self.mask.to(device),
            adjacency=self.adjacency.to(device),
            window_weight=self.window_weight.to(device),
            present=self.present.to(device),
            controls=None if self.controls is None else self.controls.to(device),
            edge_types=None if self.edge_types is None else self.edge_types.to(device),
        )


def _check_shapes(
    observations: torch.Tensor,
    mask: torch.Tensor,
    adjacency: Graph,
    controls: torch.Tensor | None,
) -> None:
    """Refuse tensors of windows that do not go together."""
    kinds = {"observations": observations, "mask": mask, "adjacency": adjacency}
    for name, value in kinds.items():
        if not isinstance(value, torch.Tensor | EdgeList):
            raise InputError(f"{name}: it must be a tensor, not {type(value).__name__}.")
    if observations.dim() != 4 or not observations.is_floating_point():
        raise InputError(
            "observations: they must be (batch, time, individual, observation) of floats, and are "
            f"{tuple(observations.shape)} of {observations.dtype}."
        )
    frames = tuple(observations.shape[:-1])
    shapes = {"mask": (tuple(mask.shape), frames)}
    if isinstance(adjacency, EdgeList):
        shapes["adjacency"] = ((*adjacency.leading, adjacency.individuals), frames)
    else:
        shapes["adjacency"] = (tuple(adjacency.shape), (*frames, frames[-1]))
    if controls is not None:
        shapes["controls"] = (tuple(controls.shape), (*frames[:2], *controls.shape[2:3]))
        if controls.dim() != 3:
            shapes["controls"] = (tuple(controls.shape), (*frames[:2], 1))
    for name, (given, wanted) in shapes.items():
        if given != wanted:
            raise InputError(
                f"{name}: its shape must be {wanted} to go with observations of "
                f"{tuple(observations.shape)}, and it is {given}."
            )


def presence(mask: torch.Tensor) -> torch.Tensor:
    """Return who is there, from the first to the last frame in which each was observed.

    Parameters
    ----------
    mask
        ``(..., time, individual)`` of bool.
    """
    come = mask.long().cumsum(-2) > 0
    stays = mask.long().flip(-2).cumsum(-2).flip(-2) > 0
    return come & stays
