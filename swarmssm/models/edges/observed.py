"""Where the graph of a step comes from."""

from dataclasses import replace

import torch
from torch import nn

from swarmssm.graphs import Graph
from swarmssm.models.markov import StepInputs

__all__ = ["Edges", "ObservedEdges"]


class Edges(nn.Module):
    """From latent states and what was observed to the graph of each step."""

    def forward(self, states: torch.Tensor, inputs: StepInputs) -> Graph | None:
        """Return the graph at the beginning of each step.

        Parameters
        ----------
        states
            ``(..., individual, state)``.
        inputs
            See :class:`swarmssm.models.StepInputs`.
        """
        raise TypeError(f"{type(self).__name__} must define forward(states, inputs)")

    def complete(self, states: torch.Tensor, inputs: StepInputs) -> StepInputs:
        """Return the inputs with this graph in them."""
        return replace(inputs, adjacency=self(states, inputs))


class ObservedEdges(Edges):
    """The graph that was given with the data, or that a rule made of the observed positions."""

    def forward(self, states: torch.Tensor, inputs: StepInputs) -> Graph | None:
        """Return the observed graph."""
        return inputs.adjacency
