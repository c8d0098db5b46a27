"""A recurrent network that diffuses over the graph in its gates."""

from typing import ClassVar

import torch
from torch import Tensor, nn

from swarmssm.baselines.neural import NeuralBaseline
from swarmssm.baselines.recurrent import LookingNetwork
from swarmssm.baselines.step_network import Memory, Setting, StepNetwork

__all__ = ["DCRNN", "DCRNNDirect", "random_walks"]


class DCRNN(NeuralBaseline):
    r"""Diffusion convolutional recurrent neural network (DCRNN), with residual output.

    A gated recurrent unit in which every product with a matrix of weights is a convolution over
    random walks of up to K steps on the graph, forwards and backwards:

    .. math::
        \Theta \star_G X &= X \Theta_0 + \sum_{k=1}^{K}
            (D_O^{-1} A)^k X \Theta_{k,1} + (D_I^{-1} A^T)^k X \Theta_{k,2} \\
        r, u &= \sigma(\Theta_{r,u} \star_G [x_t, h_{t-1}] + b_{r,u}) \\
        c &= \tanh(\Theta_c \star_G [x_t, r \odot h_{t-1}] + b_c), \qquad
        h_t = u \odot h_{t-1} + (1 - u) \odot c \\
        x_{t+1} &= x_t + s \odot (W h_t + b)

    The last line is not in the paper, which writes out the next state itself, see
    :class:`DCRNNDirect`; s is the typical change of each feature in a
    frame.

    The original has two layers of 64 units, an encoder and a decoder with weights of their own, K
    of 2 or 3, Adam at 1e-2 with steps down, and scheduled sampling, for roads whose graph stays.
    Here there is one layer of 64 units whose decoder goes on with the encoder's weights, K = 2, and
    a graph that is made anew in each frame; the training, with its own steps after the known frames
    instead of scheduled sampling, is that of :class:`NeuralBaseline`.
    """

    name: ClassVar[str] = "dcrnn"
    title: ClassVar[str] = "DCRNN (residual)"
    paper: ClassVar[str] = (
        "Li, Yu, Shahabi and Liu (2018), Diffusion convolutional recurrent neural network: "
        "data-driven traffic forecasting, ICLR"
    )
    hidden: ClassVar[int] = 64
    walk: ClassVar[int] = 2
    residual: ClassVar[bool] = True

    def build(self, setting: Setting) -> StepNetwork:
        """Return the unit with its read-out."""
        return _DiffusionUnit(setting, self.hidden, self.walk, self.residual)


class DCRNNDirect(DCRNN):
    r"""DCRNN that writes out the next state itself, :math:`x_{t+1} = W h_t + b`, as published.

    All else is as in :class:`DCRNN`. A state that hardly changes from frame
    to frame has to pass through the gates without loss, which costs most of the accuracy.
    """

    name: ClassVar[str] = "dcrnn-direct"
    title: ClassVar[str] = "DCRNN (direct)"
    residual: ClassVar[bool] = False


def random_walks(graph: Tensor, steps: int) -> Tensor:
    """Return where walks of 1 to ``steps`` steps end, forwards, then backwards.

    Parameters
    ----------
    graph
        Shape ``(..., individual, individual)``; a step forwards goes to somebody whom one sees, a
        step backwards to somebody by whom one is seen, each as likely as the others.
    steps
        Most steps of a walk.

    Returns
    -------
    Shape ``(..., 2 * steps, individual, individual)``: probabilities in each row, or zeros where
    there is nobody to go to.
    """
    walks = []
    for edges in (graph, graph.transpose(-1, -2)):
        step = edges / edges.sum(-1, keepdim=True).clamp(min=1.0)
        walk = step
        for _ in range(steps - 1):
            walks.append(walk)
            walk = walk @ step
        walks.append(walk)
    return torch.stack(walks, dim=-3)


def _spread(walks: Tensor, nodes: Tensor) -> Tensor:
    """Return nodes ``(..., individual, feature)`` with what walks bring to them beside them."""
    count, individuals = walks.shape[-3], walks.shape[-1]
    gathered = walks.flatten(-3, -2) @ nodes
    apart = gathered.reshape(*nodes.shape[:-2], count, individuals, nodes.shape[-1])
    gathered = apart.transpose(-3, -2).flatten(-2)
    return torch.cat([nodes, gathered], dim=-1)


class _DiffusionUnit(LookingNetwork):
    def __init__(self, setting: Setting, hidden: int, walk: int, residual: bool) -> None:
        super().__init__()
        self.hidden, self.walk, self.residual = hidden, walk, residual
        kinds = 1 + 2 * walk
        self.given = nn.Linear(kinds * setting.features, 3 * hidden)
        self.kept = nn.Linear(kinds * hidden, 2 * hidden, bias=False)
        self.fresh = nn.Linear(kinds * hidden, hidden, bias=False)
        self.out = nn.Linear(hidden, setting.features)
        self.register_buffer("change", setting.change)

    def begin(self, states: Tensor) -> Memory:
        return {"hidden": states.new_zeros(*states.shape[:-1], self.hidden)}

    def look(self, states: Tensor, mask: Tensor, graph: Tensor) -> Memory:
        walks = random_walks(graph, self.walk)
        # Individuals first, as all that is cut into frames: (..., individual, walk, individual).
        return {
            "gates": self.given(_spread(walks, states)),
            "walks": walks.transpose(-3, -2),
        }

    def move(self, states: Tensor, seen: Memory, memory: Memory) -> tuple[Tensor, Memory]:
        walks, hidden = seen["walks"].transpose(-3, -2), memory["hidden"]
        given, fresh = torch.split(seen["gates"], [2 * self.hidden, self.hidden], dim=-1)
        gates = torch.sigmoid(given + self.kept(_spread(walks, hidden)))
        reset, update = gates.chunk(2, dim=-1)
        candidate = torch.tanh(fresh + self.fresh(_spread(walks, reset * hidden)))
        hidden = update * hidden + (1.0 - update) * candidate
        out = self.out(hidden)
        following = states + self.get_buffer("change") * out if self.residual else out
        return following, {"hidden": hidden}
