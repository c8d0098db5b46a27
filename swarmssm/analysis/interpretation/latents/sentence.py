"""What probes of latents show, in words."""

import numpy as np
import xarray as xr

from swarmssm.analysis.posterior.joining import joined

__all__ = ["sentence"]

#: A p-value up to this counts.
LEVEL = 0.05
#: R^2 that training must add to be worth a word.
GAIN = 0.05


def sentence(alignment: xr.Dataset) -> str:
    """Return in words what the probes show, and how far it can be believed.

    Parameters
    ----------
    alignment
        What :func:`swarmssm.analysis.latent_force_alignment` returned.
    """
    linear = alignment.sel(probe="linear")
    together = linear.sel(source="latents")
    parts, gained = [], []
    for term in alignment["term"].values:
        r2 = float(together["source_vector_r2"].sel(term=term))
        if np.isnan(r2):
            continue
        text = f"{term} {r2:.2f}"
        before = together["untrained_r2"].sel(term=term)
        if before.notnull().any():
            text += f" ({float(before.mean()):.2f} before training)"
            gained.append((str(term), r2 - float(before.max())))
        parts.append(text)
    if not parts:
        return "None of the forces varied, so that there was nothing to read from the latents."
    which = (
        "the true forces" if alignment.attrs["truth"] else "the boids terms of the smoothed states"
    )
    kept = "other trials" if alignment.attrs["folds_by"] == "trial" else "other blocks of time"
    found = (
        f"Of {which}, all latents together tell in {kept} these shares of the variance: "
        + ", ".join(parts)
        + ". "
    )
    least = alignment.attrs["least_p"]
    p = together["source_p"].to_numpy()
    sure = [str(t) for t, one in zip(alignment["term"].values, p, strict=True) if one <= LEVEL]
    if len(sure) == len(parts):
        found += f"Chance is ruled out for each of them (p {_p_text(float(np.nanmax(p)), least)}"
    elif least > LEVEL:
        found += "Whether it is more than chance cannot be told (p at the least"
        found += f" {float(np.nanmin(p)):.2g}"
    elif sure:
        found += f"Chance is ruled out for {joined(sure)} alone (p at most {LEVEL:g}"
    else:
        found += f"None of it is more than chance gives (p from {float(np.nanmin(p)):.2g} upwards"
    found += f"; {alignment.attrs['shifts']} shifts in time cannot show less than {least:.2g}). "
    if gained:
        better = [term for term, gain in gained if gain > GAIN]
        worse = [term for term, _ in gained if term not in better]
        if not better:
            found += "Before training the same network told as much: this is not what was learned."
        elif worse:
            found += f"Training added to it for {joined(better)}, not for {joined(worse)}."
        else:
            found += "Training added to all of them."
    return found.strip()


def _p_text(p: float, least: float) -> str:
    """Say a p-value, or that it is the smallest there can be."""
    return f"at the smallest possible, {least:.2g}" if p <= least * 1.0001 else f"at most {p:.2g}"
