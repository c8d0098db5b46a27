"""Sentences on the figures of an analysis beside those that each analysis has of its own."""

import numpy as np
import xarray as xr

from swarmssm.analysis.scoring.table import format_number as number
from swarmssm.analysis.scoring.table import format_unit

__all__ = ["in_a_frame", "modulation", "over_time", "pairs", "rotated", "single_latents"]

#: A p-value up to this counts, as in the figure.
LEVEL = 0.05
#: A force that is no larger than this part of the largest is none.
NEGLIGIBLE = 1e-3


def over_time(forces: xr.Dataset) -> str:
    """Say between what the strength of the forces goes, and how wide the bands are."""
    one = forces["group_magnitude"].isel(trial=0)
    unit = format_unit(str(one.attrs.get("units", "")))
    low, middle, high = one.transpose("quantile", "time", "term").to_numpy()
    parts, widths = [], []
    largest = float(np.nanmax(middle, initial=0.0))
    for index, term in enumerate(one["term"].to_numpy()):
        own = middle[:, index]
        known = np.isfinite(own)
        if not known.any() or own[known].max() < NEGLIGIBLE * largest:
            continue
        first, last = np.quantile(own[known], [0.1, 0.9])
        parts.append(f"{term} {number(float(first), 2)} to {number(float(last), 2)}")
        if own[known].mean() > 0:
            half = 0.5 * (high - low)[known, index]
            widths.append((float(half.mean() / own[known].mean()), str(term)))
    stride = int(forces.attrs.get("stride", 1))
    where = f"trial {one['trial'].item()}" + (f", one frame in {stride}" if stride > 1 else "")
    text = (
        f"Mean strength over the group in {where}; four fifths of the frames lie within, in "
        f"{unit}: {', '.join(parts)}."
    )
    if not widths:
        return text
    worst, name = max(widths)
    return (
        f"{text} The bands, 90 % of the draws, are widest for {name}: on average "
        f"{100 * worst:.0f} % of the middle to either side. They hold what is uncertain within the "
        "model, not whether it is the right one."
    )


def in_a_frame(forces: xr.Dataset, frame: int) -> str:
    """Say how surely the directions of the arrows are known."""
    one = forces.isel(trial=0, time=frame)
    when = f"The group at {float(one['time']):.3g} s of trial {one['trial'].item()}: "
    text = f"{when}strong arrows are posterior means, faint ones single draws."
    if "angle" not in one:
        return f"{text} Of three dimensions the first two are drawn."
    low, _, high = one["angle"].transpose("quantile", "individual", "term").to_numpy()
    half = np.degrees(0.5 * (high - low))
    parts = []
    for index, term in enumerate(one["term"].to_numpy()):
        own = half[:, index][np.isfinite(half[:, index])]
        if term != "other" and own.size:
            parts.append(f"{term} {own.mean():.0f}°" if own.mean() >= 1 else f"{term} below 1°")
    if not parts:
        return text
    return (
        f"{text} Mean half-width of the 90 % intervals of their directions: {', '.join(parts)}; "
        "at 90° or more the direction is as good as unknown."
    )


def modulation(kernels: xr.Dataset) -> str:
    """Say by how much a neighbour ahead counts more than one behind."""
    angle = np.degrees(kernels["angle"].to_numpy())
    low, middle, high = kernels["modulation"].transpose("quantile", "angle").to_numpy()

    def at(degrees: float) -> str:
        index = int(np.abs(angle - degrees).argmin())
        ends = f"{number(float(low[index]), 2)} to {number(float(high[index]), 2)}"
        return f"{number(float(middle[index]), 2)} ({ends})"

    return (
        f"By this factor a neighbour counts: straight ahead {at(0)}, to the side {at(90)}, behind "
        f"{at(180)}, medians with 90 % intervals. Intervals that overlap much say that the data "
        "cannot tell these directions apart."
    )


def single_latents(alignment: xr.Dataset) -> str:
    """Say which latent tells most, and how many tell more than chance."""
    linear = alignment.sel(probe="linear")
    over = ("latent", "term", "space")
    r2 = linear["latent_r2"].transpose(*over).to_numpy()
    p = linear["latent_family_p"].transpose(*over).to_numpy()
    if not np.isfinite(r2).any():
        return "No force varied, so that there was nothing to read."
    best = np.unravel_index(int(np.nanargmax(r2)), r2.shape)
    latent, term, space = (
        str(alignment[name].to_numpy()[place]) for name, place in zip(over, best, strict=True)
    )
    sure = int((p <= LEVEL).any((1, 2)).sum())
    return (
        f"The one that tells most by itself is {latent}, with R² {r2[best]:.2f} of {term} "
        f"{space} (p = {number(float(p[best]), 2)} for all cells at once); "
        f"{sure} of {alignment.sizes['latent']} latents tell something beyond chance, "
        "marked by a dot. A latent that tells a force need not be that force: it may be anything "
        "that goes with it."
    )


def rotated(alignment: xr.Dataset) -> str:
    """Say how pure the rotated axes are."""
    purity = alignment["purity"]
    if "group" in purity.dims:
        purity = purity.sel(group="latents")
    parts = [
        f"{axis} {100 * float(value):.0f} %"
        for axis, value in zip(alignment["axis"].to_numpy(), purity.to_numpy(), strict=True)
        if np.isfinite(value)
    ]
    if not parts:
        return "No direction of the latent space tells a force."
    return (
        "Turned towards the forces, one axis alone tells of its component this share of what all "
        f"latents tell: {', '.join(parts)}. Near 100 % on the diagonal and pale beside it, a force "
        "has a direction of its own; dark beside it, the latents hold the forces mixed."
    )


def pairs(influence: xr.Dataset) -> str:
    """Say which pair is the strongest, and how unlike the two directions of pairs are."""
    unit = format_unit(str(influence["influence"].attrs.get("units", "")))
    low, middle, high = (
        influence["influence"].transpose("quantile", "individual", "neighbor").to_numpy()
    )
    names = [str(name) for name in influence["individual"].to_numpy()]
    strongest = int(np.nanargmax(middle))
    moved, mover = divmod(strongest, len(names))
    at = (moved, mover)
    there = np.isfinite(middle) & np.isfinite(middle.T)
    total = (middle + middle.T)[there]
    unlike = np.abs(middle - middle.T)[there]
    share = float(unlike.sum() / total.sum()) if total.sum() > 0 else 0.0
    return (
        f"An arrow goes from who moves to who is moved. The strongest: {names[mover]} moves "
        f"{names[moved]}, {number(float(middle[at]))} {unit} (90 % interval "
        f"{number(float(low[at]))} to {number(float(high[at]))}), where the median pair has "
        f"{number(float(np.nanmedian(middle)))}. The two directions of a pair differ by "
        f"{100 * share:.0f} % of their sum on average; 0 % would mean that influence is mutual. "
        "All of it holds within the model: it is no experiment."
    )
