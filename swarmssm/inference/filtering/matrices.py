"""Covariance matrices of a swarm: blocks of individuals, and factors of them."""

import torch
from torch import Tensor

from swarmssm.errors import WorkError

__all__ = ["block_diagonal", "cholesky", "own_blocks", "root", "symmetrize"]


def own_blocks(covariance: Tensor, individuals: int) -> Tensor:
    """Return each individual's own covariance ``(..., individual, state, state)``.

    Parameters
    ----------
    covariance
        Joint, ``(..., joint, joint)``.
    individuals
        Their number.
    """
    features = covariance.shape[-1] // individuals
    shape = covariance.shape[:-2]
    split = covariance.reshape(*shape, individuals, features, individuals, features)
    own: Tensor = split.diagonal(dim1=-4, dim2=-2)
    return own.movedim(-1, -3)


def block_diagonal(blocks: Tensor) -> Tensor:
    """Put matrices ``(..., individual, a, b)`` on the diagonal of a joint one."""
    individuals, rows, columns = blocks.shape[-3:]
    wide = torch.diag_embed(blocks.movedim(-3, -1)).movedim(-2, -4).movedim(-1, -2)
    return wide.reshape(*blocks.shape[:-3], individuals * rows, individuals * columns)


def symmetrize(matrix: Tensor) -> Tensor:
    """Return the symmetric part."""
    return 0.5 * (matrix + matrix.mT)


def cholesky(matrix: Tensor, what: str) -> Tensor:
    """Return the Cholesky factor of positive definite matrices.

    Raises
    ------
    WorkError
        If one of them is not, ``what`` in its sentence.
    """
    try:
        factor: Tensor = torch.linalg.cholesky(matrix)
    except torch.linalg.LinAlgError as error:  # type: ignore[attr-defined]
        raise WorkError(
            f"The covariance {what} is not positive definite. Parameters are out of bounds, or "
            "the model needs float64."
        ) from error
    return factor


def root(matrix: Tensor) -> Tensor:
    """Return a lower triangular L with ``L @ L.mT`` equal to positive semidefinite matrices.

    Directions without variance have a column of 0.
    """
    # A feature of nobody has no variance, and is given some for as long as the factor is sought.
    dead = matrix.diagonal(dim1=-2, dim2=-1) <= 0
    factor: Tensor
    factor, trouble = torch.linalg.cholesky_ex(matrix + torch.diag_embed(dead.to(matrix.dtype)))
    if not bool(trouble.any()):
        return torch.where(dead.unsqueeze(-1), 0.0, factor)
    size = matrix.shape[-1]
    scale = matrix.diagonal(dim1=-2, dim2=-1)
    limit = size * torch.finfo(matrix.dtype).eps * scale
    rows = torch.arange(size, device=matrix.device)
    left, columns = matrix, []
    for j in range(size):
        pivot = left[..., j, j]
        holds = pivot > limit[..., j]
        column = left[..., :, j] / torch.where(holds, pivot, 1.0).sqrt().unsqueeze(-1)
        column = torch.where(holds.unsqueeze(-1) & (rows >= j), column, 0.0)
        left = left - column.unsqueeze(-1) * column.unsqueeze(-2)
        columns.append(column)
    return torch.stack(columns, -1)
