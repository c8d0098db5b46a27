"""Where sightings that a model was fitted on fall in forecasts that have not learned from them.

On frames that trained it a model forecasts too well. The leave-one-out PIT takes from the
posterior of the parameters what each single sighting told of them, by importance weights, before
it asks where in its forecast the sighting falls.
"""

import warnings

import lazy_loader
import numpy as np
import xarray as xr

from swarmssm.analysis.diagnostics.checks.pit import RANKS, ranks_of
from swarmssm.analysis.diagnostics.sbc.ranks import calibration_of_ranks
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
    sightings: int = 500,
    part: str | None = "all",
    seed: int = 0,
) -> xr.Dataset:
    r"""Return the leave-one-out PIT of sightings, and whether they are uniform.

    .. math:: u = \sum_d w_d\, [x^{(d)}_{t,i} < x_{t,i}], \qquad
              w_d \propto 1 / p(x_{t,i} \mid x_{1:t-1}, \theta_d)

    with replicates :math:`x^{(d)}_{t,i}` of the sighting given the frames before, one a draw of the
    parameters, and Pareto-smoothed weights. A sighting is left out of the posterior of the
    parameters, not of the past of later frames, which are not looked at. Where a model's weights
    are points all weights are equal, and this is the PIT of one-step forecasts.

    Parameters
    ----------
    fit, tracks, part
        As in ``check``, but for all frames if absent: it is made for
        those that trained the model.
    draws
        Of the parameters.
    sightings
        How many at most, spread evenly.
    seed
        Of all draws.

    Returns
    -------
    As :func:`swarmssm.analysis.diagnostics.checks.one_step_pit`, with ``pit (sighting, space)`` and
    ``pareto_k (sighting)``: above 0.7 weights cannot be believed.

    Raises
    ------
    InputError
        If an argument is out of range, or nothing was foreseen.

    References
    ----------
    A. Gelman et al. (2013), Bayesian Data Analysis, 3rd ed., section 6.3; A. Vehtari, A. Gelman
    and J. Gabry (2017), Practical Bayesian model evaluation using leave-one-out cross-validation
    and WAIC, Stat. Comput. 27.
    """
    for name, value, least in (("draws", draws, 20), ("sightings", sightings, 1)):
        if value < least:
            raise InputError(f"{name}: it must be at least {least}, and it is {value}.")
    subject = subject_of(fit, tracks, part)
    foreseen = predict_one_step(subject.fit, subject.tracks, draws, seed, replicates=True)
    order = ("trial", "time", "individual", "space")
    truth = subject.tracks["position"].transpose(*order).to_numpy().astype(np.float64)
    density = np.broadcast_to(foreseen.density, (draws, *truth.shape[:-1]))
    there = np.isfinite(foreseen.replicates).all((0, -1)) & np.isfinite(truth).all(-1)
    there &= np.isfinite(density).all(0)
    # A first frame has no past: it is a draw of the law of first states, not a forecast.
    there &= np.cumsum(there, axis=1) > 1
    places = np.argwhere(there)
    if not len(places):
        raise InputError("tracks: no sighting was foreseen from frames before it.")
    chosen = np.linspace(0, len(places) - 1, min(sightings, len(places))).round()
    places = places[np.unique(chosen.astype(np.int64))]
    trial, row, individual = places.T
    pit, pareto = weighted_pit(
        truth[trial, row, individual],
        foreseen.replicates[:, trial, row, individual],
        density[:, trial, row, individual],
    )
    names = [str(name) for name in subject.tracks["space"].values]
    found = calibration_of_ranks(
        {name: ranks_of(pit[:, axis]) for axis, name in enumerate(names)}, RANKS
    )
    found["pit"] = (
        ("sighting", "space"),
        pit,
        {"units": "1", "long_name": "probability that the forecast gave to less than what came"},
    )
    found["pareto_k"] = (
        "sighting",
        pareto,
        {"units": "1", "long_name": "Pareto k of the weights"},
    )
    found = found.assign_coords(space=names)
    found.attrs |= {
        "model": fit.settings.model,
        "part": subject.part,
        "draws_of_forecast": draws,
        "how": foreseen.how,
    }
    return found


def weighted_pit(truth: Array, drawn: Array, log_density: Array) -> tuple[Array, Array]:
    """Return leave-one-out PITs, and the Pareto k of their weights.

    Parameters
    ----------
    truth
        ``(sighting, space)``.
    drawn
        ``(draw, sighting, space)``: replicates, one a draw of the parameters.
    log_density
        ``(draw, sighting)``: of the truth at the parameters of each draw.
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
