"""What the surroundings of an individual say: a graph encoder, a recurrence both ways in time."""

import torch
from torch import Tensor, nn

from swarmssm.graphs import Graph, neighbor_mean
from swarmssm.models.layers import check_sizes, fan_in_uniform_
from swarmssm.models.scans import gated_scan

__all__ = ["SwarmContext"]

#: Range over which the gates of the recurrence start: some remember one frame, others fifty.
GATE_BIAS = (-4.0, 0.0)


class SwarmContext(nn.Module):
    r"""Features of each individual in each frame, told by itself and its neighbours at all times.

    The recurrence is gated by what is told alone, :math:`h_t = (1 - z_t) h_{t-1} + z_t c_t` with
    :math:`z_t = \sigma(W_z u_t + b_z)` and :math:`c_t = \tanh(W_c u_t + b_c)`, both ways in time:
    linear in what it remembers, it is one operation a frame where a GRU is a dozen. (Feng et al.
    2024, arXiv:2410.01201.)

    Frames in which an individual is absent are passed over: padding changes nothing.

    Parameters
    ----------
    features
        Features of a node.
    hidden
        Width of the encoder, and of the recurrence each way.

    Raises
    ------
    ValueError
        If a size is no positive whole number.
    """

    def __init__(self, features: int, hidden: int = 32) -> None:
        super().__init__()
        check_sizes(features=features, hidden=hidden)
        self.hidden = hidden
        self.own = nn.Linear(features, hidden)
        self.message = nn.Linear(hidden, hidden, bias=False)
        self.mixed = nn.Linear(2 * hidden + features + 1, hidden)
        for layer in (self.own, self.message, self.mixed):
            fan_in_uniform_(layer)
        # Gates and candidates, forwards and backwards.
        self.recurrence = nn.Linear(hidden, 4 * hidden)
        fan_in_uniform_(self.recurrence)
        with torch.no_grad():
            self.recurrence.bias[: 2 * hidden] = torch.linspace(*GATE_BIAS, hidden).repeat(2)

    @property
    def out_features(self) -> int:
        """Number of features of the result."""
        return 2 * self.hidden

    def forward(self, nodes: Tensor, graph: Graph | None, present: Tensor) -> Tensor:
        """Encode.

        Parameters
        ----------
        nodes
            ``(batch, time, individual, feature)``.
        graph
            Of each frame.
        present
            ``(batch, time, individual)`` of bool.

        Returns
        -------
        ``(batch, time, individual, out_features)``, 0 where absent.
        """
        there = None if bool(present.all()) else present.unsqueeze(-1).to(nodes.dtype)
        nodes = _where(there, nodes)
        own = _where(there, self.own(nodes).tanh())
        if graph is None:
            heard, around = torch.zeros_like(own), torch.zeros_like(nodes)
            sees = torch.zeros_like(nodes[..., :1])
        else:
            both, has_neighbor = neighbor_mean(torch.cat([self.message(own), nodes], -1), graph)
            heard, around = torch.split(both, [own.shape[-1], nodes.shape[-1]], -1)
            sees = has_neighbor.to(nodes.dtype)
            around = around - nodes * sees
        mixed = self.mixed(torch.cat([own, heard, around, sees], -1)).tanh()
        # Time first while it is narrow.
        told = self.recurrence(mixed.transpose(0, 1).contiguous())
        known = gated_scan(told, None if there is None else there.transpose(0, 1))
        return _where(there, known.transpose(0, 1))


def _where(there: Tensor | None, values: Tensor) -> Tensor:
    """Return values, 0 where nobody is."""
    return values if there is None else values * there
