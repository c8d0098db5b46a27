"""How much each individual counts: the posterior of weights that a model gives to individuals."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import xarray as xr

from swarmssm.analysis.interpretation.forces.frames import QUANTILES
from swarmssm.analysis.interpretation.influence.ranks import rank_probabilities
from swarmssm.analysis.posterior.intervals import known_mean
from swarmssm.inference import Fit
from swarmssm.inference.guides import PathGuide
from swarmssm.models import StateSpaceModel
from swarmssm.models.transitions import WeightedPairs
from swarmssm.tracks import Array

__all__ = ["WEIGHT_SAMPLES", "label_weights", "pair_weights"]

#: Draws of the weights of individuals, of which there are more than of paths: they cost little.
WEIGHT_SAMPLES = 4000


def pair_weights(
    fit: Fit, samples: int = WEIGHT_SAMPLES, seed: int | torch.Generator = 0
) -> tuple[Array | None, Array | None]:
    """Return the weights that a model gives to individuals, in draws of its parameters.

    Parameters
    ----------
    fit
        A fit.
    samples
        Number of draws.
    seed
        Seed or generator.

    Returns
    -------
    Influence, ``(sample, individual)`` or ``(sample, individual, neighbor)``, and responsiveness,
    ``(sample, individual)``; ``None`` where the model has none. Those that are fixed are there
    once.
    """
    model = fit.model
    if not isinstance(model, StateSpaceModel) or not isinstance(model.transition, WeightedPairs):
        return None, None
    drawn = fit.parameters(samples, seed)
    found: list[Array | None] = []
    middle = fit.guide.parameters_guide.median() if isinstance(fit.guide, PathGuide) else {}
    with fit.with_parameters(middle):
        weights = model.transition.pair_weights()
    for name, value in weights._asdict().items():
        if value is None or f"transition.{name}" not in drawn:
            found.append(None if value is None else value.detach().double().numpy()[None])
        else:
            found.append(drawn[f"transition.{name}"].to_numpy().astype(np.float64))
    return found[0], found[1]


def label_weights(sent: Array | None, received: Array | None, names: Sequence[str]) -> xr.Dataset:
    """Return draws of weights with labels, relative to their means.

    Parameters
    ----------
    sent, received
        What :func:`pair_weights` returns.
    names
        Of the individuals.

    Returns
    -------
    Those variables of ``influence`` that are of weights; empty if
    there are none.
    """
    if sent is None and received is None:
        return xr.Dataset()
    number = len(names)
    others = ~np.eye(number, dtype=bool)
    pairs = np.ones((1, 1, 1))
    if sent is not None:
        pairs = pairs * (sent if sent.ndim == 3 else sent[:, None, :])
    if received is not None:
        pairs = pairs * received[:, :, None]
    pairs = np.where(others, pairs, np.nan)
    pairs = pairs / np.nanmean(pairs, axis=(1, 2), keepdims=True)
    data: dict[str, Any] = {
        "pair_weight": (
            ("quantile", "individual", "neighbor"),
            np.quantile(pairs, QUANTILES, axis=0),
            {"units": "1", "long_name": "weight with which individual counts neighbor"},
        )
    }
    over = ("sample", "individual")
    if sent is not None:
        own = sent if sent.ndim == 2 else known_mean(np.where(others, sent, np.nan), 1)
        own = own / own.mean(1, keepdims=True)
        data["weight"] = (over, own, {"units": "1", "long_name": "weight of individual for others"})
        data["weight_rank_probability"] = (
            ("individual", "rank"),
            rank_probabilities(own),
            {"units": "1", "long_name": "probability of the rank by weight"},
        )
    if received is not None or (sent is not None and sent.ndim == 3):
        own = known_mean(pairs, 2) if received is None else received
        own = own / own.mean(1, keepdims=True)
        data["responsiveness"] = (
            over,
            own,
            {"units": "1", "long_name": "weight of others for individual"},
        )
    labels = [str(name) for name in names]
    ranks = np.arange(1, number + 1)
    return xr.Dataset(data, {"individual": labels, "neighbor": labels, "rank": ranks})
