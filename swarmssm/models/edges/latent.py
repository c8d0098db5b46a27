"""The graph that a rule makes of the latent states."""

import torch

from swarmssm.errors import InputError
from swarmssm.graphs import Graph, GraphRule, graph_by_rule
from swarmssm.models.edges.observed import Edges
from swarmssm.models.markov import StepInputs

__all__ = ["LatentEdges"]


class LatentEdges(Edges):
    """The graph that a rule makes of the latent states themselves.

    Whether it is a matrix or a list of edges is decided by
    :func:`swarmssm.graphs.graph_by_rule`.

    Parameters
    ----------
    rule
        Radius, k nearest, visual field or complete, or its text such as ``"radius:2.5"``, in the
        unit of the states.

    Raises
    ------
    InputError
        If the text is no rule, or the rule is a visual field without body length.
    """

    def __init__(self, rule: GraphRule | str) -> None:
        super().__init__()
        rule = GraphRule.parse(rule) if isinstance(rule, str) else rule
        if rule.kind == "visual" and rule.body_length is None:
            raise InputError(
                "graph: the body_length of the visual graph is not known. Give it, for instance "
                "visual:body_length=1.2, in the unit of the positions."
            )
        self.rule = rule

    def forward(self, states: torch.Tensor, inputs: StepInputs) -> Graph:
        """Return the graph of the present individuals; no gradient flows through it.

        Who rests has no heading, and in a visual graph sees nobody.
        """
        states = states.detach()
        half = states.shape[-1] // 2
        positions, velocities = states[..., :half], states[..., half:]
        if inputs.present is not None:
            positions = positions.masked_fill(~inputs.present.unsqueeze(-1), torch.nan)
        return graph_by_rule(self.rule, positions, velocities)
