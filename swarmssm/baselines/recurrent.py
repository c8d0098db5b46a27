"""Networks part of whose work needs no memory, and is done for all frames at once."""

import torch
from torch import Tensor

from swarmssm.baselines.step_network import Memory, StepNetwork

__all__ = ["LookingNetwork"]


class LookingNetwork(StepNetwork):
    """A step network in two parts: what is seen in a frame, and what becomes of it.

    A subclass writes :meth:`look`, which knows no other frame, and :meth:`move`. Over a history
    the first is one call for all frames, and the loop over time is left with the second.
    """

    def look(self, states: Tensor, mask: Tensor, graph: Tensor) -> Memory:
        """Return what is seen in each frame: tensors ``(..., individual, feature)`` by name.

        Parameters
        ----------
        states, mask, graph
            As in :meth:`StepNetwork.step`, with any leading dimensions.
        """
        raise TypeError(f"{type(self).__name__} must define look(states, mask, graph)")

    def move(self, states: Tensor, seen: Memory, memory: Memory) -> tuple[Tensor, Memory]:
        """Return the expected next state and the memory, as :meth:`StepNetwork.step` does.

        Parameters
        ----------
        states
            Shape ``(batch, individual, state)``.
        seen
            What :meth:`look` returned of this frame.
        memory
            Of the step before.
        """
        raise TypeError(f"{type(self).__name__} must define move(states, seen, memory)")

    def step(
        self, states: Tensor, mask: Tensor, graph: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        """Look, and move."""
        return self.move(states, self.look(states, mask, graph), memory)

    def run(self, states: Tensor, mask: Tensor, graph: Tensor) -> tuple[Tensor, Memory]:
        """Look at all frames, then move over them one by one."""
        seen = {name: part.unbind(1) for name, part in self.look(states, mask, graph).items()}
        forget = None if bool(mask.all()) else (~mask)[..., None].unbind(1)
        memory = self.begin(states[:, 0])
        expected = []
        for frame, now in enumerate(states.unbind(1)):
            following, memory = self.move(
                now, {name: part[frame] for name, part in seen.items()}, memory
            )
            if forget is not None:
                memory = {k: part.masked_fill(forget[frame], 0.0) for k, part in memory.items()}
            expected.append(following)
        return torch.stack(expected, dim=1), memory
