"""A gated graph network on what individuals see of each other."""

from collections.abc import Sequence

import torch
from torch import nn

from swarmssm.graphs import Pairs
from swarmssm.models.layers import check_sizes, fan_in_uniform_

__all__ = ["InteractionNetwork"]

#: Neighbours by which a sum over neighbours is divided, so that it is of the size of one message.
USUAL_DEGREE = 6


class InteractionNetwork(nn.Module):
    r"""Gated graph recurrence, with what neighbours do summed and averaged.

    .. math::
        h_i &\leftarrow \mathrm{relu}(W_0 x_i + b_0) \\
        m_{ij} &= \mathrm{relu}(W_e e_{ij} + W_r h_i + W_s h_j + b_e) \\
        u_i &= [x_i, \textstyle\sum_j e_{ij}, \mathrm{mean}_j\, e_{ij}, n_i,
                \sum_j m_{ij}, \mathrm{mean}_j\, m_{ij}] \\
        h_i &\leftarrow (1 - z_i) \odot h_i + z_i \odot \mathrm{relu}(W_c [h_i, u_i] + b_c),
        \qquad z_i = \sigma(W_z [h_i, u_i] + b_z)

    for each round with weights of its own; in the first, messages are of :math:`e_{ij}` alone. The
    result is a linear function of the last :math:`h_i` and of the :math:`[h_i, u_i]` that it was
    made of: what is linear in the features is learned at once, and the layers learn the rest.
    Nothing but ReLU, so that walls and thresholds are few hinges.

    Parameters
    ----------
    own_features
        Features x of an individual.
    pair_features
        Features e of a pair, of which the result may be linear in the first ``linear_features``.
    linear_features
        See there.
    out_features
        Of the result, which is 0 before training.
    width
        Features of h and of messages.
    num_rounds
        Rounds of messages.
    usual_degree
        By which sums and :math:`n_i` are divided.

    Raises
    ------
    ValueError
        If a size is no positive whole number.
    """

    def __init__(
        self,
        own_features: int,
        pair_features: int,
        linear_features: int,
        out_features: int,
        *,
        width: int = 64,
        num_rounds: int = 1,
        usual_degree: float = USUAL_DEGREE,
    ) -> None:
        super().__init__()
        check_sizes(width=width, num_rounds=num_rounds)
        self.linear_features = linear_features
        self.usual_degree = usual_degree
        plain = own_features + 2 * linear_features + 1
        self.enter = nn.Linear(own_features, width)
        self.pair = nn.ModuleList(nn.Linear(pair_features, width) for _ in range(num_rounds))
        self.ends = nn.ModuleList(
            nn.Linear(width, 2 * width, bias=False) for _ in range(num_rounds - 1)
        )
        self.update = nn.ModuleList(
            nn.Linear(plain + 3 * width, 2 * width) for _ in range(num_rounds)
        )
        fan_in_uniform_(self)
        # Hinges through random places, for features of size 1: a wall is rarely at the origin.
        with torch.no_grad():
            through = torch.randn(width, own_features)
            self.enter.bias.copy_(-(self.enter.weight * through).sum(-1))
        self.leave = nn.Linear(width, out_features)
        self.straight = nn.Linear(plain + 3 * width, out_features, bias=False)
        for layer in (self.leave, self.straight):
            for parameter in layer.parameters():
                nn.init.zeros_(parameter)

    def forward(self, own: torch.Tensor, pair: torch.Tensor, pairs: Pairs) -> torch.Tensor:
        """Return the result, ``(..., individual, out_features)``.

        Parameters
        ----------
        own
            ``(..., individual, own_features)``.
        pair
            Of all pairs, or of all edges, as ``pairs`` lays them out.
        pairs
            The graph.
        """
        together, hidden = self._gather(own, pair, pairs)
        gate, candidate, straight = self._last(together)
        hidden = torch.lerp(hidden, torch.relu(candidate), torch.sigmoid(gate))
        result: torch.Tensor = self.leave(hidden) + straight
        return result

    def messages(self, own: torch.Tensor, pair: torch.Tensor, pairs: Pairs) -> torch.Tensor:
        r"""Return :math:`\sum_j m_{ij}` of the last round, divided by ``usual_degree``.

        What each individual hears of its neighbours, as it stands in the last :math:`u_i`.

        Parameters
        ----------
        own, pair, pairs
            As in :meth:`forward`.

        Returns
        -------
        ``(..., individual, width)``, none of them negative.
        """
        together, _ = self._gather(own, pair, pairs)
        width = self.enter.out_features
        # In front of them stands what does not come through a message, and the hidden state.
        return together[..., -2 * width : -width]

    def contributions(
        self, own: torch.Tensor, pair: torch.Tensor, pairs: Pairs, sizes: Sequence[int]
    ) -> torch.Tensor:
        r"""Return the result in the parts that it is the sum of.

        Parameters
        ----------
        own, pair, pairs
            As in :meth:`forward`.
        sizes
            How the first ``linear_features`` of a pair fall into groups: the size of each.

        Returns
        -------
        ``(..., individual, part, out_features)``: what the sum and the mean of each group of pair
        features put in by themselves; then an individual's own features; the messages
        :math:`m_{ij}`; and the last :math:`h_i`.

        Raises
        ------
        ValueError
            If the sizes do not add up to ``linear_features``.
        """
        if sum(sizes) != self.linear_features:
            raise ValueError(
                f"sizes must add up to {self.linear_features}, and they are {list(sizes)}"
            )
        together, before = self._gather(own, pair, pairs)
        gate, candidate, _ = self._last(together)
        hidden = torch.lerp(before, torch.relu(candidate), torch.sigmoid(gate))
        width, first = self.enter.out_features, own.shape[-1]
        weighted = together.unsqueeze(-2) * self.straight.weight
        second = first + self.linear_features
        plain = weighted[..., first:second] + weighted[..., second : second + self.linear_features]
        parts = [part.sum(-1) for part in torch.split(plain, list(sizes), dim=-1)]
        messages = weighted[..., -2 * width :].sum(-1)
        own_part = weighted[..., :first].sum(-1) + weighted[..., -3 * width - 1 : -2 * width].sum(
            -1
        )
        last = nn.functional.linear(hidden, self.leave.weight)
        return torch.stack([*parts, own_part + self.leave.bias, messages, last], dim=-2)

    def _gather(
        self, own: torch.Tensor, pair: torch.Tensor, pairs: Pairs
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the last round's [u, h] and the h it is made of."""
        degree = pairs.degree(own)
        share = 1.0 / degree.clamp(min=1.0)
        features = pairs.sum(pair[..., : self.linear_features])
        scale = 1.0 / self.usual_degree
        plain = torch.cat([own, features * scale, features * share, degree * scale], dim=-1)
        hidden = torch.relu(self.enter(own))
        together = plain
        for place, (message, update) in enumerate(zip(self.pair, self.update, strict=True)):
            sent = message(pair)
            if place > 0:
                to, of = self.ends[place - 1](hidden).chunk(2, dim=-1)
                sent = sent + pairs.receivers(to) + pairs.senders(of)
            # In place: there are many pairs, and nobody else has these numbers.
            summed = pairs.sum(sent.relu_())
            together = torch.cat([plain, hidden, summed * scale, summed * share], dim=-1)
            if place + 1 < len(self.update):
                gate, candidate = update(together).chunk(2, dim=-1)
                hidden = torch.lerp(hidden, torch.relu(candidate), torch.sigmoid(gate))
        return together, hidden

    def _last(self, together: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return gate and candidate of the last round, and what is linear: one product of all."""
        update, width = self.update[-1], self.enter.out_features
        assert isinstance(update, nn.Linear)
        weight = torch.cat([update.weight, self.straight.weight])
        bias = nn.functional.pad(update.bias, (0, self.straight.out_features))
        sizes = [width, width, self.straight.out_features]
        return torch.split(nn.functional.linear(together, weight, bias), sizes, dim=-1)
