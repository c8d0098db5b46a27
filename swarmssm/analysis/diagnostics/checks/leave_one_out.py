"""Leave-one-out calibration of forecasts, for frames that trained the model.

On its training frames a model forecasts too well. The leave-one-out PIT removes the contribution of
each observation to the posterior of the parameters by importance weights before it computes the
PIT of that observation.
"""

import warnings

import lazy_loader
import numpy as np
import xarray as xr

from swarmssm.analysis.diagnostics.checks.pit import ForecastCalibration, calibration_of_pit
from swarmssm.analysis.posterior.foresight import predict_one_step
from swarmssm.analysis.posterior.subject import subject_of
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["loo_pit", "weighted_pit"]

#: Imported when it is first used, since that takes seconds.
arviz = lazy_loader.load("arviz")


def loo_pit(
    fit: Fit,
    tracks: xr.Dataset,
    *,
    draws: int = 199,
    observations: int = 500,
    part: str | None = "all",
    seed: int = 0,
) -> ForecastCalibration:
    r"""Return the leave-one-out PIT of observations, and whether they are uniform.

    .. math:: u = \sum_d w_d\, [x^{(d)}_{t,i} < x_{t,i}], \qquad
              w_d \propto 1 / p(x_{t,i} \mid x_{1:t-1}, \theta_d)

    with one replicate :math:`x^{(d)}_{t,i}` of the observation given the frames before for each
    draw of the parameters, and Pareto-smoothed weights. An observation is left out of the posterior
    of the parameters; later frames are not used. Where parameters are point estimates all weights
    are equal, and this is the PIT of one-step forecasts.

    Parameters
    ----------
    fit, tracks, part
        As in ``check``, but all frames if absent.
    draws
        Draws of the parameters.
    observations
        Largest number of observations, spread evenly.
    seed
        Seed of all draws.

    Returns
    -------
    As :func:`swarmssm.analysis.diagnostics.checks.one_step_pit`, with ``pit (observation, space)``
    and ``pareto_k (observation)``: above 0.7 the weights are unreliable.

    Raises
    ------
    InputError
        If an argument is out of range, or nothing was forecast.

    References
    ----------
    A. Gelman et al. (2013), Bayesian Data Analysis, 3rd ed., section 6.3; A. Vehtari, A. Gelman
    and J. Gabry (2017), Practical Bayesian model evaluation using leave-one-out cross-validation
    and WAIC, Stat. Comput. 27.
    """
    for name, value, least in (("draws", draws, 20), ("observations", observations, 1)):
        if value < least:
            raise InputError(f"{name}: it must be at least {least}, and it is {value}.")
    subject = subject_of(fit, tracks, part)
    predicted = predict_one_step(subject.fit, subject.tracks, draws, seed, replicates=True)
    order = ("trial", "time", "individual", "space")
    truth = subject.tracks["position"].transpose(*order).to_numpy().astype(np.float64)
    density = np.broadcast_to(predicted.density, (draws, *truth.shape[:-1]))
    there = np.isfinite(predicted.replicates).all((0, -1)) & np.isfinite(truth).all(-1)
    there &= np.isfinite(density).all(0)
    # A first frame has no past: it is a draw of the initial state, not a forecast.
    there &= np.cumsum(there, axis=1) > 1
    places = np.argwhere(there)
    if not len(places):
        raise InputError("tracks: no observation has a forecast from frames before it.")
    chosen = np.linspace(0, len(places) - 1, min(observations, len(places))).round()
    places = places[np.unique(chosen.astype(np.int64))]
    trial, row, individual = places.T
    pit, pareto = weighted_pit(
        truth[trial, row, individual],
        predicted.replicates[:, trial, row, individual],
        density[:, trial, row, individual],
    )
    names = [str(name) for name in subject.tracks["space"].values]
    found = calibration_of_pit(pit, names)
    found["pit"] = (
        ("observation", "space"),
        pit,
        {"units": "1", "long_name": "probability of smaller values in the forecast"},
    )
    found["pareto_k"] = (
        "observation",
        pareto,
        {"units": "1", "long_name": "Pareto k of the weights"},
    )
    found = found.assign_coords(space=names)
    found.attrs |= {
        "model": fit.settings.model,
        "part": subject.part,
        "draws_of_forecast": draws,
        "how": predicted.how,
    }
    return ForecastCalibration(found)


def weighted_pit(truth: Array, drawn: Array, log_density: Array) -> tuple[Array, Array]:
    """Return leave-one-out PITs, and the Pareto k of their weights.

    Parameters
    ----------
    truth
        ``(observation, space)``.
    drawn
        ``(draw, observation, space)``: replicates, one a draw of the parameters.
    log_density
        ``(draw, observation)``: of the truth at the parameters of each draw.
    """
    draws, number = log_density.shape
    pit, pareto = np.empty_like(truth), np.full(number, np.nan)
    for index in range(number):
        ratios = -log_density[:, index]
        weights = np.full(draws, 1.0 / draws)
        if np.ptp(ratios) > 0:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                smoothed, shape = arviz.psislw(ratios - ratios.max())
            weights, pareto[index] = np.exp(np.asarray(smoothed, dtype=np.float64)), float(shape)
        below = (weights[:, None] * (drawn[:, index] < truth[index])).sum(0)
        # Half of the gap between two draws to either side.
        pit[index] = (draws * below + 0.5) / (draws + 1.0)
    return pit, pareto
