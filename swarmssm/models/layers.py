"""Graph layers on dense adjacencies, batched over any leading dimensions.

In all of them ``adjacency[..., i, j] = 1`` means that i receives from j.
"""

import itertools
import math
from collections.abc import Sequence

import torch
from torch import nn

__all__ = [
    "GatedGraphLayer",
    "GraphConvolution",
    "check_sizes",
    "fan_in_uniform_",
    "multilayer_perceptron",
]


class GatedGraphLayer(nn.Module):
    r"""Gated graph neural network, eqs (3.9)-(3.15) (Li et al. 2016).

    With :math:`h^0 = [x, 0]`, for each of ``num_rounds``

    .. math:: m_i = \sum_j A_{ij} W h_j, \qquad h_i \leftarrow \mathrm{GRU}(m_i, h_i).

    The gated recurrent unit is torch's: it differs from the printed (3.12) and (3.13) in applying
    the reset gate after the product with :math:`U_u`, and in naming the update gate's complement.
    The messages carry the learned :math:`W` of Li et al., which (3.9) leaves out and the text
    beside it names.

    Parameters
    ----------
    in_features
        Features of a node; at most ``out_features``, and padded with zeros to as many.
    out_features
        Features of the hidden state.
    num_rounds
        Rounds of message passing, each with its own :math:`W` and one common unit.

    Raises
    ------
    ValueError
        If a size is no positive whole number, or the nodes have more features than the result.

    Shapes
    ------
    nodes ``(..., individual, in_features)``, adjacency ``(..., individual, individual)``, result
    ``(..., individual, out_features)``.
    """

    def __init__(self, in_features: int, out_features: int, num_rounds: int = 1) -> None:
        super().__init__()
        check_sizes(in_features=in_features, out_features=out_features, num_rounds=num_rounds)
        if in_features > out_features:
            raise ValueError(f"out_features ({out_features}) must be at least {in_features}")
        self.padding = out_features - in_features
        self.weight = nn.Parameter(torch.empty(num_rounds, out_features, out_features))
        self.unit = nn.GRUCell(out_features, out_features)
        fan_in_uniform_(self)

    def forward(self, nodes: torch.Tensor, adjacency: torch.Tensor) -> torch.Tensor:
        """Propagate along the edges; shapes as in the class."""
        hidden = nn.functional.pad(nodes, (0, self.padding))
        shape = hidden.shape
        for weight in self.weight:
            messages = adjacency @ (hidden @ weight)
            flat = self.unit(messages.reshape(-1, shape[-1]), hidden.reshape(-1, shape[-1]))
            hidden = flat.reshape(shape)
        return hidden


class GraphConvolution(nn.Module):
    r"""Graph convolution, eqs (3.7) and (3.8) (Kipf and Welling 2017).

    .. math:: h'_i = W_{self} h_i + \sum_j c_{ij} W_{neigh} h_j + b, \qquad
              c = \tilde D^{-1/2} (A + I) \tilde D^{-1/2}

    without the non-linearity, which the caller applies.

    Parameters
    ----------
    in_features, out_features
        Features of a node before and after.
    self_weight
        Whether the first term is there. (3.7) prints it; Kipf and Welling, and the usual
        libraries, leave it out, and then individuals that all see each other become equal.

    Raises
    ------
    ValueError
        If a size is no positive whole number.

    Shapes
    ------
    nodes ``(..., individual, in_features)``, normalized ``(..., individual, individual)`` as
    returned by :func:`swarmssm.graphs.normalized_adjacency`, result
    ``(..., individual, out_features)``.
    """

    def __init__(self, in_features: int, out_features: int, *, self_weight: bool = True) -> None:
        super().__init__()
        check_sizes(in_features=in_features, out_features=out_features)
        self.neighbor = nn.Linear(in_features, out_features, bias=False)
        self.own = nn.Linear(in_features, out_features, bias=False) if self_weight else None
        self.bias = nn.Parameter(torch.zeros(out_features))
        fan_in_uniform_(self)

    def forward(self, nodes: torch.Tensor, normalized: torch.Tensor) -> torch.Tensor:
        """Convolve with a normalised adjacency; shapes as in the class."""
        out: torch.Tensor = normalized @ self.neighbor(nodes) + self.bias
        if self.own is not None:
            out = out + self.own(nodes)
        return out


def multilayer_perceptron(widths: Sequence[int]) -> nn.Sequential:
    """Return fully connected layers of the given widths, with ReLU between them.

    Raises
    ------
    ValueError
        If a width is no positive whole number, or there are fewer than two.
    """
    if len(widths) < 2:
        raise ValueError("widths must have at least two numbers: those before and after")
    check_sizes(**{f"widths[{place}]": width for place, width in enumerate(widths)})
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU()]
    network = nn.Sequential(*layers[:-1])
    fan_in_uniform_(network)
    return network


def fan_in_uniform_(module: nn.Module) -> None:
    """Initialise as in (3.60): weights uniform within ``1 / sqrt(columns)``, biases zero."""
    with torch.no_grad():
        for parameter in module.parameters():
            if parameter.dim() < 2:
                parameter.zero_()
            else:
                bound = 1.0 / math.sqrt(parameter.shape[-1])
                parameter.uniform_(-bound, bound)


def check_sizes(**sizes: int) -> None:
    """Refuse sizes of a network that are no positive whole numbers.

    Raises
    ------
    ValueError
        Naming the size and its value.
    """
    for name, size in sizes.items():
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise ValueError(f"{name} must be a positive whole number, not {size!r}")
