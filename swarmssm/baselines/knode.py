"""Known dynamics, and a neural differential equation for what they miss."""

import importlib
from collections.abc import Callable
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from swarmssm.baselines.neural import NeuralBaseline
from swarmssm.baselines.step_network import Memory, Setting, StepNetwork
from swarmssm.errors import InputError
from swarmssm.tracks.scaling import Scaler

__all__ = ["KNODE", "Prior", "constant_velocity"]

#: From states ``(..., individual, state)`` in the tracks' units and the graph
#: ``(..., individual, individual)`` to what the states change by in a second.
Prior = Callable[[Tensor, Tensor], Tensor]


def constant_velocity(states: Tensor, graph: Tensor) -> Tensor:
    """Return the derivative of states that go straight on, whatever the graph."""
    velocity = states.chunk(2, dim=-1)[1]
    return torch.cat([velocity, torch.zeros_like(velocity)], dim=-1)


class KNODE(NeuralBaseline):
    r"""Knowledge-based neural ordinary differential equation (KNODE) for swarms.

    .. math::
        \dot x_i = f(x, A)_i + s \odot g_\theta\Big(x_i,
            \frac{1}{|N_i|} \sum_{j \in N_i} (x_j - x_i)\Big)

    f is what is known, constant velocity if nothing else is; g is a multilayer perceptron, and s
    the typical change of each feature in a frame, per frame. One Runge-Kutta step of fourth order a
    frame, by torchdiffeq; the graph stays as it is during a step. Nothing is remembered.

    The first paper joins f and g by weights that are learned too, and takes the sizes of g from
    case to case; the robots of the second also have delays and obstacles. Here g adds to f and has
    two hidden layers of 64 tanh units, there are neither delays nor obstacles, and the training,
    on a few steps ahead as theirs, is that of :class:`NeuralBaseline`.

    Parameters
    ----------
    prior
        The known part f: from states ``(..., individual, state)`` in the tracks' units and the
        graph to their derivative per second. To save the baseline with pickle it must be a function
        of a module.
    """

    name: ClassVar[str] = "knode"
    title: ClassVar[str] = "KNODE"
    paper: ClassVar[str] = (
        "Jiahao, Hsieh and Forgoston (2021), Knowledge-based learning of nonlinear dynamics and "
        "chaos, Chaos 31; Jiahao, Pan and Hsieh (2022), Learning to swarm with knowledge-based "
        "neural ordinary differential equations, ICRA"
    )
    hidden: ClassVar[int] = 64
    order: int = 1
    rows: ClassVar[int] = 160

    def __init__(self, prior: Prior = constant_velocity) -> None:
        super().__init__()
        self.prior = prior

    def build(self, setting: Setting) -> StepNetwork:
        """Return the differential equation.

        Raises
        ------
        InputError
            If torchdiffeq is not installed.
        """
        solver()
        return _Flow(setting, self.hidden, self.prior)


def solver() -> Any:
    """Return torchdiffeq's ``odeint``, which is installed with the extra ``benchmark``."""
    try:
        return importlib.import_module("torchdiffeq").odeint
    except ModuleNotFoundError as error:
        raise InputError(
            "knode: it needs torchdiffeq. Install it with pip install 'swarmssm[benchmark]'."
        ) from error


class _Flow(StepNetwork):
    def __init__(self, setting: Setting, hidden: int, prior: Prior) -> None:
        super().__init__()
        self.prior, self.fps = prior, setting.fps
        self.scaler: Scaler = setting.scaler
        self.rest = nn.Sequential(
            nn.Linear(2 * setting.features, hidden),
            nn.Tanh(),
            nn.Linear(hidden, hidden),
            nn.Tanh(),
            nn.Linear(hidden, setting.features),
        )
        self.register_buffer("change", setting.change)

    def step(
        self, states: Tensor, mask: Tensor, graph: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        mean = graph / graph.sum(-1, keepdim=True).clamp(min=1.0)
        alone = mean.sum(-1, keepdim=True)
        scale = states.new_tensor(self.scaler.scale) * self.fps

        def per_frame(_: Tensor, now: Tensor) -> Tensor:
            known = self.prior(self.scaler.inverse_tensor(now), graph) / scale
            rest: Tensor = self.rest(torch.cat([now, mean @ now - alone * now], dim=-1))
            return known + self.get_buffer("change") * rest

        ends = states.new_tensor([0.0, 1.0])
        path: Tensor = solver()(per_frame, states, ends, method="rk4")
        return path[-1], {}

    def run(self, states: Tensor, mask: Tensor, graph: Tensor) -> tuple[Tensor, Memory]:
        return self.step(states, mask, graph, {})
