"""The logarithmic score of a Gaussian forecast."""

import math

import numpy as np
import numpy.typing as npt

__all__ = ["gaussian_log_score", "moments_of_draws"]

Array = npt.NDArray[np.float64]


def gaussian_log_score(truth: Array, mean: Array, covariance: Array) -> Array:
    r"""Return the log-density of the truth under a normal forecast, per coordinate.

    .. math:: \tfrac1d \log N(x; \mu, \Sigma)

    Parameters
    ----------
    truth, mean
        ``(..., space)``; NaN where unknown.
    covariance
        ``(..., space, space)``, broadcast against them.

    Returns
    -------
    ``(...)``, in nats per coordinate of the truth's unit (higher is better); NaN where truth, mean or
    covariance is. A covariance that is not positive definite gives minus infinity, unless the truth
    is NaN.

    References
    ----------
    T. Gneiting and A. E. Raftery (2007), Strictly proper scoring rules, prediction, and
    estimation, JASA 102.
    """
    error = truth - mean
    space = error.shape[-1]
    matrix = np.broadcast_to(covariance, (*error.shape, space))
    known = np.isfinite(error).all(-1) & np.isfinite(matrix).all((-1, -2))
    out = np.full(error.shape[:-1], np.nan)
    sign, logdet = np.linalg.slogdet(matrix[known])
    proper = (sign > 0) & np.isfinite(logdet)
    scores = np.full(len(logdet), -np.inf)
    inner, chosen = error[known][proper], matrix[known][proper]
    solved = np.linalg.solve(chosen, inner[..., None])[..., 0]
    squared = (inner * solved).sum(-1)
    scores[proper] = -0.5 * (squared + logdet[proper] + space * math.log(2.0 * math.pi)) / space
    out[known] = scores
    return out


def moments_of_draws(draws: Array) -> tuple[Array, Array]:
    """Return mean and covariance of draws.

    Parameters
    ----------
    draws
        ``(draw, ..., space)``.

    Returns
    -------
    ``(..., space)`` and ``(..., space, space)``, the latter with the divisor ``draws - 1``.

    Raises
    ------
    ValueError
        If there are not more draws than coordinates: the covariance would be singular.
    """
    count, space = draws.shape[0], draws.shape[-1]
    if count <= space:
        raise ValueError(f"{count} draws have no covariance in {space} coordinates")
    mean = draws.mean(0)
    apart = draws - mean
    covariance = np.einsum("d...i,d...j->...ij", apart, apart) / (count - 1)
    return mean, covariance
