"""From what each individual does to an embedding of each ordered pair, by message passing."""

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

__all__ = ["PairEmbedding", "PairLayer", "mean_over_neighbors", "pairs_of"]

#: Numbers of one layer of pairs that are held at once; above it graphs come one after the other.
MOST_AT_ONCE = 1 << 25


class NodeLayer(nn.Module):
    """Two linear layers with ELU, and layer normalisation: the building stone of the encoder."""

    def __init__(self, features: int, hidden: int) -> None:
        super().__init__()
        self.first = nn.Linear(features, hidden)
        self.second = nn.Linear(hidden, hidden)
        self.norm = nn.LayerNorm(hidden)

    def forward(self, values: Tensor) -> Tensor:
        """Return ``(..., hidden)``."""
        between = functional.elu(self.first(values), inplace=True)
        out: Tensor = self.norm(functional.elu(self.second(between), inplace=True))
        return out


class PairLayer(nn.Module):
    """The same on pairs: on the features of the receiver, of the sender, and of the pair.

    The first layer is linear in the three, so that those of the individuals go through it before
    they are spread over the pairs.
    """

    def __init__(self, features: int, hidden: int, pair_features: int = 0) -> None:
        super().__init__()
        self.receiver = nn.Linear(features, hidden)
        self.sender = nn.Linear(features, hidden, bias=False)
        self.pair = nn.Linear(pair_features, hidden, bias=False) if pair_features else None
        self.second = nn.Linear(hidden, hidden)
        self.norm = nn.LayerNorm(hidden)

    def forward(self, nodes: Tensor, pairs: Tensor | None = None) -> Tensor:
        """Return ``(..., individual, neighbor, hidden)``."""
        first = self.receiver(nodes).unsqueeze(-2) + self.sender(nodes).unsqueeze(-3)
        if self.pair is not None:
            first = first + self.pair(pairs)
        between = functional.elu(first, inplace=True)
        out: Tensor = self.norm(functional.elu(self.second(between), inplace=True))
        return out


class PairEmbedding(nn.Module):
    r"""The encoder of neural relational inference, up to its last layer.

    .. math::
        h_j = f_1(x_j), \quad h_{ij} = f_2(h_i, h_j, r_{ij}), \quad
        h_i' = f_3\Bigl(\frac{1}{|\mathcal{N}_i|} \sum_{j \in \mathcal{N}_i} h_{ij}\Bigr), \quad
        h_{ij}' = f_4(h_i', h_j', h_{ij}),

    (5) to (8) of the paper with the skip connection of its code, where i is the one that is moved
    and j the one that moves it; all f are two linear layers with ELU. Differs from the paper: layer
    in place of batch normalisation, so that a graph does not depend on what else is in the batch
    nor on who is absent; the mean over those present in place of the sum over N; and optional
    features *r* of the pair itself.

    Parameters
    ----------
    features, pair_features
        Numbers known of each individual, and of each pair (0: none).
    hidden
        Width of all layers, the embedding included.
    """

    def __init__(self, features: int, hidden: int, pair_features: int = 0) -> None:
        super().__init__()
        self.hidden = hidden
        self.node = NodeLayer(features, hidden)
        self.to_edge = PairLayer(hidden, hidden, pair_features)
        self.to_node = NodeLayer(hidden, hidden)
        self.out = PairLayer(hidden, hidden, hidden)

    def forward(
        self, values: Tensor, pair_values: Tensor | None = None, pairs: Tensor | None = None
    ) -> Tensor:
        """Embed each pair.

        Parameters
        ----------
        values
            Shape ``(graph, individual, feature)``; finite where an individual is absent, too.
        pair_values
            Shape ``(graph, individual, neighbor, pair_feature)``.
        pairs
            Which pairs there are, ``(graph, individual, neighbor)`` of bool; default all of two.

        Returns
        -------
        Shape ``(graph, individual, neighbor, hidden)``.
        """
        if pairs is None:
            pairs = pairs_of(torch.ones(values.shape[:-1], dtype=torch.bool, device=values.device))
        graphs, individuals = values.shape[:2]
        at_once = max(1, MOST_AT_ONCE // max(1, individuals**2 * self.hidden))
        if graphs <= at_once:
            return self._embed(values, pair_values, pairs)
        out = []
        for start in range(0, graphs, at_once):
            part = slice(start, start + at_once)
            extra = None if pair_values is None else pair_values[part]
            inputs = (values[part], extra, pairs[part])
            if torch.is_grad_enabled():
                out.append(checkpoint(self._embed, *inputs, use_reentrant=False))
            else:
                out.append(self._embed(*inputs))
        return torch.cat(out)

    def _embed(self, values: Tensor, pair_values: Tensor | None, pairs: Tensor) -> Tensor:
        """Embed each pair of some graphs."""
        edges = self.to_edge(self.node(values), pair_values)
        nodes = self.to_node(mean_over_neighbors(edges, pairs))
        out: Tensor = self.out(nodes, edges)
        return out


def mean_over_neighbors(edges: Tensor, pairs: Tensor) -> Tensor:
    """Return ``(..., individual, hidden)`` of ``(..., individual, neighbor, hidden)``.

    Who has no neighbor gets 0.
    """
    weight = pairs.to(edges.dtype)
    total = torch.einsum("...ijh,...ij->...ih", edges, weight)
    return total / weight.sum(-1, keepdim=True).clamp(min=1.0)


def pairs_of(present: Tensor) -> Tensor:
    """Return the pairs of two different individuals that are both there.

    Parameters
    ----------
    present
        Shape ``(..., individual)`` of bool.

    Returns
    -------
    Shape ``(..., individual, neighbor)`` of bool.
    """
    both = present.unsqueeze(-1) & present.unsqueeze(-2)
    return both & ~torch.eye(present.shape[-1], dtype=torch.bool, device=present.device)
