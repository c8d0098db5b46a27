"""The thesis's encoder as a guide: each step from its own graph alone."""

from collections.abc import Sequence
from typing import Any

import pyro
import pyro.distributions as dist
import torch

from swarmssm.graphs import dense, normalized_adjacency
from swarmssm.inference.guides.base import OneStepGuide
from swarmssm.models.base import SwarmModel
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.layers import GatedGraphLayer, GraphConvolution

__all__ = ["GraphEncoderGuide"]

#: Keeps a posterior variance within e^-20 and e^10, where float32 can still tell it from nothing.
LOG_VARIANCE_RANGE = (-20.0, 10.0)
#: Where the log-variance starts. At 0, the prior's own, the decoder sees noise alone, learns to
#: ignore it, and the posterior never leaves the prior.
INITIAL_LOG_VARIANCE = -7.0


class GraphEncoderGuide(OneStepGuide):
    r"""Gated graph network and graph convolutions, eqs (3.50)-(3.56).

    .. math::

        h_1 &= \mathrm{GGNN}(x_t, A_t), \quad
        h_2 = \tanh \mathrm{GCN}_2(h_1, A_t), \quad
        h_3 = \tanh \mathrm{GCN}_3(h_2, A_t) \\
        \mu_t &= \mathrm{GCN}_\mu(h_3, A_t), \quad
        \log \sigma_t^2 = \mathrm{GCN}_\sigma(h_3, A_t), \quad
        q(z_t \mid x_t, A_t) = N(\mu_t, \sigma_t^2)

    sampled as :math:`\mu + \sigma \epsilon` (3.59). (3.1) leaves open which non-linearity is
    meant; tanh lets four features pass where ReLU loses those that are negative.

    Parameters
    ----------
    state_dim
        Features of a state, 4 in the plane.
    latent_dim
        Features of a latent state: those of the model.
    widths
        Widths after the gated layer, :math:`GCN_2` and :math:`GCN_3`; the thesis has 16, 16, 4.
    rounds
        Rounds of message passing in the gated layer.
    self_weight
        Whether the convolutions have the first term of (3.7), see
        :class:`swarmssm.models.layers.GraphConvolution`.

    Raises
    ------
    ValueError
        If a size is no positive whole number, there are not three widths, or the first of them is
        smaller than ``state_dim``.
    """

    def __init__(
        self,
        state_dim: int,
        latent_dim: int = 4,
        widths: Sequence[int] = (16, 16, 4),
        rounds: int = 1,
        self_weight: bool = True,
    ) -> None:
        super().__init__()
        if len(widths) != 3:
            raise ValueError(f"widths must be three numbers, and there are {len(widths)}")
        first, second, third = widths
        self.gated = GatedGraphLayer(state_dim, first, rounds)
        self.second = GraphConvolution(first, second, self_weight=self_weight)
        self.third = GraphConvolution(second, third, self_weight=self_weight)
        self.mean = GraphConvolution(third, latent_dim, self_weight=self_weight)
        self.log_variance = GraphConvolution(third, latent_dim, self_weight=self_weight)
        torch.nn.init.constant_(self.log_variance.bias, INITIAL_LOG_VARIANCE)

    @classmethod
    def for_model(cls, model: SwarmModel, **options: Any) -> "GraphEncoderGuide":
        """Return a guide that fits the model's latent states."""
        return cls(model.state_dim, latent_dim=model.latent_dim, **options)

    def encode(self, states: torch.Tensor, adjacency: torch.Tensor) -> dist.Normal:
        """Return q(z | x, A).

        Parameters
        ----------
        states
            Scaled, ``(..., individual, state)``.
        adjacency
            ``(..., individual, individual)``.

        Returns
        -------
        Normal of batch shape ``(..., individual, latent)``.
        """
        normalized = normalized_adjacency(adjacency)
        hidden = self.gated(states, adjacency)
        hidden = self.second(hidden, normalized).tanh()
        hidden = self.third(hidden, normalized).tanh()
        log_variance = self.log_variance(hidden, normalized).clamp(*LOG_VARIANCE_RANGE)
        return dist.Normal(self.mean(hidden, normalized), (0.5 * log_variance).exp())

    def forward(self, batch: SwarmBatch) -> None:
        """Sample the latent states of every frame but the last, as the model scores them."""
        both_ends = (batch.mask[:, :-1] & batch.mask[:, 1:]).unsqueeze(-1)
        posterior = self.encode(batch.observations[:, :-1], dense(batch.adjacency)[:, :-1])
        rows = torch.arange(len(batch), device=both_ends.device)
        with (
            pyro.plate("windows", batch.population, subsample=rows, dim=-1),
            pyro.poutine.scale(scale=batch.window_weight),
        ):
            pyro.sample("states", posterior.mask(both_ends).to_event(3))
