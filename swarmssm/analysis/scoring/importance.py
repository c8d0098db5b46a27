"""Leaving out by importance weights: the posterior without a window, from draws of all of it."""

import math
import warnings
from dataclasses import dataclass

import lazy_loader
import numpy as np
import numpy.typing as npt
import scipy

from swarmssm.tracks import Array

__all__ = ["LeftOut", "good_k", "psis_lfo", "psis_loo"]

#: Imported when it is first used, since that takes seconds.
arviz = lazy_loader.load("arviz")


@dataclass(frozen=True)
class LeftOut:
    """Log predictive densities of windows that were left out.

    Attributes
    ----------
    elpd
        ``(window,)``, in nats.
    pareto_k
        ``(window,)``: shape of the tail of the weights; NaN where there were no weights.
    learned
        ``(window,)`` of bool: the weights of this window could be believed.
    in_sample
        ``(window,)``: the same with nothing left out.
    """

    elpd: Array
    pareto_k: Array
    learned: npt.NDArray[np.bool_]
    in_sample: Array


def good_k(draws: int) -> float:
    r"""Return the greatest Pareto k with which weights of so many draws can be believed.

    :math:`\min(1 - 1 / \log_{10} S,\; 0.7)`, Vehtari et al. (2024).
    """
    return min(1.0 - 1.0 / math.log10(draws), 0.7)


def psis_loo(log_likelihood: Array) -> LeftOut:
    r"""Return each window's density by draws that are weighted as if it had not been seen.

    .. math:: \log \frac{\sum_s w_s\, p(x_w \mid \theta_s)}{\sum_s w_s}, \qquad
              w_s \propto 1 / p(x_w \mid \theta_s)

    with Pareto-smoothed weights.

    Parameters
    ----------
    log_likelihood
        ``(draw, window)``: joint log-density of each window at draws of the posterior of all.

    References
    ----------
    A. Vehtari, A. Gelman and J. Gabry (2017), Practical Bayesian model evaluation using
    leave-one-out cross-validation and WAIC, Stat. Comput. 27.
    A. Vehtari, D. Simpson, A. Gelman, Y. Yao and J. Gabry (2024), Pareto smoothed importance
    sampling, JMLR 25.
    """
    draws, windows = log_likelihood.shape
    elpd, pareto = np.full(windows, np.nan), np.full(windows, np.nan)
    for window in range(windows):
        own = log_likelihood[:, window]
        weights, pareto[window] = _smoothed(-own)
        elpd[window] = scipy.special.logsumexp(weights + own)
    whole = scipy.special.logsumexp(log_likelihood, axis=0) - math.log(draws)
    return LeftOut(elpd, pareto, ~(pareto > good_k(draws)), whole)


def psis_lfo(log_likelihood: Array) -> LeftOut:
    r"""Return each window's density by draws that are weighted as if all before had been learned.

    .. math:: \log \frac{\sum_s w_s\, p(x_w \mid x_{<w}, \theta_s)}{\sum_s w_s}, \qquad
              w_s \propto \prod_{v < w} p(x_v \mid x_{<v}, \theta_s)

    with draws of the posterior of what comes before all windows, and Pareto-smoothed weights.
    Where these can no longer be believed, the model would have to be fitted again; instead, the
    last weights that could be are kept: it then no longer learns, but nothing of the future is
    used.

    Parameters
    ----------
    log_likelihood
        ``(draw, window)``, windows in the order of time.

    References
    ----------
    P.-C. Bürkner, J. Gabry and A. Vehtari (2020), Approximate leave-future-out cross-validation for
    Bayesian time series models, J. Stat. Comput. Simul. 90.
    """
    draws, windows = log_likelihood.shape
    elpd, pareto = np.full(windows, np.nan), np.full(windows, np.nan)
    learned = np.ones(windows, dtype=bool)
    before = np.zeros(draws)
    weights = np.full(draws, -math.log(draws))
    stopped = False
    for window in range(windows):
        if window and np.ptp(before) > 0:
            smoothed, pareto[window] = _smoothed(before)
            stopped = stopped or bool(pareto[window] > good_k(draws))
            if stopped:
                learned[window] = False
            else:
                weights = smoothed
        elpd[window] = scipy.special.logsumexp(weights + log_likelihood[:, window])
        before = before + log_likelihood[:, window]
    whole = scipy.special.logsumexp(log_likelihood, axis=0) - math.log(draws)
    return LeftOut(elpd, pareto, learned, whole)


def _smoothed(log_ratios: Array) -> tuple[Array, float]:
    """Return normalised log-weights and the Pareto k of their tail."""
    if not np.isfinite(log_ratios).all():
        # A draw that gives the observations no density at all would have all the weight without it.
        return np.full(len(log_ratios), -math.log(len(log_ratios))), math.inf
    if np.ptp(log_ratios) == 0.0:
        return np.full(len(log_ratios), -math.log(len(log_ratios))), math.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        weights, shape = arviz.psislw(log_ratios - log_ratios.max())
    return np.asarray(weights, dtype=np.float64), float(shape)
