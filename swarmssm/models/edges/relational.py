"""One type for each pair, fixed over a window: neural relational inference."""

from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from swarmssm.models.batch import SwarmBatch
from swarmssm.models.edges.encoders import Memory, WindowEncoder
from swarmssm.models.edges.inferred import EdgeState, InferredEdges
from swarmssm.models.edges.types import EdgeTypes

__all__ = ["RelationalEdges"]


class RelationalEdges(InferredEdges):
    r"""Types that stay as they are throughout a window.

    .. math:: p(e) = \prod_{i \ne j} \mathrm{Cat}(e_{ij}; \pi), \qquad
        q(e \mid x_{1:T}) = \prod_{i \ne j} \mathrm{Cat}(e_{ij}; f_\phi(x_{1:T})_{ij})

    with f a :class:`~swarmssm.models.edges.encoders.WindowEncoder`. The decoder of the original,
    a graph network for each type, is here the model's own transition, whatever it is. A forecast
    goes on with types inferred from its history.

    Parameters
    ----------
    scales, num_types, **options
        See :class:`~swarmssm.models.edges.InferredEdges`.

    References
    ----------
    T. Kipf, E. Fetaya, K.-C. Wang, M. Welling and R. Zemel (2018), Neural relational inference for
    interacting systems, ICML, arXiv:1802.04687. There hidden is 256, temperature 0.5, and draws
    are relaxed in training.
    """

    is_static: ClassVar[bool] = True
    usual: Tensor

    def __init__(self, scales: Any, num_types: int = 2, **options: Any) -> None:
        super().__init__(scales, num_types, **options)

    def prior(self, batch: SwarmBatch) -> EdgeTypes:
        """Return the categorical prior of each pair that meets in a window."""
        pairs = self.seen(batch).pairs.any(1, keepdim=True)
        logits = self.usual.to(batch.observations.dtype)
        return self.distribution(logits.expand(*pairs.shape, self.num_types), pairs)

    def encoder(self) -> nn.Module:
        """Return a new network for :meth:`posterior`, which begins near the prior."""
        encoder = WindowEncoder(self.scales, self.num_types, self.hidden, self.near)
        with torch.no_grad():
            encoder.head.bias.copy_(self.usual)
        return encoder

    def posterior(self, batch: SwarmBatch, encoder: nn.Module, prior: EdgeTypes) -> EdgeTypes:
        """Return the distribution of types given whole windows."""
        return self.distribution(encoder(self.seen(batch)), prior.pairs)

    def following(
        self, states: Tensor, present: Tensor, known: EdgeState | None
    ) -> tuple[Tensor, Memory | None]:
        """Return logits by which types stay as they are, or the prior's at the first frame."""
        if known is None:
            shape = (*states.shape[:-1], states.shape[-2], self.num_types)
            return self.usual.to(states.dtype).expand(shape), None
        stays = known.types.clamp(min=torch.finfo(states.dtype).tiny).log()
        met = known.types.sum(-1, keepdim=True) > 0
        return torch.where(met, stays, self.usual.to(states.dtype)), None

    def drawn_pairs(self, present: Tensor) -> Tensor:
        """Return all pairs: who goes and comes back has the types that it had."""
        return super().drawn_pairs(torch.ones_like(present))
