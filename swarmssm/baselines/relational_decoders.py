"""Decoders of relational inference: the next state, given the type of every edge."""

import math

import torch
from torch import Tensor, nn

__all__ = ["PerceptronDecoder", "RecurrentDecoder"]


class TypedMessages(nn.Module):
    """A two-layer message along each edge for each type, weighted by how likely the type is.

    Type 0 is no edge and sends nothing.

    Parameters
    ----------
    features
        Of each of the two individuals.
    hidden
        Width of the layers and of the messages.
    num_types
        Number of types, that of no edge included.
    activation
        After each of the two layers.
    """

    def __init__(self, features: int, hidden: int, num_types: int, activation: nn.Module) -> None:
        super().__init__()
        sending = num_types - 1
        self.sending, self.hidden, self.activation = sending, hidden, activation
        self.receiver = nn.Linear(features, sending * hidden)
        self.sender = nn.Linear(features, sending * hidden, bias=False)
        bound = 1.0 / math.sqrt(hidden)
        self.weight = nn.Parameter(torch.empty(sending, hidden, hidden).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(sending, 1, hidden).uniform_(-bound, bound))

    def forward(self, nodes: Tensor, edges: Tensor) -> Tensor:
        """Sum the messages to each individual.

        Parameters
        ----------
        nodes
            Shape ``(batch, individual, feature)``.
        edges
            Weights of the types, ``(batch, individual, neighbor, edge_type)``; 0 for no pair.

        Returns
        -------
        Shape ``(batch, individual, hidden)``.
        """
        first = self.activation(
            self.receiver(nodes).unsqueeze(-2) + self.sender(nodes).unsqueeze(-3)
        )
        rows = first.reshape(-1, self.sending, self.hidden)
        total = nodes.new_zeros(*nodes.shape[:-1], self.hidden)
        for k in range(self.sending):
            message = self.activation(torch.addmm(self.bias[k], rows[:, k], self.weight[k]))
            weight = edges[..., k + 1].unsqueeze(-1)
            total = total + (message.view(*weight.shape[:-1], self.hidden) * weight).sum(-2)
        return total


class PerceptronDecoder(nn.Module):
    r"""The perceptron decoder of neural relational inference, (9) and (10) of Kipf et al. 2018.

    .. math::
        h_{ij} = \sum_{k > 0} z_{ijk} f^k(x_i, x_j), \qquad
        x_i' = x_i + s \odot f_v\Bigl(x_i, \sum_{j \ne i} h_{ij}\Bigr),

    with s the typical change of each feature in a frame. It has no memory.
    """

    def __init__(self, change: Tensor, hidden: int, num_types: int) -> None:
        super().__init__()
        features = len(change)
        self.messages = TypedMessages(features, hidden, num_types, nn.ReLU(inplace=True))
        self.out = _out(features + hidden, hidden, features)
        self.register_buffer("change", change)

    def begin(self, states: Tensor) -> Tensor:
        """Return the memory before the first frame, which is empty."""
        return states.new_zeros((*states.shape[:-1], 0))

    def forward(self, states: Tensor, edges: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Return the expected next state and the memory after this one.

        Parameters
        ----------
        states
            Shape ``(batch, individual, state)``.
        edges
            Weights of the types, ``(batch, individual, neighbor, edge_type)``; 0 for no pair.
        hidden
            Memory of each individual, ``(batch, individual, hidden)``.
        """
        gathered = self.messages(states, edges)
        change = self.out(torch.cat([states, gathered], dim=-1))
        return states + self.get_buffer("change") * change, hidden


class RecurrentDecoder(nn.Module):
    r"""The recurrent decoder of neural relational inference, (13) to (17) of Kipf et al. 2018.

    .. math::
        m_i &= \frac{1}{|\mathcal{N}_i|} \sum_{j \ne i} \sum_{k > 0} z_{ijk} f^k(h_i, h_j) \\
        r, u &= \sigma(W_{r,u}\, m_i + V_{r,u}\, x_i), \qquad
        n = \tanh(W_n m_i \odot r + V_n x_i) \\
        h_i' &= (1 - u) \odot n + u \odot h_i, \qquad x_i' = x_i + s \odot f_{out}(h_i')

    with s the typical change of each feature in a frame.
    """

    def __init__(self, change: Tensor, hidden: int, num_types: int) -> None:
        super().__init__()
        features = len(change)
        self.hidden = hidden
        self.messages = TypedMessages(hidden, hidden, num_types, nn.Tanh())
        self.of_messages = nn.Linear(hidden, 3 * hidden, bias=False)
        self.of_states = nn.Linear(features, 3 * hidden)
        self.out = _out(hidden, hidden, features)
        self.register_buffer("change", change)

    def begin(self, states: Tensor) -> Tensor:
        """Return the memory before the first frame."""
        return states.new_zeros((*states.shape[:-1], self.hidden))

    def forward(self, states: Tensor, edges: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Return the expected next state and the memory after this one.

        Parameters are those of :class:`PerceptronDecoder`.
        """
        neighbors = edges.sum(-1).sum(-1, keepdim=True).clamp(min=1.0)
        gathered = self.messages(hidden, edges) / neighbors
        reset, keep, new = self.of_messages(gathered).chunk(3, dim=-1)
        own_reset, own_keep, own_new = self.of_states(states).chunk(3, dim=-1)
        fresh = torch.tanh(own_new + torch.sigmoid(own_reset + reset) * new)
        update = torch.sigmoid(own_keep + keep)
        hidden = (1.0 - update) * fresh + update * hidden
        return states + self.get_buffer("change") * self.out(hidden), hidden


def _out(features: int, hidden: int, out: int) -> nn.Sequential:
    """Return three layers."""
    return nn.Sequential(
        nn.Linear(features, hidden),
        nn.ReLU(),
        nn.Linear(hidden, hidden),
        nn.ReLU(),
        nn.Linear(hidden, out),
    )
