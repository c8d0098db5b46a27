r"""Is there a leader, does somebody keep apart? Decisions with a stated rate of false alarms.

**By weights.** Where the model gives individuals weights of their own, their joint posterior
decides. As data grow it becomes a normal about the estimates with their covariance, so that the
posterior probability of a wrong order of two is the p-value of the one-sided test of it. With rate
:math:`\alpha`,

* ``against="each"``: j leads if for every other k, :math:`P(w_j \le w_k) \le \alpha / 2`. To be
  wrong all of these must fail, whoever else is on top, so that no multiplicity arises from them
  (an intersection-union test); at most one individual passes. Wrong is worst where two share the
  lead and all others are far behind: then either may be taken for the leader, with
  :math:`\alpha/2` each. Of equals in larger number a false alarm is far rarer: with
  :math:`\alpha = 0.05` it is 0.014 among three and 0.0025 among six.
* ``against="rest"``: j leads if :math:`P(w_j \le \text{mean of the others}) \le \alpha / N`, and
  of several such the surest. The rate is about :math:`\alpha` in a group of equals
  (Bonferroni's bound is nearly reached, since contrasts with the others are nearly independent).
  It takes less data than the former, and says less: one of two leaders is called the leader, and so
  may be anyone in a group of which one member counts for nothing.

A prior that draws weights together makes both rates smaller, never larger.

**By trials.** Where the law is the same for all, nobody counts more in the same place; one may
still keep to places of influence. That is judged by whether it is the same individual in
independent trials: if names did not matter they could be exchanged within each trial, and the
largest mean over trials of the standardised outgoing influence is compared with what it is after
such exchanges. That test is exact, whatever the model, if the trials are independent; one trial
alone can say nothing.

References
----------
R. L. Berger (1982), Multiparameter hypothesis testing and acceptance sampling, Technometrics 24.
"""

import math
from typing import Any, Literal, get_args

import numpy as np
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.tracks import Array

__all__ = ["Against", "find_isolated", "find_leader"]

Against = Literal["each", "rest"]
#: Exchanges of names in the test by trials.
EXCHANGES = 9999
#: Scores that are exchanged at once.
EXCHANGED_AT_ONCE = 1_000_000
#: So many draws beyond a quantile tell where it is.
TAIL = 20


def find_leader(
    influence: xr.Dataset,
    rate: float = 0.05,
    *,
    against: Against = "each",
    seed: int = 0,
) -> xr.Dataset:
    """Decide whether one individual leads.

    Parameters
    ----------
    influence
        From :func:`swarmssm.analysis.interpretation.influence.influence`.
    rate
        Of false alarms, at most.
    against
        What a leader must surpass, by weights: ``"each"`` of the others, or the mean of the
        ``"rest"``.
    seed
        Of the exchanges of names.

    Returns
    -------
    Dataset with

    ``alarm (individual)``
        The smallest rate at which the individual would be declared the leader: twice the posterior
        probability that its strongest rival counts as much or more; N times the probability that
        the mean of the others does; or the p-value of the exchanges.
    ``leads (individual)``
        Whether it is declared so; true of one at most.

    ``attrs`` hold ``leader`` (its name, or an empty text), ``rate``, ``by`` (``"weights"``,
    ``"trials"``, or ``"nothing"`` where there are neither weights nor trials enough) and, by
    weights, ``against``.

    Raises
    ------
    InputError
        If the rate is not between 0 and 1, too small for the number of draws, or ``against`` is
        unknown.
    """
    if not 0.0 < rate < 1.0:
        raise InputError(f"rate: it must be between 0 and 1, not {rate!r}.")
    if against not in get_args(Against):
        raise InputError(f"against: it must be 'each' or 'rest', not {against!r}.")
    names = influence["individual"].to_numpy()
    attributes: dict[str, Any] = {"rate": float(rate)}
    alarm: Array
    if "weight" in influence and influence.sizes["sample"] > 1:
        weights = influence["weight"].transpose("sample", "individual").to_numpy()
        _check_draws(len(weights), rate / (2 if against == "each" else len(names)), rate)
        alarm = _by_each(weights) if against == "each" else _by_rest(weights)
        attributes |= {"by": "weights", "against": against}
    else:
        mean = influence["trial_influence"].mean("individual").transpose("trial", "neighbor")
        alarm, possible = _by_trials(mean.to_numpy(), seed)
        attributes["by"] = "trials" if possible <= rate else "nothing"
    best = int(np.argmin(alarm))
    leads = (np.arange(len(names)) == best) & (alarm <= rate)
    attributes["leader"] = str(names[best]) if leads.any() else ""
    return xr.Dataset(
        {
            "alarm": (
                "individual",
                alarm,
                {"units": "1", "long_name": "least rate at which it is declared the leader"},
            ),
            "leads": (
                "individual",
                leads,
                {"units": "1", "long_name": "whether it is declared the leader"},
            ),
        },
        {"individual": names},
        attributes,
    )


