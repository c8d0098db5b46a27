r"""Each individual's own linearisation, for swarms too large for a joint covariance.

The joint state of N individuals has a covariance of :math:`(4N)^2` numbers. The block approximation
keeps each individual's own :math:`4 \times 4`: it is moved with :math:`\partial z'_i / \partial
z_i`, the neighbours standing at their means,

.. math::
    P'_i = J_{ii} P_i J_{ii}^\top + Q_i, \qquad m'_i = f_i(m_1, \dots, m_N),

so that time and memory grow as the number of individuals and of edges. What is lost is that
neighbours are unsure, and that their errors go together. The error is of the order of
:math:`(dt\, k)^2` of a predicted variance, for gains k, against the variance of the noise.
"""

import torch
from torch import Tensor
from torch.func import jvp, vmap

from swarmssm.graphs import EdgeList, Graph
from swarmssm.models import StepInputs, Transition
from swarmssm.models.distributions.moments import covariance_of
from swarmssm.models.transitions.base import Linearization

__all__ = ["color_graph", "linearize_own"]

#: Up to so many individuals the full Jacobian is asked for, of which the diagonal is taken: many
#: transitions know it in closed form.
SMALL = 30


def linearize_own(
    transition: Transition, mean: Tensor, inputs: StepInputs, covariance: Tensor | None = None
) -> Linearization:
    r"""Linearise each individual in its own state.

    Individuals that do not see each other can be moved together: the graph is coloured so that
    neighbours differ, and one directional derivative serves all individuals of a colour.

    Parameters
    ----------
    transition
        One in which nobody but those whom i sees has a part in the next mean of i.
    mean
        ``(..., individual, state)``.
    inputs
        Without a graph, everybody may have a part in everybody.
    covariance
        As in :meth:`swarmssm.models.Transition.linearize`.

    Returns
    -------
    With the Jacobian ``(..., individual, state, state)`` of one's own state.
    """
    individuals, features = mean.shape[-2:]
    if individuals <= SMALL:
        line = transition.linearize(mean, inputs, covariance)
        own = line.jacobian.diagonal(dim1=-4, dim2=-2).movedim(-1, -3)
        return Linearization(line.mean, own, line.noise)
    here = transition(mean, inputs)
    colors = color_graph(inputs.adjacency, mean)
    number = int(colors.max()) + 1

    def next_mean(states: Tensor) -> Tensor:
        following: Tensor = transition(states, inputs).mean
        return following

    def along(direction: Tensor) -> Tensor:
        derivative: Tensor = jvp(next_mean, (mean,), (direction.expand_as(mean),))[1]
        return derivative

    eye = torch.eye(features, dtype=mean.dtype, device=mean.device)
    jacobian = mean.new_zeros(*mean.shape, features)
    for color in range(number):
        members = (colors == color).unsqueeze(-1)
        moved = vmap(along)(
            torch.where(members, eye.view(features, *[1] * (mean.dim() - 1), -1), 0.0)
        )
        jacobian = jacobian + torch.where(members.unsqueeze(-1), moved.movedim(0, -1), 0.0)
    return Linearization(here.mean, jacobian, covariance_of(here))


def color_graph(graph: Graph | None, values: Tensor) -> Tensor:
    """Give neighbours different colours, frame by frame.

    The rule of Jones and Plassmann (1993, SIAM J. Sci. Comput. 14:654): in each round all those
    choose who come before all their neighbours that have not chosen, and take the first colour
    that no neighbour has.

    Parameters
    ----------
    graph
        Two individuals are neighbours if one sees the other; ``None``: all are.
    values
        ``(..., individual, feature)``, which the frames of the graph broadcast against.

    Returns
    -------
    ``(..., individual)`` of whole numbers from 0 up.
    """
    *leading, individuals, _ = values.shape
    if graph is None:
        return torch.arange(individuals, device=values.device).expand(*leading, individuals)
    if not isinstance(graph, EdgeList):
        graph = EdgeList.from_dense(graph)
    nodes = graph.num_nodes
    apart = graph.receiver != graph.sender
    one = torch.cat([graph.receiver[apart], graph.sender[apart]])
    other = torch.cat([graph.sender[apart], graph.receiver[apart]])
    order = torch.randperm(nodes, generator=torch.Generator().manual_seed(0)).to(values.device)
    colors = torch.full((nodes,), -1, device=values.device)
    most = int(torch.bincount(one, minlength=1).max()) + 1 if len(one) else 1
    taken = torch.zeros(nodes, most, dtype=torch.bool, device=values.device)
    while bool((colors < 0).any()):
        waits = (colors[one] < 0) & (colors[other] < 0) & (order[one] < order[other])
        first = colors < 0
        first[one[waits]] = False
        chosen = torch.argmin(taken.to(torch.int8), dim=-1)
        colors = torch.where(first, chosen, colors)
        told = first[other]
        taken[one[told], colors[other[told]]] = True
    frames = colors.view(*graph.leading, individuals)
    return frames.expand(*leading, individuals)
