"""What a check means in plain words: for each statistic, and as a whole."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.analysis.diagnostics.checks.p_values import Judged
from swarmssm.analysis.posterior.intervals import quantiles
from swarmssm.analysis.scoring.table import format_number, format_unit
from swarmssm.tracks import Array

__all__ = ["LEVEL", "sentence", "verdicts"]

#: A p-value below this is called one.
LEVEL = 0.05
#: From this share of replicates that flew off on, a model is unlike any recording.
MANY_DIVERGED = 0.05
#: Two p-values closer than this are one.
EQUAL = 1e-9


def verdicts(
    names: Sequence[str],
    titles: Sequence[str],
    kinds: Sequence[str],
    units: Sequence[str],
    own: Mapping[str, Array],
    replicated: Mapping[str, Array],
    judged: Sequence[Judged],
    adjusted: Array,
    diverged: npt.NDArray[np.bool_],
) -> list[tuple[str, str]]:
    """Return verdict and words of each statistic.

    Parameters
    ----------
    names, titles
        Of the statistics; a last one more than there are ``kinds`` is that of replicates that flew
        off.
    kinds, units
        Of their values.
    own, replicated
        Values by name.
    judged, adjusted
        What became of them.
    diverged
        ``(draw,)`` of bool.
    """
    said = []
    for index, (name, one) in enumerate(zip(names, judged, strict=True)):
        if index >= len(kinds):
            said.append(_flew_off(diverged))
            continue
        if np.isnan(one.p_value):
            said.append(("unknown", f"The recording has no {titles[index]}."))
            continue
        verdict = _verdict(one.p_value, float(adjusted[index]))
        if kinds[index] == "number":
            found = _number(titles[index], format_unit(units[index]), own[name], replicated[name])
        elif kinds[index] == "histogram":
            found = (
                f"The distribution of {titles[index]} is at a Hellinger distance of "
                f"{format_number(one.hellinger, 2)} from the model's, where one replicate is at "
                f"{format_number(one.hellinger_among, 2)} from the others"
            )
        else:
            found = _curve(titles[index], own[name], replicated[name])
        draws = len(replicated[name])
        least = (2.0 if kinds[index] == "number" else 1.0) / (draws + 1)
        said.append(
            (verdict, f"{found}: {_meaning(verdict, one.p_value, adjusted[index], least)}.")
        )
    return said


def _verdict(p_value: float, adjusted: float) -> str:
    if p_value >= LEVEL:
        return "alike"
    return "unlike" if adjusted < LEVEL else "doubtful"


def _meaning(verdict: str, p_value: float, adjusted: float, least: float) -> str:
    """Return what a verdict means, with its numbers; ``least`` is the lowest p there can be."""
    number = f"p = {_p(p_value)}"
    if verdict == "alike" and least >= LEVEL and p_value <= least * (1.0 + EQUAL):
        return f"no replicate is as far out, but of so few no p-value is lower ({number})"
    if verdict == "alike":
        return f"nothing speaks against the model here ({number})"
    number += f", {_p(adjusted)} with all statistics allowed for"
    if verdict == "doubtful":
        return f"among so many statistics that may be chance ({number})"
    return f"the model does not make swarms like this one ({number})"


def _p(value: float) -> str:
    """Return a p-value as people write it."""
    return format_number(value, 2) if value < 0.1 else f"{value:.2f}"


def _number(title: str, unit: str, own: Array, replicated: Array) -> str:
    """Say where a number is among its replicates."""
    text = f"The {title} is {format_number(float(own))} {unit}".rstrip()
    known = replicated[np.isfinite(replicated)]
    if not known.size:
        return f"{text}, and no replicate has any"
    low, _, high = quantiles(known)
    where = "below" if own < low else "above" if own > high else "within"
    return (
        f"{text}, {where} the {format_number(float(low))} to {format_number(float(high))} of 90 % "
        "of the replicates"
    )


def _curve(title: str, own: Array, replicated: Array) -> str:
    """Say how much of a curve is outside of its replicates."""
    known = np.isfinite(own)
    flat = replicated.reshape(len(replicated), -1)[:, known.ravel()]
    mine = own.ravel()[known.ravel()]
    low, _, high = quantiles(flat)
    outside = int(((mine < low) | (mine > high) | np.isnan(low)).sum())
    return (
        f"The {title} is outside of the central 90 % of the replicates at {outside} of "
        f"{mine.size} points"
    )


def _flew_off(diverged: npt.NDArray[np.bool_]) -> tuple[str, str]:
    number, draws = int(diverged.sum()), len(diverged)
    verdict = "unlike" if number >= MANY_DIVERGED * draws else "doubtful"
    return verdict, (
        f"{number} of {draws} replicates flew off beyond all bounds, as no recording does: do not "
        "simulate with this model."
    )


def sentence(checked: xr.Dataset) -> str:
    """Say in a sentence or two what :func:`check` found, and how far it can be believed."""
    verdict = checked["verdict"].to_numpy().astype(str)
    titles = checked["title"].to_numpy().astype(str)
    known = verdict != "unknown"
    count, draws = int(known.sum()), int(checked.attrs["draws"])
    what = f"{count} statistics" if count != 1 else "one statistic"
    unlike = [str(title) for title in titles[verdict == "unlike"]]
    doubtful = [str(title) for title in titles[verdict == "doubtful"]]
    if not count:
        return "No statistic could be had of this recording, so that nothing was checked."
    head = f"Of {what} in {draws} swarms simulated from the posterior"
    if unlike:
        text = (
            f"{head}, {len(unlike)} tell{'s' * (len(unlike) == 1)} the recording from them, with "
            f"their number allowed for: {', '.join(unlike)}. The model does not reproduce "
            f"{'this' if len(unlike) == 1 else 'these'}"
        )
    elif doubtful:
        text = f"{head}, none tells the recording from them once their number is allowed for"
    else:
        text = f"{head}, none tells the recording from them"
    if doubtful:
        expected = format_number(LEVEL * count, 2)
        text += (
            f"; {len(doubtful)} more {'is' if len(doubtful) == 1 else 'are'} below p = {LEVEL:g} "
            f"({', '.join(doubtful)}), where chance alone gives about {expected}"
        )
    part = "all frames" if checked.attrs["part"] == "all" else f"the {checked.attrs['part']} part"
    tail = (
        f"This speaks of free runs of {checked.attrs['steps']} frames in {part}, each started "
        "from the observed past"
    )
    if not unlike:
        tail += "; other statistics, or longer runs, may still tell them apart"
    if "trained on" in checked.attrs["notes"] or "chosen by" in checked.attrs["notes"]:
        tail += "; as the model has seen these frames, agreement says less than it seems to"
    return f"{text}. {tail}."
