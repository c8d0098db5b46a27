"""Networks that go from one state to the next: what the neural baselines ask of them."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from swarmssm.tracks.scaling import Scaler

__all__ = ["Memory", "Setting", "StepNetwork"]

#: What a network carries from step to step: tensors ``(batch, individual, ...)`` by name.
Memory = dict[str, Tensor]


@dataclass(frozen=True)
class Setting:
    """What a network is given before it learns.

    Attributes
    ----------
    features
        Number of features of a state.
    change
        Root mean square of what each feature of a scaled state changes by in one frame,
        ``(state,)``: the unit in which a residual network writes its output.
    scaler
        Between the tracks' units and those of the network.
    fps
        Frames per second.
    """

    features: int
    change: Tensor
    scaler: Scaler
    fps: float


class StepNetwork(nn.Module):
    """A network that goes from one scaled state to the next and remembers.

    A subclass writes :meth:`step`, and :meth:`begin` if it has a memory. All states are scaled;
    ``graph[b, i, j] = 1`` means that i sees j. Where ``mask`` is false the state is 0, and nobody
    is to gather anything from there: the graph has no edge to it.
    """

    def begin(self, states: Tensor) -> Memory:
        """Return the memory before the first frame.

        Parameters
        ----------
        states
            States ``(batch, individual, state)`` of the first frame; only shape and type matter.
        """
        return {}

    def step(
        self, states: Tensor, mask: Tensor, graph: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        """Return the expected next state and the memory after this one.

        Parameters
        ----------
        states
            Shape ``(batch, individual, state)``.
        mask
            Who is there, ``(batch, individual)``.
        graph
            Shape ``(batch, individual, individual)``, 0 and 1.
        memory
            Of the step before, or from :meth:`begin`.
        """
        raise TypeError(f"{type(self).__name__} must define step(states, mask, graph, memory)")

    def run(self, states: Tensor, mask: Tensor, graph: Tensor) -> tuple[Tensor, Memory]:
        """Go over known frames.

        Parameters
        ----------
        states, mask, graph
            As in :meth:`step`, with a dimension of time after that of the batch.

        Returns
        -------
        The expected state after each frame, ``(batch, time, individual, state)``, each from frames
        up to this one alone; and the memory after the last. Who is not there forgets.
        """
        empty = memory = self.begin(states[:, 0])
        expected = []
        for now, there, edges in zip(
            states.unbind(1), mask.unbind(1), graph.unbind(1), strict=True
        ):
            following, memory = self.step(now, there, edges, memory)
            memory = {
                name: torch.where(_like(there, part), part, empty[name])
                for name, part in memory.items()
            }
            expected.append(following)
        return torch.stack(expected, dim=1), memory

    def remember(self, states: Tensor, mask: Tensor, graph: Tensor) -> tuple[Tensor, Memory]:
        """Return the expected state after the last frame, and the memory: the end of :meth:`run`.

        A network that makes something of the history as a whole overrides this.
        """
        expected, memory = self.run(states, mask, graph)
        return expected[:, -1], memory


def _like(mask: Tensor, part: Tensor) -> Tensor:
    """Return the mask ``(batch, individual)`` with as many dimensions as the part."""
    return mask.reshape(*mask.shape, *(1,) * (part.dim() - mask.dim()))
