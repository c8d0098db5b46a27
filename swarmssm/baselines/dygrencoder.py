"""A gated graph network in each frame, and a recurrent one over time."""

from typing import ClassVar

from torch import Tensor, nn

from swarmssm.baselines.lstm import LstmUnit
from swarmssm.baselines.neural import NeuralBaseline
from swarmssm.baselines.recurrent import LookingNetwork
from swarmssm.baselines.step_network import Memory, Setting, StepNetwork
from swarmssm.models.layers import GatedGraphLayer

__all__ = ["DyGrEncoder", "DyGrEncoderDirect"]


class DyGrEncoder(NeuralBaseline):
    r"""DyGrEncoder: gated graph network, then long short-term memory, with residual output.

    .. math::
        h^0_i &= [x_i, 0], \qquad
        m_i = \frac{1}{|N_i|} \sum_{j \in N_i} W_l h^l_j, \qquad
        h^{l+1}_i = \mathrm{GRU}(m_i, h^l_i) \\
        (a_t, c_t) &= \mathrm{LSTM}(h^L_t, a_{t-1}, c_{t-1}) \\
        x_{t+1} &= x_t + s \odot (W \, \mathrm{relu}(a_t) + b)

    with s the typical change of each feature in a frame. The last line is not in the paper, whose
    decoder rebuilds the graph of a sequence; for states its users read the next one out of
    :math:`a_t`, see :class:`DyGrEncoderDirect`.

    The original embeds a whole graph, in order to tell kinds of behaviour apart; its port to node
    features keeps an LSTM per node with shared weights, as here. Both sum over neighbours, with
    sizes that the user chooses. Here neighbours are averaged, so that groups of all sizes stay
    within the range of the gates, in 2 rounds of 64 units; the training is that of
    :class:`NeuralBaseline`.
    """

    name: ClassVar[str] = "dygrencoder"
    title: ClassVar[str] = "DyGrEncoder (residual)"
    paper: ClassVar[str] = (
        "Taheri, Gimpel and Berger-Wolf (2019), Learning to represent the evolution of dynamic "
        "graphs with recurrent models, WWW Companion"
    )
    hidden: ClassVar[int] = 64
    rounds: ClassVar[int] = 2
    residual: ClassVar[bool] = True

    def build(self, setting: Setting) -> StepNetwork:
        """Return the two networks with their read-out."""
        return _GraphThenTime(setting, self.hidden, self.rounds, self.residual)


class DyGrEncoderDirect(DyGrEncoder):
    r"""DyGrEncoder that writes out the next state itself.

    .. math:: x_{t+1} = W \, \mathrm{relu}(a_t) + b

    as the thesis and the method's port for node features do. All else is as in
    :class:`DyGrEncoder`.
    """

    name: ClassVar[str] = "dygrencoder-direct"
    title: ClassVar[str] = "DyGrEncoder (direct)"
    residual: ClassVar[bool] = False


class _GraphThenTime(LookingNetwork):
    def __init__(self, setting: Setting, hidden: int, rounds: int, residual: bool) -> None:
        super().__init__()
        self.residual = residual
        self.gather = GatedGraphLayer(setting.features, hidden, rounds)
        self.unit = LstmUnit(hidden, hidden)
        self.out = nn.Linear(hidden, setting.features)
        self.register_buffer("change", setting.change)

    def begin(self, states: Tensor) -> Memory:
        return self.unit.begin(states)

    def look(self, states: Tensor, mask: Tensor, graph: Tensor) -> Memory:
        mean = graph / graph.sum(-1, keepdim=True).clamp(min=1.0)
        return {"gates": self.unit.given(self.gather(states, mean))}

    def move(self, states: Tensor, seen: Memory, memory: Memory) -> tuple[Tensor, Memory]:
        memory = self.unit(seen["gates"], memory)
        out = self.out(memory["hidden"].relu())
        following = states + self.get_buffer("change") * out if self.residual else out
        return following, memory
