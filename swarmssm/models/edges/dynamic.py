"""A type for each pair in each frame: dynamic neural relational inference."""

from typing import Any

import torch
from torch import Tensor, nn

from swarmssm.errors import InputError
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.edges.encoders import Memory, StepEncoder
from swarmssm.models.edges.inferred import EdgeState, InferredEdges
from swarmssm.models.edges.types import EdgeTypes

__all__ = ["DynamicRelationalEdges"]


class DynamicRelationalEdges(InferredEdges):
    r"""Types that change from frame to frame, with a prior that is learned.

    .. math::
        p_\theta(e) = \prod_t \prod_{i \ne j} \mathrm{Cat}(e_{tij}; f_\theta(x_{1:t})_{ij}),
        \qquad q(e \mid x_{1:T}) = \prod_t \prod_{i \ne j} \mathrm{Cat}(e_{tij};
        g_\phi(x_{1:T})_{ij})

    with f a recurrence forwards in time and g one both ways
    (:class:`~swarmssm.models.edges.encoders.StepEncoder`). Both are told the states that were seen;
    where the swarm goes on freely, f is told the states it goes through. The types of the last
    frame of a window move nothing in it: their posterior is the prior.

    With a *sparsity* the prior is the geometric mean of the learned one and of the categorical one
    with this probability of no edge, not normalised, so that half of the divergence is from either,
    as where the original adds a fixed prior.

    Parameters
    ----------
    scales, num_types, **options
        See :class:`~swarmssm.models.edges.InferredEdges`.
    held
        Share of the fixed prior in the geometric mean; 0.5 with a sparsity, else 0.

    Raises
    ------
    InputError
        If an option is out of range.

    References
    ----------
    C. Graber and A. Schwing (2020), Dynamic neural relational inference, CVPR. There hidden is
    256, the recurrences 64 wide, temperature 0.5; prior and posterior share the embedding and the
    forward recurrence, which here are the prior's and the guide's own.
    """

    usual: Tensor

    def __init__(
        self, scales: Any, num_types: int = 2, *, held: float | None = None, **options: Any
    ) -> None:
        super().__init__(scales, num_types, **options)
        share = (0.0 if self.sparsity is None else 0.5) if held is None else held
        number = isinstance(share, int | float) and not isinstance(share, bool)
        if not (number and 0.0 <= share <= 1.0):
            raise InputError(f"held: it must be between 0 and 1, not {held!r}.")
        self.held = float(share)
        #: Network of the learned prior.
        self.ahead: StepEncoder = self._new(smoothing=False)

    def _new(self, *, smoothing: bool) -> StepEncoder:
        """Return a network that begins near the usual probabilities."""
        encoder = StepEncoder(
            self.scales, self.num_types, self.hidden, smoothing=smoothing, near=self.near
        )
        last = encoder.head[-1]
        assert isinstance(last, nn.Linear)
        with torch.no_grad():
            last.bias.copy_(self.usual)
        return encoder

    def _held(self, logits: Tensor) -> Tensor:
        """Return the scores of the geometric mean of the learned and the fixed prior."""
        learned = logits.log_softmax(-1)
        return (1.0 - self.held) * learned + self.held * self.usual.to(logits.dtype)

    def prior(self, batch: SwarmBatch) -> EdgeTypes:
        """Return the prior of each frame given the frames up to it."""
        seen = self.seen(batch)
        return self.distribution(self._held(self.ahead(seen)), seen.pairs, normalized=False)

    def encoder(self) -> nn.Module:
        """Return a new network for :meth:`posterior`."""
        return self._new(smoothing=True)

    def posterior(self, batch: SwarmBatch, encoder: nn.Module, prior: EdgeTypes) -> EdgeTypes:
        """Return the distribution of types given whole windows; the prior in the last frame."""
        last = prior.scores[:, -1:]
        if batch.num_times == 1:
            return self.distribution(last, prior.pairs)
        logits = torch.cat([encoder(self.seen(batch))[:, :-1], last], 1)
        return self.distribution(logits, prior.pairs)

    def memory(self, batch: SwarmBatch, types: Tensor) -> EdgeState:
        """Return what is known of edges at the end of windows with given types."""
        seen = self.seen(batch)
        _, told = self.ahead.scan(seen)
        space = self.scales.space
        return EdgeState(types[:, -1], Memory(told[:, -1], seen.states[:, -1, :, space:]))

    def following(
        self, states: Tensor, present: Tensor, known: EdgeState | None
    ) -> tuple[Tensor, Memory | None]:
        """Return the prior's logits of one more frame."""
        logits, memory = self.ahead.step(states, present, None if known is None else known.memory)
        return self._held(logits), memory
