"""A model with its latent paths summed out, as a Pyro model of the global parameters alone."""

import contextlib
from collections.abc import Iterator, Mapping

import pyro
import torch

from swarmssm.inference.filtering.evidence import (
    Method,
    collapsed_evidence,
    linearization_points,
)
from swarmssm.inference.filtering.layouts import Layout, Points
from swarmssm.models import InferredEdges, StateSpaceModel, SwarmBatch
from swarmssm.models.edges import EdgeTypes

__all__ = ["Collapsed", "collapsed", "population_evidence", "windows_plate"]


def population_evidence(batch: SwarmBatch, evidence: torch.Tensor) -> torch.Tensor:
    """Return what the windows of a mini-batch say about the evidence of all.

    Parameters
    ----------
    batch
        A sample of its population.
    evidence
        ``(batch,)``.

    Returns
    -------
    A number whose mean over mini-batches is the weighted sum over the population.
    """
    return (batch.window_weight * evidence).sum() * (batch.population / len(batch))


@contextlib.contextmanager
def windows_plate(batch: SwarmBatch) -> Iterator[None]:
    """Let sites be those of windows, each counting as it does in the population."""
    rows = torch.arange(len(batch), device=batch.mask.device)
    with (
        pyro.plate("windows", batch.population, subsample=rows, dim=-1),
        pyro.poutine.scale(scale=batch.window_weight),
    ):
        yield


class Collapsed:
    """See :func:`collapsed`."""

    def __init__(
        self,
        model: StateSpaceModel,
        method: Method = "iterated",
        layout: Layout = "auto",
        points: Points | None = None,
        given: int = 0,
    ) -> None:
        self.model, self.method, self.layout, self.points = model, method, layout, points
        self.given = given

    def __call__(self, batch: SwarmBatch) -> None:
        """Sample the parameters and weigh them by the evidence of the windows.

        Edges that are inferred are drawn too: the evidence is that of windows with these edges.
        """
        values = self.model.sample_globals()
        edges = self.model.edges
        if isinstance(edges, InferredEdges):
            with windows_plate(batch):
                prior = edges.prior(batch)
                types = pyro.sample("edges", prior)
                batch = edges.with_edge_types(batch, types)
                term = self._edge_term(edges, batch, values, types, prior)
                if term is not None:
                    pyro.factor("edge_conditionals", term)
        pyro.factor("evidence", self.evidence(batch, values))

    def _edge_term(
        self,
        edges: InferredEdges,
        batch: SwarmBatch,
        values: Mapping[str, torch.Tensor],
        types: torch.Tensor,
        prior: EdgeTypes,
    ) -> torch.Tensor | None:
        """Return what teaches the edges, with the most probable path for the path."""
        if not types.requires_grad:
            return None
        points = self.points
        if points is None:
            points = linearization_points(self.model, batch, values, layout=self.layout)
        path = points.mean.to(batch.observations.dtype)
        chain = self.model.chain(batch, {name: value.detach() for name, value in values.items()})
        return edges.conditional_term(
            chain.transition, path, batch.present, chain.inputs, types, prior
        )

    def evidence(self, batch: SwarmBatch, values: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return what the windows say of the evidence of their population, at given values."""
        found = collapsed_evidence(
            self.model,
            batch,
            values,
            method=self.method,
            layout=self.layout,
            points=self.points,
            given=self.given,
        )
        return population_evidence(batch, found)


def collapsed(
    model: StateSpaceModel,
    *,
    method: Method = "iterated",
    layout: Layout = "auto",
    points: Points | None = None,
    given: int = 0,
) -> Collapsed:
    r"""Return :math:`p(\theta) \prod_w p(x^{(w)} \mid \theta)` as a Pyro model, paths summed out.

    A handful of global parameters is all that is left: ``SVI(collapsed(model), guide, ...)`` with
    an autoguide, ``NUTS(collapsed(model))``, or :func:`swarmssm.inference.laplace`.

    Parameters
    ----------
    model
        With an emission, and priors.
    method, layout, given
        As in :func:`swarmssm.inference.filtering.collapsed_evidence`.
    points
        Hold the points of linearisation: those of the batch that it will be called with. NUTS
        needs this or ``method="extended"``, or the gradient is not that of the density.
        :attr:`swarmssm.inference.Laplace.points` are good ones.

    Returns
    -------
    Called with a batch. In a mini-batch the evidence counts ``population / batch`` times, and the
    priors once.
    """
    return Collapsed(model, method, layout, points, given)
