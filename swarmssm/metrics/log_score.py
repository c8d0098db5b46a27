"""The logarithmic score of a Gaussian forecast."""

import math

import numpy as np
import numpy.typing as npt
import scipy

__all__ = ["gaussian_log_score", "mixture_log_score", "moments_of_draws"]

Array = npt.NDArray[np.float64]


#: What is added to each axis of a covariance, as a part of the sum of all.
ROUNDING = 1e-9


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
    ``(...)``, in nats per coordinate of the truth's unit (higher is better); NaN where truth, mean
    or covariance is. A covariance that is not positive definite gives minus infinity, unless the
    truth is NaN.

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


def mixture_log_score(
    truth: Array, location: Array, variance: Array, degrees: float = math.inf
) -> Array:
    r"""Return the log-density of the truth under what sampled futures expect of the last step.

    .. math:: \frac1d \log \frac1K \sum_k t_\nu(x;\; m_k,\; S_k + b^2 C), \qquad
              b = K^{-1/(d + 4)}

    Each of K sampled futures says where its next position is expected, and how surely; C is the
    covariance of the places expected. With many draws b goes to 0, and what is left is the
    forecast's own density (a kernel estimate that knows the last kernel; Silverman's rule).

    Parameters
    ----------
    truth
        ``(..., space)``; NaN where unknown.
    location, variance
        ``(draw, ..., space)``.
    degrees
        Degrees of freedom of the last step's Student's t; infinite, it is normal. ``variance`` is
        the variance either way.

    Returns
    -------
    ``(...)``, in nats per coordinate; NaN where anything is unknown, minus infinity where a future
    is infinite.

    References
    ----------
    B. W. Silverman (1986), Density Estimation for Statistics and Data Analysis.
    """
    count, space = location.shape[0], location.shape[-1]
    broken = np.isinf(location).any(axis=(0, -1))
    location = np.where(np.isinf(location), 0.0, location)
    spread = moments_of_draws(location)[1] * count ** (-2.0 / (space + 4))
    shrink = 1.0 if math.isinf(degrees) else (degrees - 2.0) / degrees
    # A future that leaves all bounds stretches C along one line, and rounding makes it singular.
    spread = spread + ROUNDING * np.trace(spread, axis1=-2, axis2=-1)[..., None, None] * np.eye(
        space
    )
    matrix = variance[..., None] * shrink * np.eye(space) + spread
    error = truth - location
    known = np.isfinite(error).all((0, -1)) & np.isfinite(matrix).all((0, -1, -2))
    out = np.full(truth.shape[:-1], np.nan)
    error, matrix = error[:, known], matrix[:, known]
    squared = (error * np.linalg.solve(matrix, error[..., None])[..., 0]).sum(-1)
    logdet = np.linalg.slogdet(matrix)[1]
    if math.isinf(degrees):
        each = -0.5 * (squared + logdet + space * math.log(2.0 * math.pi))
    else:
        half = 0.5 * (degrees + space)
        constant = math.lgamma(half) - math.lgamma(0.5 * degrees)
        constant -= 0.5 * space * math.log(degrees * math.pi)
        each = constant - 0.5 * logdet - half * np.log1p(squared / degrees)
    out[known] = (scipy.special.logsumexp(each, axis=0) - math.log(count)) / space
    out[broken & ~np.isnan(truth).any(-1)] = -np.inf
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
