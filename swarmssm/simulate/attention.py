"""Weights of pairs: how much each responds to each other; leaders and isolated ones."""

import numpy as np
import numpy.typing as npt
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.simulate.recording import check_number, check_size

__all__ = ["Attention", "attention_given", "heeded", "planted_attention"]

#: A row an individual, a column a neighbor.
Attention = tuple[tuple[float, ...], ...]


def planted_attention(
    individuals: int,
    *,
    leader: int | None = None,
    strength: float = 3.0,
    heeds: float = 0.0,
    isolated: int | None = None,
) -> npt.NDArray[np.float64]:
    """Return weights by which one individual leads, or one neither moves others nor is moved.

    Parameters
    ----------
    individuals
        Their number.
    leader
        Place of one whom all others count with ``strength``, and who counts them with ``heeds``;
        ``None``: nobody.
    strength
        Weight of the leader; all other pairs have 1.
    heeds
        Weight with which the leader counts the others.
    isolated
        Place of one who counts nobody and whom nobody counts.

    Returns
    -------
    ``(individual, neighbor)``, for ``attention`` of
    :func:`~swarmssm.simulate.simulate_boids`. The diagonal, which has no meaning, is 1.

    Raises
    ------
    InputError
        If a place or weight is out of range, or the leader is the isolated one.
    """
    check_size("individuals", individuals, 1)
    check_number("strength", strength)
    check_number("heeds", heeds)
    for name, place in (("leader", leader), ("isolated", isolated)):
        if place is not None and check_size(name, place, 0) >= individuals:
            raise InputError(
                f"{name}: the places are from 0 to {individuals - 1}, and it is {place}."
            )
    if leader is not None and leader == isolated:
        raise InputError("isolated: it is the leader too; choose another.")
    weights = np.ones((individuals, individuals))
    if leader is not None:
        weights[:, leader] = strength
        weights[leader] = heeds
    if isolated is not None:
        weights[:, isolated] = weights[isolated] = 0.0
    np.fill_diagonal(weights, 1.0)
    return weights


def attention_given(values: npt.ArrayLike, individuals: int | None = None) -> Attention:
    """Return weights as the dynamics keep them.

    Parameters
    ----------
    values
        ``(individual, neighbor)``.
    individuals
        Their number; ``None``: as many as there are rows.

    Raises
    ------
    InputError
        If they are no square of finite numbers from 0 upwards, or of another size.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"attention: it must be a table of numbers (individual, neighbor) ({error})."
        ) from error
    number = len(array) if individuals is None and array.ndim else individuals
    if array.shape != (number, number):
        raise InputError(
            f"attention: it must have a row and a column for each individual, {number} of them, "
            f"and its shape is {array.shape}."
        )
    if not (np.isfinite(array).all() and (array >= 0).all()):
        raise InputError("attention: every weight must be a finite number from 0 upwards.")
    return tuple(tuple(row) for row in array.tolist())


def heeded(graph: Tensor, attention: Attention) -> tuple[Tensor, Tensor]:
    r"""Return the weighted graph, and what a weighted mean over it is to be multiplied with.

    The latter is :math:`\sum_j A_{ij} w_{ij} / \sum_j A_{ij}`, so that the product is
    :math:`\sum_j A_{ij} w_{ij} x_j / \sum_j A_{ij}`: a weight scales a neighbor's share.

    Parameters
    ----------
    graph
        ``(..., individual, individual)``.
    attention
        Of as many.

    Returns
    -------
    ``(..., individual, individual)`` and ``(..., individual, 1)``, float64.

    Raises
    ------
    InputError
        If it is of another number of individuals.
    """
    adjacency = graph.double()
    weights = adjacency.new_tensor(attention)
    if weights.shape != adjacency.shape[-2:]:
        raise InputError(
            f"attention: it is of {len(attention)} individuals, and there are {graph.shape[-1]}."
        )
    weighted = adjacency * weights
    number = adjacency.sum(-1, keepdim=True).clamp(min=1.0)
    return weighted, weighted.sum(-1, keepdim=True) / number