def find_isolated(influence: xr.Dataset, rate: float = 0.05, *, share: float = 0.5) -> xr.Dataset:
    r"""Decide who neither moves the others nor is moved by them.

    An individual is declared not to move others if its weight is surely less than a ``share`` of
    what the median of the others has: if the posterior probability of the contrary is at most
    :math:`\alpha / N`, so that with probability :math:`1 - \alpha` nobody is declared so who has
    that share. Likewise it is declared not to be moved, by its responsiveness; an isolated
    individual is both. Where the model has no such weights, outgoing and incoming influence along
    the path stand for them: in a law that is the same for all these say who keeps out of sight.

    Parameters
    ----------
    influence
        From :func:`swarmssm.analysis.interpretation.influence.influence`.
    rate
        Of false alarms, at most.
    share
        Of the others' median, below which someone counts as without influence.

    Returns
    -------
    Dataset with ``without_influence``, ``without_response`` and ``isolated (individual)`` of bool,
    and ``sent_share``, ``received_share (individual)``: posterior medians of the weight as
    a share of the others' median. ``attrs`` hold ``rate``, ``share``, ``isolated`` (names, with
    commas) and ``by``, ``"weights"`` or ``"path"``.

    Raises
    ------
    InputError
        If the rate or the share is not between 0 and 1, or the rate too small for the draws.
    """
    for name, value in (("rate", rate), ("share", share)):
        if not 0.0 < value < 1.0:
            raise InputError(f"{name}: it must be between 0 and 1, not {value!r}.")
    names = influence["individual"].to_numpy()
    by_weights = {"weight", "responsiveness"} <= set(influence)
    kinds = ("weight", "responsiveness") if by_weights else ("outgoing", "incoming")
    decided, medians = [], []
    for kind in kinds:
        values = influence[kind].transpose(..., "individual").to_numpy()
        if len(values) > 1 and by_weights:
            _check_draws(len(values), rate / len(names), rate)
        shares = values / _median_of_others(values)
        contrary = (~(shares < share)).mean(0)
        decided.append(contrary <= rate / len(names))
        medians.append(np.median(shares, axis=0))
    isolated = decided[0] & decided[1]
    return xr.Dataset(
        {
            "without_influence": ("individual", decided[0]),
            "without_response": ("individual", decided[1]),
            "isolated": ("individual", isolated),
            "sent_share": ("individual", medians[0]),
            "received_share": ("individual", medians[1]),
        },
        {"individual": names},
        {
            "rate": float(rate),
            "share": float(share),
            "isolated": ", ".join(str(name) for name in names[isolated]),
            "by": "weights" if by_weights else "path",
        },
    )


def _check_draws(draws: int, tail: float, rate: float) -> None:
    """Refuse a rate of which the draws cannot tell."""
    if draws * tail < TAIL:
        raise InputError(
            f"rate: with {draws} draws of the weights nothing can be said at a rate of {rate:g}; "
            f"take one of at least {rate * TAIL / (draws * tail):.2g}."
        )


def _by_each(weights: Array) -> Array:
    """Return twice the probability of the strongest rival, ``(individual,)``."""
    behind = (weights[:, :, None] <= weights[:, None, :]).mean(0)
    np.fill_diagonal(behind, 0.0)
    alarm: Array = np.minimum(1.0, 2.0 * behind.max(1))
    return alarm


def _by_rest(weights: Array) -> Array:
    """Return N times the probability of the mean of the others, ``(individual,)``."""
    number = weights.shape[1]
    others = (weights.sum(1, keepdims=True) - weights) / max(number - 1, 1)
    alarm: Array = np.minimum(1.0, number * (weights <= others).mean(0))
    return alarm


def _by_trials(scores: Array, seed: int) -> tuple[Array, float]:
    """Return p-values ``(individual,)`` and the least that is possible.

    ``scores`` is ``(trial, individual)``. Who is absent from a trial is left as it is.
    """
    trials, number = scores.shape
    # As often as the same one could come out on top by chance, in all trials.
    possible = max(float(number) ** (1 - trials), 1.0 / (EXCHANGES + 1))
    known = np.isfinite(scores)
    count = np.maximum(known.sum(1, keepdims=True), 1)
    filled = np.where(known, scores, 0.0)
    mean = filled.sum(1, keepdims=True) / count
    spread = np.sqrt((np.where(known, scores - mean, 0.0) ** 2).sum(1, keepdims=True) / count)
    standard = np.where(known & (spread > 0), (filled - mean) / np.where(spread > 0, spread, 1), 0)
    rng = np.random.default_rng(seed)
    at_once = max(1, EXCHANGED_AT_ONCE // standard.size)
    parts = []
    for first in range(0, EXCHANGES, at_once):
        count = min(at_once, EXCHANGES - first)
        exchanged = rng.permuted(np.broadcast_to(standard, (count, *standard.shape)), axis=2)
        parts.append(exchanged.sum(1).max(1))
    largest = np.concatenate(parts)
    # Sums in another order differ by rounding.
    seen = standard.sum(0) - 1e-9 * math.sqrt(trials)
    p = (1 + (largest[:, None] >= seen).sum(0)) / (EXCHANGES + 1)
    return p, possible


def _median_of_others(values: Array) -> Array:
    """Return the median over the others, ``(draw, individual)``."""
    number = values.shape[1]
    others = [np.delete(values, index, axis=1) for index in range(number)]
    return np.stack([np.median(part, axis=1) for part in others], 1)
