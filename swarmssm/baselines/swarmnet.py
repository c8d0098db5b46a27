"""Convolution over a short past, then messages between all pairs."""

from typing import ClassVar

import torch
from torch import Tensor, nn

from swarmssm.baselines.neural import NeuralBaseline
from swarmssm.baselines.step_network import Memory, Setting, StepNetwork

__all__ = ["SwarmNet"]


class SwarmNet(NeuralBaseline):
    r"""SwarmNet: a convolution over the last frames of each individual, then a graph network.

    .. math::
        v_i &= \mathrm{conv}(x_{i, t-w+1}, \dots, x_{i, t}) \\
        e_{ij} &= \phi_e([v_i, v_j]), \qquad
        v'_i = \phi_v\Big(\Big[v_i, \frac{1}{|N_i|} \sum_{j \ne i} e_{ij}\Big]\Big) \\
        x_{i, t+1} &= x_{i, t} + s \odot (W v'_i + b)

    over all pairs, whatever the graph of the training says, with s the typical change of each
    feature in a frame.

    The example that comes with the authors' code has two convolutions of width 3 with 32 and 64
    filters (so w = 5), two layers of 64 units in each function, a weight decay of 1e-3 and Adam at
    1e-3, and nodes of goals and obstacles beside the agents. Here there are no goals, 64 filters in
    both convolutions, a first layer of the edges that is the sum of a product of each end, a mean
    over neighbours, no weight decay, and the training of :class:`NeuralBaseline`. Frames before an
    individual was first seen are filled by going back from there at constant velocity.
    """

    name: ClassVar[str] = "swarmnet"
    title: ClassVar[str] = "SwarmNet"
    paper: ClassVar[str] = (
        "Zhou, Phielipp, Sefair, Walker and Ben Amor (2019), Clone swarms: learning to predict and "
        "control multi-robot systems by imitation, IROS"
    )
    hidden: ClassVar[int] = 64
    order: int = 12
    pairwise: ClassVar[bool] = True
    everybody: ClassVar[bool] = True

    def build(self, setting: Setting) -> StepNetwork:
        """Return the convolutions and the graph network."""
        return _ConvolutionThenPairs(setting, self.hidden)


class _ConvolutionThenPairs(StepNetwork):
    width = 3
    window = 5

    def __init__(self, setting: Setting, hidden: int) -> None:
        super().__init__()
        features = setting.features
        self.early = nn.Conv1d(features, hidden, self.width)
        self.late = nn.Conv1d(hidden, hidden, self.width)
        self.receiver = nn.Linear(hidden, hidden)
        self.sender = nn.Linear(hidden, hidden, bias=False)
        self.message = nn.Linear(hidden, hidden)
        self.node = nn.Linear(2 * hidden, hidden)
        self.out = nn.Linear(hidden, features)
        self.register_buffer("change", setting.change)
        scale = torch.tensor(setting.scaler.scale).chunk(2)
        offset = torch.tensor(setting.scaler.offset).chunk(2)
        # Per frame, in scaled units: position changes by velocity * gain + drift.
        self.register_buffer("gain", scale[1] / (scale[0] * setting.fps))
        self.register_buffer("drift", offset[1] / (scale[0] * setting.fps))

    def begin(self, states: Tensor) -> Memory:
        shape = (*states.shape[:2], self.window - 1)
        return {
            "past": states.new_zeros(*shape, states.shape[-1]),
            "seen": torch.zeros(shape, dtype=torch.bool),
        }

    def step(
        self, states: Tensor, mask: Tensor, graph: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        path = torch.cat([memory["past"], states[:, :, None]], dim=2)
        seen = torch.cat([memory["seen"], mask[..., None]], dim=2)
        expected = self._expected(path, seen, graph[:, None])[:, 0]
        return expected, {"past": path[:, :, 1:], "seen": seen[:, :, 1:]}

    def run(self, states: Tensor, mask: Tensor, graph: Tensor) -> tuple[Tensor, Memory]:
        memory = self.begin(states[:, 0])
        path = torch.cat([memory["past"], states.transpose(1, 2)], dim=2)
        seen = torch.cat([memory["seen"], mask.transpose(1, 2)], dim=2)
        kept = self.window - 1
        memory = {"past": path[:, :, -kept:], "seen": seen[:, :, -kept:]}
        return self._expected(path, seen, graph), memory

    def _expected(self, path: Tensor, seen: Tensor, graph: Tensor) -> Tensor:
        """Return the expected state after each frame from the last of the first window on.

        Of paths ``(batch, individual, time, state)``, where they are known, and graphs
        ``(batch, frame, individual, individual)``: ``(batch, frame, individual, state)``.
        """
        path = self._carried_back(path, seen)
        batch, individuals = path.shape[:2]
        flat = path.flatten(0, 1).transpose(1, 2)
        nodes = self.late(self.early(flat).relu()).relu()
        nodes = nodes.unflatten(0, (batch, individuals)).permute(0, 3, 1, 2)
        pairs = self.receiver(nodes)[..., :, None, :] + self.sender(nodes)[..., None, :, :]
        messages = self.message(pairs.relu()).relu()
        share = graph / graph.sum(-1, keepdim=True).clamp(min=1.0)
        gathered = (share[..., None, :] @ messages)[..., 0, :]
        hidden = self.node(torch.cat([nodes, gathered], dim=-1)).relu()
        now = path[:, :, self.window - 1 :].transpose(1, 2)
        expected: Tensor = now + self.get_buffer("change") * self.out(hidden)
        return expected

    def _carried_back(self, path: Tensor, seen: Tensor) -> Tensor:
        """Fill what is unknown from the next known frame, back at constant velocity."""
        if bool(seen.all()):
            return path
        frames = torch.arange(path.shape[2])
        found = torch.where(seen, frames, path.shape[2] - 1)
        following = found.flip(-1).cummin(-1).values.flip(-1)
        path = path.gather(2, following[..., None].expand_as(path))
        position, velocity = path.chunk(2, dim=-1)
        moved = velocity * self.get_buffer("gain") + self.get_buffer("drift")
        back = (following - frames)[..., None] * moved
        return torch.cat([position - back, velocity], dim=-1)
