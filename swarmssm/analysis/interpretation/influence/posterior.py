r"""Who moves whom: how the acceleration of one individual hangs on the state of another.

Along draws of the posterior path, the derivative :math:`\partial a_i / \partial z_j` of the
acceleration that the model expects of i by the state of j has a part by position and one by
velocity. With a typical distance L and a typical speed U both are accelerations, and

.. math:: I_{ij} = \sqrt{L^2 \lVert \partial a_i / \partial p_j \rVert^2
                         + U^2 \lVert \partial a_i / \partial v_j \rVert^2}

(Frobenius norms) says by how much i would accelerate otherwise if j were displaced by about L and
went by about U otherwise. A separation that grows without bound at contact makes its mean over time
hang on the closest encounters, and on how well these are known: intervals are then wide.

A law that is the same for all only knows where an individual is: it says who, by its place, moves
the others most. Whether an individual *counts* more than another in the same place is a
question to a model with weights of individuals, the ``influence`` and ``responsiveness`` of
:class:`~swarmssm.models.transitions.KernelTransition`; their posterior stands beside the above.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
import xarray as xr

from swarmssm.analysis.interpretation.forces.frames import QUANTILES, labels_of, unit_of
from swarmssm.analysis.interpretation.influence.jacobians import (
    acceleration_jacobian,
    has_closed_form,
)
from swarmssm.analysis.interpretation.influence.ranks import rank_probabilities
from swarmssm.analysis.interpretation.influence.weights import (
    label_weights,
    pair_weights,
)
from swarmssm.analysis.posterior.accelerations import (
    AccelerationModel,
    PosteriorPaths,
    acceleration_model,
    posterior_paths,
)
from swarmssm.analysis.posterior.intervals import known_mean
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["influence"]

#: Steps at which derivatives are taken unless the caller says how many.
STEPS = 500
#: Entries of the intervals over time that may be kept.
KEPT = 2_000_000
#: Derivatives that are held at once, for all draws together.
ENTRIES_AT_ONCE = 4_000_000
#: Pairs of individuals that are differentiated at once where a whole network hangs on each.
PAIRS_AT_ONCE = 20_000


def influence(
    fit: Fit,
    tracks: xr.Dataset,
    draws: int = 20,
    seed: int | torch.Generator = 0,
    *,
    stride: int | None = None,
    length: float | None = None,
    speed: float | None = None,
    paths: PosteriorPaths | None = None,
) -> xr.Dataset:
    """Say who moves whom, at each step and on average, with intervals over the posterior.

    Parameters
    ----------
    fit
        A fit.
    tracks
        Those the model was fitted on, or others.
    draws
        Draws of paths, each with its own parameters.
    seed
        Seed or generator.
    stride
        Take every n-th frame; absent: so that at most 500 are taken, fewer of large groups.
    length
        L, in the tracks' unit; absent: the median distance to the nearest neighbour of the training
        tracks.
    speed
        U; absent: the root mean square speed along the posterior path.
    paths
        Draws of paths that are there already, in place of new ones.

    Returns
    -------
    Dataset in which ``individual`` is moved by ``neighbor``:

    ``influence (quantile, individual, neighbor)``
        Mean over steps of the norm above, in length unit per second squared: median and ends of the
        central 90 % over draws. Diagonals are NaN, and so are pairs never seen together.
    ``position_part``, ``velocity_part (quantile, individual, neighbor)``
        The same of the two parts alone.
    ``step_influence (quantile, trial, time, individual, neighbor)``
        At each step, single precision; NaN where one of the two is absent.
    ``trial_influence (trial, individual, neighbor)``
        Mean over the steps of each trial, and over draws.
    ``outgoing``, ``incoming``, ``net (draw, individual)``
        How much an individual moves another, the mean over the others; how much it is moved by
        another; and the difference.
    ``leadership (quantile, individual)``
        Quantiles of ``outgoing``.
    ``rank_probability (individual, rank)``
        In which share of the draws an individual has this rank by ``outgoing``, 1 for the most
        influential; ties are shared out.
    ``weight (sample, individual)``
        Only if the model has an ``influence`` of individuals or pairs: how much an individual
        counts for others, relative to the mean of all, in 4000 draws of the parameters (of pairs,
        the mean over who is moved).
    ``responsiveness (sample, individual)``
        Likewise how much an individual is moved, if the model has one or weights of pairs.
    ``pair_weight (quantile, individual, neighbor)``
        If the model has either: with what weight individual counts neighbor, relative to the mean
        over pairs.
    ``weight_rank_probability (individual, rank)``
        Of ``weight``.

    ``attrs`` hold L (``position_scale``), U (``velocity_scale``), ``stride``, ``closed_form`` and
    ``certain``: 1 for a model that takes states as known and has no uncertain parameters, whose
    intervals have no width.

    Raises
    ------
    InputError
        If ``draws``, ``stride``, ``length`` or ``speed`` is not positive, the tracks do not fit the
        model, or it has no law of motion.
    """
    for name, value in (("stride", stride), ("length", length), ("speed", speed)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise InputError(f"{name}: it must be a positive number, not {value!r}.")
    motion = acceleration_model(fit)
    paths = posterior_paths(fit, tracks, draws, seed) if paths is None else paths
    draws = paths.draws
    trials, times, individuals = paths.present.shape
    if individuals < 2:
        raise InputError("tracks: there is one individual, and nobody for it to move.")
    if stride is None:
        wanted = min(STEPS, KEPT // (len(QUANTILES) * individuals**2))
        stride = max(1, math.ceil(trials * times / max(wanted, 1)))
    length = fit.scales.spacing if length is None else length
    speed = _typical_speed(paths) if speed is None else speed
    closed = has_closed_form(fit)
    certain = _is_certain(paths)
    found = _along(fit, motion, paths, stride, length, speed, certain, closed)

    unit = unit_of(paths.tracks, "/s^2")
    pairs = ("individual", "neighbor")
    each = labels_of(paths.tracks, "trial", "time", "individual")
    names = each["individual"]
    outgoing, incoming = known_mean(found.mean, 1), known_mean(found.mean, 2)
    over_draws = ("draw", "individual")
    data: dict[str, Any] = {
        "influence": (("quantile", *pairs), _quantiles(found.mean)),
        "position_part": (("quantile", *pairs), _quantiles(found.position)),
        "velocity_part": (("quantile", *pairs), _quantiles(found.velocity)),
        "step_influence": (("quantile", "trial", "time", *pairs), found.steps),
        "trial_influence": (("trial", *pairs), found.trials),
        "outgoing": (over_draws, outgoing),
        "incoming": (over_draws, incoming),
        "net": (over_draws, outgoing - incoming),
        "leadership": (("quantile", "individual"), _quantiles(outgoing)),
    }
    result = xr.Dataset(
        data,
        {
            "quantile": list(QUANTILES),
            "draw": np.arange(draws),
            "trial": each["trial"],
            "time": each["time"][::stride],
            "individual": names,
            "neighbor": names,
            "rank": np.arange(1, individuals + 1),
        },
    )
    for name, meaning in MEANINGS.items():
        result[name].attrs = {"units": unit, "long_name": meaning}
    result["rank_probability"] = (
        ("individual", "rank"),
        rank_probabilities(outgoing),
        {"units": "1", "long_name": "probability of the rank by outgoing influence"},
    )
    result = result.merge(label_weights(*pair_weights(fit, seed=seed), names))
    result.attrs = {
        "position_scale": float(length),
        "velocity_scale": float(speed),
        "unit": unit_of(paths.tracks),
        "stride": int(stride),
        "closed_form": int(closed),
        "certain": int(certain),
        "model": fit.settings.model,
    }
    return result


MEANINGS = {
    "influence": "change of individual's acceleration with neighbor's state",
    "position_part": "change of individual's acceleration with neighbor's position",
    "velocity_part": "change of individual's acceleration with neighbor's velocity",
    "step_influence": "change of individual's acceleration with neighbor's state, at each step",
    "trial_influence": "change of individual's acceleration with neighbor's state, in each trial",
    "outgoing": "mean influence on another",
    "incoming": "mean influence of another",
    "net": "mean influence on another minus that of another",
    "leadership": "mean influence on another",
}


class _Influences(NamedTuple):
    """Means over steps, ``(draw, individual, neighbor)``, and the course over time.

    ``steps`` is ``(quantile, trial, time, individual, neighbor)`` and ``trials`` the mean of each
    trial over steps and draws.
    """

    mean: Array
    position: Array
    velocity: Array
    steps: npt.NDArray[np.float32]
    trials: Array


def _along(
    fit: Fit,
    motion: AccelerationModel,
    paths: PosteriorPaths,
    stride: int,
    length: float,
    speed: float,
    certain: bool,
    closed: bool,
) -> _Influences:
    """Walk along the paths, some steps of all draws at a time."""
    states = paths.states[:, :, ::stride]
    draws, trials, steps, individuals, features = states.shape
    flat = states.flatten(1, 2)
    adjacency = paths.adjacency[:, ::stride].flatten(0, 1)
    present = paths.present[:, ::stride].flatten(0, 1)
    both = present.unsqueeze(-1) & present.unsqueeze(-2)
    both = both & ~torch.eye(individuals, dtype=torch.bool)
    # Where nothing is uncertain one draw says it all.
    needed = 1 if certain else draws
    pairs = individuals**2
    at_once = max(1, ENTRIES_AT_ONCE // (pairs * features**2))
    if not closed:
        at_once = min(at_once, max(1, PAIRS_AT_ONCE // pairs))
    sums = torch.zeros(3, needed, trials, individuals, individuals, dtype=torch.float64)
    course = np.empty((len(QUANTILES), trials * steps, individuals, individuals), np.float32)
    trial_of = torch.arange(trials).repeat_interleave(steps)
    for first in range(0, trials * steps, at_once):
        rows = torch.arange(first, min(first + at_once, trials * steps))
        norms = torch.empty(3, needed, len(rows), individuals, individuals, dtype=torch.float64)
        for draw in range(needed):
            jacobian = acceleration_jacobian(
                fit,
                motion,
                flat[draw, rows],
                adjacency[rows],
                present[rows],
                paths.parameters[draw],
                closed_form=closed,
            )
            squared = jacobian.square().sum(2)
            norms[1, draw] = length * squared[..., : motion.space].sum(-1).sqrt()
            norms[2, draw] = speed * squared[..., motion.space :].sum(-1).sqrt()
        norms[0] = (norms[1].square() + norms[2].square()).sqrt()
        norms = norms * both[rows]
        sums.index_add_(2, trial_of[rows], norms)
        middle = np.quantile(norms[0].numpy(), QUANTILES, axis=0)
        middle[:, ~both[rows].numpy()] = np.nan
        course[:, rows.numpy()] = middle
    counts = torch.zeros(trials, individuals, individuals, dtype=torch.float64)
    counts.index_add_(0, trial_of, both.double())
    means = (sums.sum(2) / _or_nan(counts.sum(0))).expand(3, draws, *counts.shape[1:]).numpy()
    by_trial = (sums[0].mean(0) / _or_nan(counts)).numpy()
    shape = (len(QUANTILES), trials, steps, individuals, individuals)
    return _Influences(means[0], means[1], means[2], course.reshape(shape), by_trial)


def _or_nan(counts: torch.Tensor) -> torch.Tensor:
    """Return counts with NaN for 0."""
    return torch.where(counts > 0, counts, torch.nan)


def _is_certain(paths: PosteriorPaths) -> bool:
    """Return whether all draws are the same."""
    if any(paths.parameters):
        return False
    return bool((paths.states == paths.states[:1]).all())


def _typical_speed(paths: PosteriorPaths) -> float:
    """Return the root mean square of speed over all draws and frames."""
    velocities = paths.states[..., paths.states.shape[-1] // 2 :]
    squared = velocities.square().sum(-1)[:, paths.present]
    typical = float(squared.mean().sqrt()) if squared.numel() else 0.0
    # Of a group at rest only positions say anything.
    return max(typical, 1e-12)


def _quantiles(values: Array) -> Array:
    """Return quantiles over the first axis, NaN where any is NaN."""
    return np.quantile(values, QUANTILES, axis=0)
