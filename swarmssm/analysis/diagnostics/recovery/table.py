"""Result of a recovery study: errors of the parameters, and how much data they take."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.inference.parameter_labels import short_names

__all__ = ["Recovery", "factor_curve", "gains_of"]

#: Equal but for rounding counts as within the tolerance.
ROUNDING = 1.0 + 1e-9


@dataclass(frozen=True)
class Recovery:
    """Result of :func:`~swarmssm.analysis.recovery`.

    Attributes
    ----------
    data
        Truths, estimates and errors, with dimensions ``design``, ``parameter`` and ``dataset``.
    """

    data: xr.Dataset

    def summary(self) -> pd.DataFrame:
        """Return a row for each design and parameter.

        Columns are the median relative ``error``, ``width`` (half the 90 % interval, relative to
        the truth), ``coverage`` of 90 % intervals, ``within_tolerance`` and ``frames_needed``.
        """
        names = ["error", "width", "coverage", "frames_needed"]
        labelled = self.data[names].assign_coords(design=self.data["label"].to_numpy())
        frame = labelled.to_dataframe()[names]
        frame["within_tolerance"] = frame["error"] <= self._tolerance * ROUNDING
        return frame

    def to_pandas(self) -> pd.DataFrame:
        """Return a row for each design, parameter and data set: truth, median and interval."""
        names = ["truth", "median", "sd", "low", "high"]
        return self.data[names].to_dataframe().reset_index()

    def sufficient(self) -> pd.DataFrame:
        """Return, for each factor, at which of its values each parameter is within the tolerance.

        A row for each varied factor, a column for each parameter: ``"100 or more"``,
        ``"0.03 or less"``, ``"all"``, ``"none"``, or the values. Empty for a grid.
        """
        rows = {}
        short = short_names([str(name) for name in self.data["parameter"].values])
        for factor in dict.fromkeys(str(name) for name in self.data["factor"].values):
            if factor not in ("base", "grid"):
                curve = factor_curve(self.data, factor)
                rows[factor] = {
                    short[str(name)]: _where(
                        curve[factor].to_numpy(),
                        curve["error"].sel(parameter=name).to_numpy() <= self._tolerance * ROUNDING,
                    )
                    for name in self.data["parameter"].values
                }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("factor")

    def verdict(self) -> str:
        """Return in one line whether the base design recovers the gains, and what it would take."""
        first = self.data.isel(design=0).sel(parameter=gains_of(self.data))
        error = first["error"].to_numpy()
        if not np.isfinite(error).any():
            return "No data set of the base design could be fitted."
        worst = int(np.nanargmax(error))
        what = "gains" if "_gain" in str(first["parameter"].values[0]) else "parameters"
        size = (
            f"{int(first['trials'])} x {int(first['frames'])} frames of "
            f"{int(first['individuals'])} individuals, tracking noise {float(first['noise']):.2g}"
        )
        share = f"{100 * self._tolerance:.0f} %"
        names = [str(name) for name in first["parameter"].values]
        recovered = np.nanmax(error) <= self._tolerance * ROUNDING
        needed = first["frames_needed"].to_numpy()
        frames = f"{int(np.nanmax(needed))}" if np.isfinite(needed).any() else "unknown"
        return (
            f"{'All' if recovered else 'Not all'} {what} are recovered to within {share} ({size}): "
            f"largest median error {100 * error[worst]:.0f} % "
            f"({short_names(names)[names[worst]]}, "
            f"{int(first['fitted'])} data sets), coverage of 90 % intervals "
            f"{100 * float(first['coverage'].mean()):.0f} %; a posterior standard deviation of "
            f"{share} takes about {frames} frames a trial."
        )

    @property
    def _tolerance(self) -> float:
        return float(self.data.attrs["tolerance"])


def gains_of(recovery: xr.Dataset) -> list[str]:
    """Return the names of the gains, or of all parameters of a model that has none so named."""
    names = [str(name) for name in recovery["parameter"].values]
    return [name for name in names if "_gain" in name] or names


def factor_curve(recovery: xr.Dataset, factor: str) -> xr.Dataset:
    """Return the designs in which a factor is varied, the base among them, by its value."""
    mine = np.isin(recovery["factor"].to_numpy().astype(str), [factor, "base"])
    chosen = recovery.isel(design=np.flatnonzero(mine))
    return chosen.isel(design=np.argsort(chosen[factor].to_numpy(), kind="stable"))


def _where(values: Any, good: Any) -> str:
    """Return at which values something holds, in words."""
    if good.all():
        return "all"
    if not good.any():
        return "none"
    shown = [f"{value:.4g}" for value in values]
    first, last = int(np.argmax(good)), len(good) - 1 - int(np.argmax(good[::-1]))
    if good[first:].all():
        return f"{shown[first]} or more"
    if good[: last + 1].all():
        return f"{shown[last]} or less"
    return ", ".join(text for text, holds in zip(shown, good, strict=True) if holds)
