"""A recurrent network for each individual by itself."""

from typing import ClassVar

import torch
from torch import Tensor, nn

from swarmssm.baselines.neural import NeuralBaseline
from swarmssm.baselines.recurrent import LookingNetwork
from swarmssm.baselines.step_network import Memory, Setting, StepNetwork

__all__ = ["LSTM", "LstmUnit"]


class LSTM(NeuralBaseline):
    r"""Long short-term memory of each individual's own states, blind to all others.

    .. math::
        (i, f, o) &= \sigma(W x_t + U h_{t-1} + b), \qquad
        g = \tanh(W_g x_t + U_g h_{t-1} + b_g) \\
        c_t &= f \odot c_{t-1} + i \odot g, \qquad h_t = o \odot \tanh(c_t) \\
        x_{t+1} &= x_t + s \odot (W_o h_t + V x_t + b_o)

    with the forget gate of Gers et al. (2000), one set of weights for all individuals, and s the
    typical change of each feature in a frame. What it gains over a forecast from the last state it
    gains by memory; what a method with a graph gains over it, by looking at others.

    The original of Hochreiter and Schmidhuber is a cell, not a forecaster: it has no sizes to
    follow. Here one layer of 64 units; the training is that of :class:`NeuralBaseline`.
    """

    name: ClassVar[str] = "lstm"
    title: ClassVar[str] = "LSTM per individual"
    paper: ClassVar[str] = (
        "Hochreiter and Schmidhuber (1997), Long short-term memory, Neural Computation 9(8)"
    )
    hidden: ClassVar[int] = 64

    def build(self, setting: Setting) -> StepNetwork:
        """Return the cell with its read-out."""
        return _OwnMemory(setting, self.hidden)


class LstmUnit(nn.Module):
    """The cell of the class above, for inputs whose part of the gates is made beforehand.

    Parameters
    ----------
    in_features
        Features of an input.
    hidden
        Size of the memory.
    """

    def __init__(self, in_features: int, hidden: int) -> None:
        super().__init__()
        self.hidden = hidden
        self.given = nn.Linear(in_features, 4 * hidden)
        self.kept = nn.Linear(hidden, 4 * hidden, bias=False)
        with torch.no_grad():
            # Memory is kept from the start (Jozefowicz et al. 2015).
            self.given.bias[hidden : 2 * hidden] = 1.0

    def begin(self, states: Tensor) -> Memory:
        """Return the empty memory."""
        empty = states.new_zeros(*states.shape[:-1], self.hidden)
        return {"hidden": empty, "cell": empty}

    def forward(self, gates: Tensor, memory: Memory) -> Memory:
        """Return the next memory, given ``given(input)``."""
        gates = gates + self.kept(memory["hidden"])
        size = self.hidden
        write, keep, read = torch.sigmoid(gates[..., : 3 * size]).chunk(3, dim=-1)
        cell = keep * memory["cell"] + write * torch.tanh(gates[..., 3 * size :])
        return {"hidden": read * torch.tanh(cell), "cell": cell}


class _OwnMemory(LookingNetwork):
    def __init__(self, setting: Setting, hidden: int) -> None:
        super().__init__()
        self.unit = LstmUnit(setting.features, hidden)
        self.out = nn.Linear(hidden, setting.features)
        self.direct = nn.Linear(setting.features, setting.features, bias=False)
        self.register_buffer("change", setting.change)

    def begin(self, states: Tensor) -> Memory:
        return self.unit.begin(states)

    def look(self, states: Tensor, mask: Tensor, graph: Tensor) -> Memory:
        return {"gates": self.unit.given(states), "straight": self.direct(states)}

    def move(self, states: Tensor, seen: Memory, memory: Memory) -> tuple[Tensor, Memory]:
        memory = self.unit(seen["gates"], memory)
        change = self.out(memory["hidden"]) + seen["straight"]
        return states + self.get_buffer("change") * change, memory
