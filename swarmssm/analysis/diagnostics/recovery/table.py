"""What a recovery study tells: which errors, and how much data they take."""

from typing import Any

import numpy as np
import xarray as xr

from swarmssm.analysis.diagnostics.calibration.parameter_names import short_name

__all__ = ["factor_curve", "gains_of", "recovery_needs", "recovery_sentence", "recovery_table"]

#: What is equal but for rounding is within the tolerance.
ROUNDING = 1.0 + 1e-9


def recovery_table(recovery: xr.Dataset) -> list[dict[str, object]]:
    """Return what a user needs to know: for each factor, from where on each parameter is found.

    Parameters
    ----------
    recovery
        From :func:`recovery_study`.

    Returns
    -------
    A row for each setting: ``factor``, ``value``, and for each parameter a text with its median
    relative error and half the 90 % interval, in percent, with a mark where the error is beyond the
    tolerance; then ``frames`` needed for the worst of them.
    """
    tolerance = float(recovery.attrs["tolerance"])
    rows: list[dict[str, object]] = []
    for index in range(recovery.sizes["setting"]):
        one = recovery.isel(setting=index)
        row: dict[str, object] = {"setting": str(one["label"].item())}
        for name in recovery["parameter"].values:
            own = one.sel(parameter=name)
            error, width = float(own["error"]), float(own["width"])
            mark = "" if error <= tolerance * ROUNDING else " !"
            row[short_name(str(name))] = (
                f"{100 * error:.0f} % ±{100 * width:.0f} %{mark}" if error == error else "-"
            )
        rows.append(row)
    return rows


def recovery_needs(recovery: xr.Dataset) -> list[dict[str, object]]:
    """Return, for each factor, at which of its values each parameter is within the tolerance.

    Parameters
    ----------
    recovery
        From :func:`recovery_study`, one factor at a time.

    Returns
    -------
    A row for each factor with a text for each parameter: ``"100 or more"``, ``"0.03 or less"``,
    ``"all tried"``, ``"none tried"``, or the values where it holds.
    """
    tolerance = float(recovery.attrs["tolerance"])
    rows: list[dict[str, object]] = []
    for factor in dict.fromkeys(str(name) for name in recovery["factor"].values):
        if factor in ("base", "grid"):
            continue
        curve = factor_curve(recovery, factor)
        row: dict[str, object] = {"factor": factor}
        for name in recovery["parameter"].values:
            good = curve["error"].sel(parameter=name).to_numpy() <= tolerance * ROUNDING
            row[short_name(str(name))] = _where(curve[factor].to_numpy(), good)
        rows.append(row)
    return rows


def gains_of(recovery: xr.Dataset) -> list[str]:
    """Return the names of the gains, or of all parameters of a model that has none so named."""
    names = [str(name) for name in recovery["parameter"].values]
    return [name for name in names if "_gain" in name] or names


def factor_curve(recovery: xr.Dataset, factor: str) -> xr.Dataset:
    """Return the settings in which a factor is varied, the base among them, by its value."""
    mine = np.isin(recovery["factor"].to_numpy().astype(str), [factor, "base"])
    chosen = recovery.isel(setting=np.flatnonzero(mine))
    return chosen.isel(setting=np.argsort(chosen[factor].to_numpy(), kind="stable"))


def recovery_sentence(recovery: xr.Dataset) -> str:
    """Return what a study says, in one or two plain sentences.

    Parameters
    ----------
    recovery
        From :func:`recovery_study`.
    """
    tolerance = float(recovery.attrs["tolerance"])
    first = recovery.isel(setting=0)
    names = gains_of(recovery)
    own = first.sel(parameter=names)
    error = own["error"].to_numpy()
    if not np.isfinite(error).any():
        return "No data set of the base setting could be fitted."
    worst = int(np.nanargmax(error))
    needed = int(np.nanmax(own["frames_needed"].to_numpy()))
    count = int(first["fitted"].item())
    where = (
        f"With {int(first['frames'])} frames of {int(first['individuals'])} individuals in "
        f"{int(first['trials'])} trials and a tracking noise of {float(first['noise']):.2g}"
    )
    what = "gains are" if "_gain" in names[0] else "parameters are"
    verdict = (
        f"all {what} found to within {100 * tolerance:.0f} %"
        if error.max() <= tolerance * ROUNDING
        else f"{what} not all found to within {100 * tolerance:.0f} %"
    )
    coverage = float(own["coverage"].mean())
    return (
        f"{where}, {verdict}: the median error is largest for {short_name(names[worst])}, "
        f"{100 * error[worst]:.0f} % over {count} simulated data sets, and 90 % intervals hold the "
        f"truth in {100 * coverage:.0f} % of cases. For a standard deviation of "
        f"{100 * tolerance:.0f} % in each, about "
        f"{needed} frames a trial are needed."
    )


def _where(values: Any, good: Any) -> str:
    """Say at which values something holds."""
    if good.all():
        return "all tried"
    if not good.any():
        return "none tried"
    shown = [f"{value:.4g}" for value in values]
    first, last = int(np.argmax(good)), len(good) - 1 - int(np.argmax(good[::-1]))
    if good[first:].all():
        return f"{shown[first]} or more"
    if good[: last + 1].all():
        return f"{shown[last]} or less"
    return ", ".join(text for text, holds in zip(shown, good, strict=True) if holds)
