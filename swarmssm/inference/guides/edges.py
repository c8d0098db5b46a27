"""The posterior of types of edges: an encoder of what was seen, beside the guide of the paths."""

import pyro
import torch

from swarmssm.models import InferredEdges, SwarmBatch
from swarmssm.models.edges import EdgeState, EdgeTypes
from swarmssm.models.edges.types import PosteriorEdgeTypes
from swarmssm.models.pyro_modules import LocalPyroModule

__all__ = ["EdgeGuide"]


class EdgeGuide(LocalPyroModule):
    r"""Draws the site ``"edges"`` of a model: :math:`q(e \mid x_{1:T})`.

    The paths are then drawn given these edges: :math:`q(\theta)\, q(e \mid x)\,
    q(z \mid e, x, \theta)`.

    Parameters
    ----------
    edges
        The model's.

    Attributes
    ----------
    integrates
        Whether the divergence from the prior stands in the ELBO as it is, and not as that of a
        draw; it must not with importance weights.
    """

    def __init__(self, edges: InferredEdges) -> None:
        super().__init__()
        # In a list, or the model's would be a part of the guide and saved and trained twice.
        self._edges = [edges]
        self.encoder = edges.encoder()
        self.integrates = True

    @property
    def edges(self) -> InferredEdges:
        """The model's edges."""
        return self._edges[0]

    def posterior(self, batch: SwarmBatch) -> EdgeTypes:
        """Return the distribution of types in windows, batch shape ``(batch,)``."""
        return self.edges.posterior(batch, self.encoder, self.edges.prior(batch))

    def forward(self, batch: SwarmBatch) -> SwarmBatch:
        """Sample the types; return the windows with these edges."""
        prior = self.edges.prior(batch)
        law = self.edges.posterior(batch, self.encoder, prior)
        site = PosteriorEdgeTypes(law, prior, integrated=self.integrates)
        return self.edges.with_edge_types(batch, pyro.sample("edges", site))

    def draw(self, batch: SwarmBatch, *, sample: bool = True) -> SwarmBatch:
        """Return windows with edges that were drawn, or with the probabilities of their types."""
        with torch.no_grad():
            law = self.posterior(batch)
            return self.edges.with_edge_types(batch, law.sample() if sample else law.mean)

    def draws(self, batch: SwarmBatch, draws: int) -> tuple[SwarmBatch, EdgeState]:
        """Draw edges of the same windows several times; the windows are encoded once.

        Parameters
        ----------
        batch
            Windows.
        draws
            How many of each; 0, the probabilities of the types.

        Returns
        -------
        ``draws`` times the windows, all of one draw after the other; and what is known of edges at
        their end, with leading dimensions ``(draw, batch)``, or ``(batch,)``.
        """
        with torch.no_grad():
            law = self.posterior(batch)
            types = law.sample((draws,)) if draws else law.mean
            last = self.edges.memory(batch, law.mean).memory
            if draws:
                batch = batch.select(torch.arange(len(batch)).repeat(draws))
                if last is not None:
                    # What recurrences remember is told by what was seen, not by the draws.
                    last = type(last)(*(part.expand(draws, *part.shape) for part in last))
            known = EdgeState(types[..., -1, :, :, :], last)
            return self.edges.with_edge_types(batch, types.flatten(0, 1) if draws else types), known
