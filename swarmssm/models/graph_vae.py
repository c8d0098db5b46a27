"""The thesis's own model: a graph variational autoencoder of one step (section 3.7)."""

import math
from collections.abc import Sequence
from typing import Any

import pyro
import pyro.distributions as dist
import torch
from torch import nn

from swarmssm.graphs import dense
from swarmssm.models.base import NextStep, OneStepModel
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.layers import check_sizes, multilayer_perceptron
from swarmssm.models.scales import Scales

__all__ = ["GraphVAE"]

#: Where a learned s starts, in scaled units: below the steps that are to be told apart. Started at
#: the spread of the data, s explains them all and the latent states stay empty.
INITIAL_SCALE = 0.007


class GraphVAE(OneStepModel):
    r"""Each individual's latent state says its next state; each pair's says their next edge.

    .. math::

        z_{t,i} &\sim N(0, I) \\
        x_{t+1,i} \mid z_{t,i} &\sim N(f(z_{t,i}), \mathrm{diag}(s^2)) \\
        A_{t+1,ij} \mid z_t &\sim \mathrm{Bernoulli}(\sigma(z_{t,i} \cdot z_{t,j}))
            \qquad (3.57), \; i \ne j

    with :math:`f` fully connected. Its guide is
    :class:`swarmssm.inference.guides.GraphEncoderGuide`, :math:`q(z_t \mid x_t, A_t)`. Nothing
    links :math:`z_t` to :math:`z_{t+1}`, so all steps of all windows are scored in one call.

    The prior of :math:`z_t` does not know of :math:`x_t`: the evidence is that of next states as
    such, not of next states after these. To it a sharp latent state costs as much as it gains, so
    that a learned :math:`s` drifts upwards until the decoder serves the edges alone. A fixed one,
    which makes the likelihood a squared error of given weight, as in the thesis, keeps the states.

    A latent state is scored where its individual was observed at both ends of the step, an edge
    where both of its individuals were.

    Parameters
    ----------
    state_dim
        Features of a state, 4 in the plane.
    latent_dim
        Features of a latent state.
    decoder_widths
        Widths of the hidden layers of :math:`f`.
    scale
        :math:`s` of every feature, in scaled units; ``None``: learned, one for each feature.

    Raises
    ------
    ValueError
        If a size or a width is no positive whole number, or ``scale`` is not positive.

    References
    ----------
    T. N. Kipf and M. Welling (2016), Variational graph auto-encoders, arXiv:1611.07308.
    """

    def __init__(
        self,
        state_dim: int,
        latent_dim: int = 4,
        decoder_widths: Sequence[int] = (32, 32),
        scale: float | None = 0.005,
    ) -> None:
        widths = list(decoder_widths)
        check_sizes(state_dim=state_dim, latent_dim=latent_dim)
        if scale is not None and not 0 < scale < math.inf:
            raise ValueError(f"scale must be a positive number or None, and it is {scale}")
        super().__init__(state_dim)
        self.latent_dim = latent_dim
        self.decoder = multilayer_perceptron([latent_dim, *widths, state_dim])
        log_scale = torch.full((state_dim,), math.log(scale or INITIAL_SCALE))
        if scale is None:
            self.log_scale = nn.Parameter(log_scale)
        else:
            self.register_buffer("log_scale", log_scale)

    @classmethod
    def for_scales(cls, scales: Scales, **options: Any) -> "GraphVAE":
        """Return a model of tracks of these scales."""
        return cls(scales.state_dim, **options)

    def decode(self, latent: torch.Tensor) -> NextStep:
        """Return the next states and the log-odds of the next edges, (3.57)."""
        states = dist.Normal(self.decoder(latent), self.log_scale.exp())
        return NextStep(states, latent @ latent.transpose(-1, -2))

    def forward(self, batch: SwarmBatch) -> None:
        """Score windows: each frame but the last has a latent state, each but the first is data."""
        windows, times = len(batch), batch.num_times - 1
        both_ends = batch.mask[:, :-1] & batch.mask[:, 1:]
        shape = (windows, times, batch.num_individuals, self.latent_dim)
        zeros = batch.observations.new_zeros(shape)
        pairs = both_ends.unsqueeze(-1) & both_ends.unsqueeze(-2)
        pairs = pairs & ~torch.eye(batch.num_individuals, dtype=torch.bool, device=pairs.device)
        rows = torch.arange(windows, device=zeros.device)
        with (
            pyro.plate("windows", batch.population, subsample=rows, dim=-1),
            pyro.poutine.scale(scale=batch.window_weight),
        ):
            prior = dist.Normal(zeros, torch.ones_like(zeros))
            latent = pyro.sample("states", prior.mask(both_ends.unsqueeze(-1)).to_event(3))
            following = self.decode(latent)
            pyro.sample(
                "next_states",
                following.states.mask(both_ends.unsqueeze(-1)).to_event(3),
                obs=batch.observations[:, 1:],
            )
            edges = dist.Bernoulli(logits=following.edge_logits, validate_args=False)
            pyro.sample(
                "next_adjacency", edges.mask(pairs).to_event(3), obs=dense(batch.adjacency)[:, 1:]
            )
