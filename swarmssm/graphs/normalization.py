"""Scaling of an adjacency for graph convolutions."""

import torch
from torch import Tensor

from swarmssm.errors import InputError

__all__ = ["normalized_adjacency"]


def normalized_adjacency(adjacency: Tensor, *, self_loops: bool = True) -> Tensor:
    r"""Return the symmetrically normalised adjacency of a graph convolution (3.8).

    .. math:: \tilde{D}^{-1/2} \tilde{A} \tilde{D}^{-1/2}, \quad
        \tilde{D}_{ii} = \sum_j \tilde{A}_{ij}, \quad \tilde{A} = A + I

    (3.8) speaks of undirected graphs. In a directed one the degree of i is the number of those
    that i listens to, itself included: the sum over row i. This is what ``gcn_norm`` of
    torch_geometric computes, where an edge from j to i carries a message from j to i.

    Parameters
    ----------
    adjacency
        Shape ``(..., individual, individual)``, ``[i, j]`` nonzero when i sees j; weights allowed.
    self_loops
        Whether to add the identity. A diagonal entry that is not 0 is left as it is.

    Returns
    -------
    Same shape, floating: ``h' = normalized_adjacency(A) @ h`` lets each individual gather from
    those it sees. A row of zeros stays so.

    Raises
    ------
    InputError
        If the last two dimensions are not equal.
    """
    if adjacency.ndim < 2 or adjacency.shape[-1] != adjacency.shape[-2]:
        raise InputError(
            "adjacency: the shape must be (..., individual, individual), and it is "
            f"{tuple(adjacency.shape)}."
        )
    if not adjacency.is_floating_point():
        adjacency = adjacency.to(torch.get_default_dtype())
    if self_loops:
        eye = torch.eye(adjacency.shape[-1], dtype=torch.bool, device=adjacency.device)
        adjacency = torch.where(eye & (adjacency == 0), 1.0, adjacency)
    degree = adjacency.sum(-1)
    connected = degree > 0
    scale = torch.where(connected, torch.where(connected, degree, 1.0).rsqrt(), 0.0)
    return scale[..., :, None] * adjacency * scale[..., None, :]
