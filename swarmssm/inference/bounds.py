"""What training maximises: the ELBO, an importance weighted bound, and either one annealed."""

import contextlib
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import torch
from pyro.infer import Trace_ELBO
from pyro.infer.enum import get_importance_trace
from pyro.poutine import Trace
from pyro.poutine.messenger import Messenger
from torch import nn

from swarmssm.errors import InputError
from swarmssm.inference.guides import SwarmGuide
from swarmssm.inference.guides.edges import EdgeGuide
from swarmssm.models import SwarmBatch, SwarmModel

__all__ = ["Bound", "annealing"]


def annealing(step: int, steps: int) -> float:
    r"""Return :math:`\beta`, the weight of the divergence from the prior, at a step of training.

    It rises from ``1 / (steps + 1)`` at step 0 along a line to 1 at step ``steps``, and stays there
    (Bowman et al. 2016, CoNLL 20:10). It is never 0, so that the guide keeps some width.

    Parameters
    ----------
    step
        Counted from 0.
    steps
        How long the annealing takes; 0, there is none.
    """
    return min(1.0, (step + 1) / (steps + 1))


class Bound(nn.Module):
    r"""Negative lower bound of the evidence, of a batch scaled to its whole population.

    With one draw it is the negative ELBO of :class:`pyro.infer.Trace_ELBO`. With K, each window has
    the importance weighted bound of Burda et al. 2016 (ICLR) for itself,

    .. math::
        E_{q(\theta)}\Bigl[\log \frac{p(\theta)}{q(\theta)} + \frac{W}{B} \sum_b n_b\,
        E \log \frac1K \sum_{k=1}^K \frac{p(x_b, z_b^k \mid \theta)}{q(z_b^k \mid \theta)}\Bigr]

    for a batch of B windows out of W, each counting :math:`n_b` times. The parameters are drawn
    once. It is no smaller than the ELBO, and rises with K to the evidence given
    :math:`q(\theta)`. One common weight for a whole batch would be of no use: with so many
    frames, a single draw would carry it all.

    A model and a guide mark their windows by a plate ``"windows"`` at dimension -1.

    Parameters
    ----------
    model, guide
        Of the same latent sites.
    draws
        K.

    Raises
    ------
    InputError
        If there is not at least one draw.
    """

    def __init__(self, model: SwarmModel, guide: SwarmGuide, draws: int = 1) -> None:
        super().__init__()
        if draws < 1:
            raise InputError(f"draws: there must be at least one, not {draws}.")
        self.model, self.guide, self.draws = model, guide, draws
        self.elbo = Trace_ELBO()
        edges = getattr(guide, "edges_guide", None)
        if isinstance(edges, EdgeGuide):
            edges.integrates = draws == 1

    def forward(self, batch: SwarmBatch, weight: float = 1.0) -> torch.Tensor:
        r"""Return the loss, which can be differentiated.

        Parameters
        ----------
        batch
            Windows.
        weight
            :math:`\beta`, with which :math:`\log p` and :math:`\log q` of all latent sites, paths
            and parameters, are multiplied; see :func:`annealing`.

        Raises
        ------
        InputError
            If there are several draws, and the guide has a site whose draws cannot be
            differentiated; the sentence has its name.
        """
        with LatentWeight(weight) if weight != 1.0 else contextlib.nullcontext():
            if self.draws == 1:
                loss: torch.Tensor = self.elbo.differentiable_loss(self.model, self.guide, batch)
                return loss
            return self._importance_weighted(batch)

    def _importance_weighted(self, batch: SwarmBatch) -> torch.Tensor:
        """Return the negative importance weighted bound."""
        windows = len(batch)
        copies = torch.arange(windows, device=batch.mask.device).repeat(self.draws)
        many = replace(batch.select(copies), population=batch.population * self.draws)
        model_trace, guide_trace = get_importance_trace(
            "flat", math.inf, self.model, self.guide, (many,), {}
        )
        _check_differentiable(guide_trace)
        common = batch.observations.new_zeros(())
        each = batch.observations.new_zeros(len(many))
        for sign, trace in ((1.0, model_trace), (-1.0, guide_trace)):
            for site, density in _densities(trace):
                if any(frame.name == "windows" for frame in site["cond_indep_stack"]):
                    each = each + sign * density
                else:
                    common = common + sign * density.sum()
        mean = torch.logsumexp(each.reshape(self.draws, windows), 0) - math.log(self.draws)
        scale = batch.population / windows
        total: torch.Tensor = -common - scale * (batch.window_weight * mean).sum()
        return total


def _densities(trace: Trace) -> Iterator[tuple[dict[str, Any], torch.Tensor]]:
    """Yield the sample sites with their log-density, annealed but not scaled to the population."""
    for site in trace.nodes.values():
        if site["type"] == "sample":
            density = site["unscaled_log_prob"]
            if site["mask"] is not None:
                density = torch.where(torch.as_tensor(site["mask"]), density, 0.0)
            yield site, site["infer"].get("weight", 1.0) * density


def _check_differentiable(trace: Trace) -> None:
    """Refuse draws through which no gradient flows."""
    for name, site in trace.nodes.items():
        if site["type"] == "sample" and not (site["is_observed"] or site["fn"].has_rsample):
            raise InputError(
                "draws: with more than one, each draw of the guide must be differentiable, and "
                f"those of {name!r} ({type(site['fn']).__name__}) are not; take draws=1."
            )


class LatentWeight(Messenger):  # type: ignore[misc]
    """Multiplies the log-densities of all latent sites, in model and guide alike.

    Parameters
    ----------
    weight
        The factor.
    """

    def __init__(self, weight: float) -> None:
        super().__init__()
        self.weight = weight

    def _pyro_sample(self, message: Any) -> None:
        """Weigh a site, unless it is observed."""
        if not message["is_observed"]:
            message["scale"] = message["scale"] * self.weight
            message["infer"] = {**message["infer"], "weight": self.weight}
