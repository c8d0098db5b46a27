"""What a model and a guide are given: windows of a swarm as tensors."""

from dataclasses import dataclass, replace

import torch

__all__ = ["SwarmBatch"]


@dataclass(frozen=True)
class SwarmBatch:
    """Windows of tracks, padded and masked.

    Attributes
    ----------
    observations
        ``(batch, time, individual, state)``, scaled; 0 where not observed, never NaN.
    mask
        ``(batch, time, individual)`` of bool: this individual's whole state was observed.
    adjacency
        ``(batch, time, individual, individual)`` of 0.0 and 1.0: ``[..., i, j] = 1`` when i sees
        j. No edge to or from an individual that was not observed; diagonal 0.
    controls
        ``(batch, time, control)`` of exogenous inputs, or ``None``.
    window_weight
        ``(batch,)``: how often a window counts in the ELBO; 1 for windows that cover the
        recording once.
    population
        Number of windows of which this batch is a sample. The ELBO of a batch is scaled by
        ``population / batch``, so that the mean over batches is the ELBO of all windows.
    """

    observations: torch.Tensor
    mask: torch.Tensor
    adjacency: torch.Tensor
    window_weight: torch.Tensor
    population: int
    controls: torch.Tensor | None = None

    @classmethod
    def of(
        cls,
        observations: torch.Tensor,
        mask: torch.Tensor,
        adjacency: torch.Tensor,
        controls: torch.Tensor | None = None,
    ) -> "SwarmBatch":
        """Make a batch that is its own population, each window counting once."""
        batch = len(observations)
        weight = observations.new_ones(batch)
        return cls(observations, mask, adjacency, weight, batch, controls)

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

    def select(self, index: torch.Tensor) -> "SwarmBatch":
        """Return the windows at ``index``, as a sample of the same population."""
        controls = None if self.controls is None else self.controls[index]
        return replace(
            self,
            observations=self.observations[index],
            mask=self.mask[index],
            adjacency=self.adjacency[index],
            window_weight=self.window_weight[index],
            controls=controls,
        )

    def to(self, device: torch.device) -> "SwarmBatch":
        """Return the batch on another device."""
        controls = None if self.controls is None else self.controls.to(device)
        return replace(
            self,
            observations=self.observations.to(device),
            mask=self.mask.to(device),
            adjacency=self.adjacency.to(device),
            window_weight=self.window_weight.to(device),
            controls=controls,
        )
