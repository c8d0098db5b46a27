r"""Who turns first: leadership by the delay at which directions agree best, without any model.

.. math:: C_{ij}(\tau) = \langle \hat v_i(t) \cdot \hat v_j(t - \tau) \rangle_t

is how well the direction of i agrees with that of j a time :math:`\tau` before. Where it is highest
at :math:`\tau_{ij} > 0`, i follows j with that delay (Nagy et al. 2010). It needs no
model, and it cannot tell following from heeding the same
third one.

References
----------
M. Nagy, Z. Akos, D. Biro and T. Vicsek (2010), Hierarchical group dynamics in pigeon flocks,
Nature 464.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from swarmssm.analysis.interpretation.forces.frames import QUANTILES, labels_of
from swarmssm.analysis.posterior.intervals import known_mean
from swarmssm.errors import InputError
from swarmssm.tracks import Array, states_of, validate_tracks, with_trials

__all__ = ["FirstToTurn", "first_to_turn", "leadership_delays"]

#: Longest delay, as a part of the longest trial and in seconds, unless the caller gives one.
PART, LONGEST = 0.1, 5.0
#: A block of the bootstrap is so many times as long as the longest delay.
BLOCK = 5
#: Resampled recordings.
RESAMPLES = 500


def leadership_delays(
    tracks: xr.Dataset,
    max_delay: float | None = None,
    *,
    least_correlation: float = 0.5,
    max_distance: float | None = None,
    seed: int = 0,
) -> xr.Dataset:
    r"""Measure at which delay each individual follows each other, and who leads on the whole.

    Parameters
    ----------
    tracks
        With velocities, or with positions alone: the direction is then that of the last step.
    max_delay
        Longest delay looked at, in seconds; absent: a tenth of the longest trial, 5 s at most.
    least_correlation
        Pairs whose directions agree less than this at every delay have none (Nagy et al. take
        0.5), nor have those that agree best at the longest.
    max_distance
        Count only frames in which i and j are at most so far apart; absent: all.
    seed
        Of the bootstrap over blocks of time, five times as long as the longest delay.

    Returns
    -------
    Dataset in which ``individual`` follows ``neighbor``:

    ``correlation (individual, neighbor, delay)``
        :math:`C_{ij}`, over all trials; NaN where never defined.
    ``delay_of_pair (individual, neighbor)``
        :math:`\tau_{ij}` in s: positive where individual follows neighbor; minus its mirror image.
        NaN where there is none.
    ``delay_interval (quantile, individual, neighbor)``
        Quantiles of it over resampled blocks of time; NaN where most of these give none, and
        everywhere if there are fewer than five blocks.
    ``agreement (individual, neighbor)``
        The correlation there.
    ``lead (individual)``
        Mean delay with which the others follow an individual, s.
    ``lead_interval (quantile, individual)``
        Its quantiles over resampled blocks.
    ``follows_probability (individual, neighbor)``
        Share of the resampled recordings in which the delay is positive, ties counting half.

    Raises
    ------
    InputError
        If an option is out of range, or there are fewer than two individuals.
    """
    tracks = with_trials(validate_tracks(tracks))
    fps = float(tracks.attrs["fps"])
    states = states_of(tracks)
    _, times, individuals, features = states.shape
    if individuals < 2:
        raise InputError("tracks: there is one individual, and nobody for it to lead.")
    if not -1.0 <= least_correlation <= 1.0:
        raise InputError(
            f"least_correlation: it must be between -1 and 1, not {least_correlation!r}."
        )
    for name, value in (("max_delay", max_delay), ("max_distance", max_distance)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise InputError(f"{name}: it must be a positive number, not {value!r}.")
    if max_delay is None:
        max_delay = min(LONGEST, PART * times / fps)
    most = max(1, round(max_delay * fps))
    if most > times - 2:
        raise InputError(
            f"max_delay: it is {max_delay:g} s, and the longest trial has {times / fps:g} s."
        )
    sums = _block_sums(states[..., : features // 2], states[..., features // 2 :], most,
                       max_distance)  # fmt: skip
    steps = np.arange(-most, most + 1)
    whole = _delays(sums.products.sum(0), sums.counts.sum(0), steps, least_correlation)
    blocks = len(sums.counts)
    names = labels_of(tracks, "individual")["individual"]
    pairs = ("individual", "neighbor")
    data: dict[str, Any] = {
        "correlation": ((*pairs, "delay"), whole.correlation),
        "delay_of_pair": (pairs, whole.delay / fps),
        "agreement": (pairs, whole.agreement),
        "lead": ("individual", whole.lead / fps),
    }
    number = len(QUANTILES)
    spread = np.full((number, individuals, individuals), np.nan)
    leads = np.full((number, individuals), np.nan)
    follows = np.full((individuals, individuals), np.nan)
    if blocks >= 5:
        rng = np.random.default_rng(seed)
        drawn_delays, drawn_leads = [], []
        for _ in range(RESAMPLES):
            share = np.bincount(rng.integers(blocks, size=blocks), minlength=blocks)
            again = _delays(
                np.tensordot(share, sums.products, 1),
                np.tensordot(share, sums.counts, 1),
                steps,
                least_correlation,
            )
            drawn_delays.append(again.delay / fps)
            drawn_leads.append(again.lead / fps)
        spread = _known_quantiles(np.array(drawn_delays))
        leads = _known_quantiles(np.array(drawn_leads))
        signs = np.sign(np.array(drawn_delays))
        follows = np.where(
            np.isnan(signs).mean(0) > 0.5, np.nan, known_mean(0.5 * (1.0 + signs), 0)
        )
    data["delay_interval"] = (("quantile", *pairs), spread)
    data["lead_interval"] = (("quantile", "individual"), leads)
    data["follows_probability"] = (pairs, follows)
    result = xr.Dataset(
        data,
        {
            "individual": names,
            "neighbor": names,
            "delay": steps / fps,
            "quantile": list(QUANTILES),
        },
        {
            "max_delay": most / fps,
            "least_correlation": float(least_correlation),
            "blocks": blocks,
            "time_step": 1.0 / fps,
        },
    )
    for name, (units, meaning) in MEANINGS.items():
        result[name].attrs = {"units": units, "long_name": meaning}
    return result


MEANINGS = {
    "correlation": ("1", "agreement of individual's direction with neighbor's before"),
    "delay_of_pair": ("s", "delay with which individual follows neighbor"),
    "delay_interval": ("s", "delay with which individual follows neighbor"),
    "agreement": ("1", "agreement of directions at that delay"),
    "lead": ("s", "mean delay with which the others follow"),
    "lead_interval": ("s", "mean delay with which the others follow"),
    "follows_probability": ("1", "share of resampled recordings in which individual follows"),
    "delay": ("s", "time by which neighbor's direction is earlier"),
}


class FirstToTurn(NamedTuple):
    """Whom the others follow with the longest delay, in s; the ends of the interval NaN without."""

    name: str
    lead: float
    low: float
    high: float


def first_to_turn(delays: xr.Dataset) -> FirstToTurn | None:
    """Return who turns first by :func:`leadership_delays`; ``None`` where no pair has a delay.

    A delay is known to one frame: half a frame is added to the interval on either side.
    """
    lead = delays["lead"].to_numpy()
    if not np.isfinite(lead).any():
        return None
    first = int(np.nanargmax(lead))
    half = 0.5 * float(delays.attrs["time_step"])
    low, high = (delays["lead_interval"].sel(quantile=q).to_numpy()[first] for q in (0.05, 0.95))
    name = str(delays["individual"].to_numpy()[first])
    return FirstToTurn(name, float(lead[first]), float(low) - half, float(high) + half)


class _Sums(NamedTuple):
    """Sums over the frames of each block, ``(block, individual, neighbor, delay)``."""

    products: Array
    counts: Array


class _Delays(NamedTuple):
    """What :func:`leadership_delays` returns, delays in frames."""

    correlation: Array
    delay: Array
    agreement: Array
    lead: Array


def _block_sums(
    positions: Array, velocities: Array, most: int, max_distance: float | None
) -> _Sums:
    r"""Sum products of directions over blocks of time, for each delay.

    Frame t of i is paired with frame t - delay of j. Each pair of frames of a pair belongs to the
    block of the earlier of the two, so that :math:`C_{ij}(\tau) = C_{ji}(-\tau)` in each block.
    """
    trials, times, individuals, _ = velocities.shape
    speed = np.linalg.norm(velocities, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        known = (speed > 0) & np.isfinite(speed)
    headings = np.where(known, velocities / np.where(known, speed, 1.0), 0.0)
    known = known[..., 0].astype(np.float64)
    length = min(BLOCK * most, times)
    number = max(1, times // length)
    block_of = np.minimum(np.arange(times) // length, number - 1)
    starts = np.searchsorted(block_of, np.arange(number))
    shape = (trials * number, individuals, individuals, 2 * most + 1)
    products, counts = np.zeros(shape), np.zeros(shape)
    near: Any = 1.0
    for delay in range(most + 1):
        size = times - delay
        # Later frames of i, earlier ones of j.
        late, early = headings[:, delay:], headings[:, :size]
        seen = known[:, delay:, :, None] * known[:, :size, None, :]
        if max_distance is not None:
            apart = positions[:, delay:, :, None] - positions[:, delay:, None, :]
            with np.errstate(invalid="ignore"):
                near = (np.linalg.norm(apart, axis=-1) <= max_distance).astype(np.float64)
            seen = seen * near
        agreeing = np.einsum("rtix,rtjx->rtij", late, early) * near
        at = starts[starts < size]
        rows = (np.arange(trials)[:, None] * number + np.arange(len(at))).reshape(-1)
        for target, values in ((products, agreeing), (counts, seen)):
            summed = np.add.reduceat(values, at, axis=1).reshape(-1, individuals, individuals)
            target[rows, :, :, most + delay] = summed
            target[rows, :, :, most - delay] = summed.swapaxes(1, 2)
    used = counts.sum((1, 2, 3)) > 0
    used[0] = True
    return _Sums(products[used], counts[used])


def _delays(products: Array, counts: Array, steps: Array, least: float) -> _Delays:
    """Return the delays of summed products ``(individual, neighbor, delay)``, in frames."""
    correlation = np.divide(products, counts, out=np.full(products.shape, np.nan), where=counts > 0)
    itself = np.eye(len(correlation), dtype=bool)
    filled = np.where(np.isnan(correlation), -np.inf, correlation)
    agreement = filled.max(-1)
    # Where several agree best, the delay in their middle, so that the mirror image has its minus.
    best = filled >= agreement[..., None] - 1e-12
    first, last = best.argmax(-1), best.shape[-1] - 1 - best[..., ::-1].argmax(-1)
    delay = 0.5 * (steps[first] + steps[last])
    outside = (first == 0) | (last == len(steps) - 1) | (agreement < least) | itself
    delay = np.where(outside, np.nan, delay)
    agreement = np.where(np.isfinite(agreement) & ~itself, agreement, np.nan)
    return _Delays(correlation, delay, agreement, known_mean(delay, 0))


def _known_quantiles(values: Array) -> Array:
    """Return quantiles over the first axis of what is known, NaN where most is not."""
    known = np.isfinite(values)
    mostly = known.mean(0) > 0.5
    filled = np.where(mostly, values, 0.0)
    found: Array = np.nanquantile(filled, QUANTILES, axis=0)
    return np.where(mostly, found, np.nan)
